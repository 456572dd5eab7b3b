"""`make shapes`: objects of several shapes, tossed with a tracker's noise, learned from nothing."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.cli.console import Console
from pipelines.cli.failures import guarded

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from experiments.tossed_shapes import ShapeTossSettings
    from tossid.models import TrainedModel
    from tossid.objects import ObjectModel
    from tossid.store import Dataset
    from tossid.types import PoseTrack

HEAD = (
    "shape",
    "found as",
    "corners",
    "Hausdorff [mm]",
    "seen [%]",
    "friction",
    "centre of mass [mm]",
    "inertia [%]",
    "position [%]",
    "over the true model's",
    "rotation [deg]",
    "over the true model's",
    "seconds",
)
CLOSE = 1e-3
"""What came so near the ground counts in the Hausdorff distance [m]."""


def main(shapes: list[str], model: str, settings: ShapeTossSettings) -> None:
    """Learn each shape from the TUM files of its tosses; print a Markdown row for each.

    Args:
        shapes: Names of `experiments.tossed_shapes.SHAPES`; none for all.
        model: The variant that learns.
        settings: How they are tossed.
    """
    from experiments.tossed_shapes import SHAPES

    console = Console()
    console.say("| " + " | ".join(HEAD) + " |")
    console.say("|" + "---|" * len(HEAD))
    for name in shapes or SHAPES:
        console.say("| " + " | ".join(row(name, model, settings)) + " |")


def parsed(arguments: list[str]) -> tuple[list[str], str, ShapeTossSettings]:
    """What the command's arguments ask for, as `main` takes it."""
    from experiments.tossed_shapes import ShapeTossSettings

    default = ShapeTossSettings()
    parser = argparse.ArgumentParser(prog="make shapes", description=__doc__)
    parser.add_argument("shapes", nargs="*", metavar="SHAPE", help="names, such as 'hexagonal prism'; all by default")
    parser.add_argument("--model", default="cnrpi")
    toss_options(parser, default)
    parser.add_argument(
        "--step", type=float, default=default.step, help="MuJoCo's; twice it is contact's time constant"
    )
    given = vars(parser.parse_args(arguments))
    shapes, model = given.pop("shapes"), given.pop("model")
    return shapes, model, replace(default, **given)


def toss_options(parser: argparse.ArgumentParser, default: ShapeTossSettings) -> None:
    """Add what a command says of how objects are tossed.

    Args:
        parser: Of the command.
        default: What is not said.
    """
    parser.add_argument("--tosses", type=int, default=default.tosses)
    parser.add_argument("--engine", choices=["mujoco", "lcp"], default=default.engine)
    parser.add_argument("--seed", type=int, default=default.seed)
    parser.add_argument("--friction", type=float, default=default.friction)


def row(name: str, model: str, settings: ShapeTossSettings) -> list[str]:
    """A shape's row.

    Args:
        name: Of the shape.
        model: The variant that learns.
        settings: How it is tossed.
    """
    import numpy as np

    import tossid
    from experiments.tossed_shapes import toss_shape
    from tossid.settings.objects import UnknownObjectSettings
    from tossid.store.importers.tum import write_tum

    made = toss_shape(name, settings)
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        write_tum(Path(folder), made.tracks)
        dataset = tossid.ingest(folder, source="tum", object="unknown")
    trained = tossid.train(dataset, model=model, object=UnknownObjectSettings(mass=float(made.object.mass[0])))
    seconds = time.process_time() - began
    learned = trained.object
    true = replace(made.object, width=learned.width)
    off, share = apart(learned, made.hull, made.truth)
    com = 1e3 * np.linalg.norm(learned.com[0] - true.com[0])
    inertia = 100 * np.linalg.norm(learned.inertia[0] - true.inertia[0]) / np.linalg.norm(true.inertia[0])
    return [
        name,
        trained.parameters["from_nothing"]["shape"],
        f"{learned.n_corners}",
        f"{1e3 * off:.2f}",
        f"{100 * share:.0f}",
        f"{learned.friction:.3f} for {true.friction:g}",
        f"{com:.2f}",
        f"{inertia:.1f}",
        *beside_truth(trained, true, dataset.split("test")),
        f"{seconds:.0f}",
    ]


def beside_truth(trained: TrainedModel, true: ObjectModel, held_out: Dataset) -> list[str]:
    """Cells of how well rollouts predict tosses: position [% of a width] and rotation [deg], each over the truth's.

    Args:
        trained: The model.
        true: The object as it is, simulated by tossid.
        held_out: Tosses.
    """
    import tossid
    from tossid.evaluation.metrics import score_tosses
    from tossid.models.predictor import Simulator
    from tossid.physics import make_system

    best = score_tosses(Simulator(make_system(true), substeps=4), true, held_out.tosses)
    ours = tossid.evaluate(trained, held_out).per_toss
    position, rotation = ours.position_error_pct.mean(), ours.rotation_error_deg.mean()
    return [
        f"{position:.1f}",
        f"{position / best.position_error_pct.mean():.2f}",
        f"{rotation:.1f}",
        f"{rotation / best.rotation_error_deg.mean():.2f}",
    ]


def apart(
    learned: ObjectModel, hull: NDArray[np.float64], truth: Sequence[PoseTrack], body: int = 0
) -> tuple[float, float]:
    """Hausdorff distance of two hulls, both ways, over directions in which the true one came near the ground.

    Of convex bodies it is the largest difference of their support functions.

    Args:
        learned: The learned object.
        hull: (n, 3) points of the true hull [m].
        truth: Tracks of the body without noise.
        body: Of the learned object.

    Returns:
        The distance [m], and the share of all directions that is compared.
    """
    import numpy as np

    from tossid.objects.roundness import directions
    from tossid.rotations import quat_to_matrix

    ways = directions(2000)
    down = np.concatenate([-quat_to_matrix(track.q[:, 3:7])[:, 2, :] for track in truth])
    height = np.concatenate([track.q[:, 2] for track in truth])
    reach = down @ hull.T
    near = height - reach.max(axis=1) < CLOSE
    seen = np.zeros(len(ways), dtype=bool)
    for part in np.array_split(down[near], max(1, int(near.sum()) // 500)):
        seen |= (ways @ part.T).max(axis=1) > np.cos(np.deg2rad(5))
    # what came near: the true points that touched, in all directions in which they are the farthest
    touched = np.flatnonzero((height[near, None] - reach[near] < CLOSE).any(axis=0))
    farthest = (ways @ hull.T).argmax(axis=1)
    seen |= np.isin(farthest, touched)
    difference = learned.support(ways, body).max(axis=1) - (ways @ hull.T).max(axis=1)
    return float(np.abs(difference[seen]).max()), float(seen.mean())


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(*parsed(sys.argv[1:])), "shapes"))
