"""`make starts`: trainings of the published cube from random starts, beside the one from the stated object."""

from __future__ import annotations

import sys
from argparse import ArgumentParser
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.cli.console import Console
from pipelines.cli.failures import guarded

if TYPE_CHECKING:
    from tossid.evaluation.evaluate import Scores
    from tossid.models import TrainedModel
    from tossid.store import Dataset

CORNERS_MM, FRICTION, ROLLOUTS_PCT = 2.0, 0.01, 3.0
"""Largest differences from the end of the stated start that count as the same end."""
HEAD = (
    "model|tosses|start|corners|friction|inertia|gravity|corners apart [mm]|friction apart|"
    "rollouts apart [%]|same end|says converged|restarts|CPU s"
)


@dataclass(frozen=True)
class Study:
    """What is trained.

    Attributes:
        model: Its name.
        tosses: Of the training split.
        restarts: Whether corners that tosses contradict start where the tosses show corners.
        starts: How many.
        first: Number of the first of them, where a study goes on.
        seed: Draws the tosses.
    """

    model: str
    tosses: int
    restarts: bool
    starts: int
    first: int = 0
    seed: int = 0

    def train(self, dataset: Dataset, gravity: float) -> tuple[TrainedModel, float]:
        """A model that starts from a dataset's object, with lengths as recorded, and its processor time [s]."""
        import time
        from dataclasses import replace

        import tossid
        from tossid.models import variant

        model = replace(variant(self.model), gravity=gravity, length_scale=1.0)
        began = time.process_time()
        trained = tossid.train(dataset, model=model, tosses=self.tosses, restart_corners=self.restarts, seed=self.seed)
        return trained, time.process_time() - began


def main(folder: Path, study: Study, console: Console) -> None:
    """Print a Markdown row for each start, as it ends, and the counts of what was reached.

    Args:
        folder: Holds contactnets_cube.
        study: What is trained.
        console: Where the rows go.
    """
    from dataclasses import replace

    import numpy as np

    import tossid
    from experiments.random_starts import end_difference, random_starts
    from tossid.errors import TossidError
    from tossid.objects import GRAVITY

    dataset = tossid.ingest(folder / "contactnets_cube", source="contactnets")
    held_out, stated = dataset.split("test"), dataset.object
    reference, took = study.train(dataset, GRAVITY)
    expected = position(tossid.evaluate(reference, held_out))
    console.say("| " + HEAD.replace("|", " | ") + " |")
    console.say("|" + "---|" * (HEAD.count("|") + 1))
    console.say(
        row(
            study,
            "stated",
            "stated",
            stated.friction,
            1.0,
            GRAVITY,
            ("0", "0", f"{expected:.1f} itself"),
            "-",
            reference,
            took,
        )
    )
    reached, same, honest, count = np.zeros(3, dtype=int), 0, 0, study.starts - study.first
    learns = reference.settings.model.learn_inertia
    for number, start in enumerate(random_starts(stated, study.starts, continuous=learns)):
        if number < study.first:
            continue
        about = (start.corners, start.object.friction, start.inertia_rel, start.gravity)
        try:
            trained, took = study.train(replace(dataset, object=start.object), start.gravity)
        except TossidError as error:
            console.say(f"| `{study.model}` | {study.tosses} | {number} | {error} |")
            honest += 1
            continue
        end = end_difference(trained, reference)
        scores = tossid.evaluate(trained, replace(held_out, object=stated))
        rollouts = 100 * (position(scores) / expected - 1)
        near = (1e3 * end.corners <= CORNERS_MM, end.friction <= FRICTION, abs(rollouts) <= ROLLOUTS_PCT)
        reached += near
        same += all(near)
        honest += all(near) or not trained.converged
        apart = (f"{1e3 * end.corners:.2f}", f"{end.friction:.4f}", f"{rollouts:+.1f}")
        console.say(row(study, f"{number}", *about, apart, "yes" if all(near) else "no", trained, took))
    console.say(
        f"{same} of {count} end where the stated start ends (corners {reached[0]}, friction {reached[1]}, rollouts "
        f"{reached[2]}); {count - honest} others do not say so"
    )


def position(scores: Scores) -> float:
    """Mean position error [% of the stated width]."""
    return float(scores.metrics["position_error_pct"]["mean"])


def row(
    study: Study,
    number: str,
    corners: str,
    friction: float,
    inertia: float,
    gravity: float,
    apart: tuple[str, str, str],
    reached: str,
    trained: TrainedModel,
    took: float,
) -> str:
    """A Markdown row."""
    restarts = len(trained.parameters["convergence"]["restarts"])
    cells = [
        f"`{study.model}`",
        f"{study.tosses}" if study.seed == 0 else f"{study.tosses}, seed {study.seed}",
        number,
        corners,
        f"{friction:.3f}",
        f"{inertia:.2f}",
        f"{gravity:g}",
    ]
    cells += [*apart, reached, "yes" if trained.converged else "no", f"{restarts}", f"{took:.0f}"]
    return "| " + " | ".join(cells) + " |"


def parsed(arguments: list[str]) -> tuple[Path, Study]:
    """The command's arguments."""
    parser = ArgumentParser(prog="python -m experiments.starts", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--model", default="cnrpi")
    parser.add_argument("--tosses", type=int, default=64)
    parser.add_argument("--no-restarts", dest="restarts", action="store_false", help="leave corners as they are given")
    parser.add_argument("--starts", type=int, default=20, help="so many, from the first on")
    parser.add_argument("--first", type=int, default=0, help="leave out those before this one")
    parser.add_argument("--seed", type=int, default=0, help="draws the tosses")
    found = parser.parse_args(arguments)
    return found.folder, Study(found.model, found.tosses, found.restarts, found.starts, found.first, found.seed)


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(*parsed(sys.argv[1:]), Console()), "starts"))
