"""`make paper`: claims of "Simultaneously Learning Contact and Continuous Dynamics" (Bianchini and Posa), a row each.

Each claim is measured twice: with the presets, which learn everything at once as the paper does, and with the models
that tossid uses by default. Tosses are those of the published cube; the inertia's basin is measured on simulated ones,
whose inertia is known.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pipelines.cli.console import Console
from pipelines.cli.failures import guarded

if TYPE_CHECKING:
    import numpy as np

    from tossid.models import ModelSettings, TrainedModel
    from tossid.store import Dataset

PAPER = {"cn": "paper_cn", "cnrp": "paper_cnrp", "cnrpi": "paper_cnrpi"}
OURS = {"cn": "cn", "cnrp": "cnrp", "cnrpi": "cnrpi"}
WRONG = (0.0, 4.905, 14.715, 19.62)
"""Given gravities beside the right one [m/s²]."""
INERTIAS = (0.25, 0.5, 0.8, 1.25, 2.0, 4.0)
"""Starts of inertia, relative to the true one."""
NEAR = 0.1
"""Relative error of inertia up to which a start has ended at the true one."""


@dataclass(frozen=True)
class Study:
    """What is trained.

    Attributes:
        tosses: To learn from.
        held_out: Of the test split.
        seeds: Of starts and of which tosses.
        gravities: Given to the models beside the right one [m/s²].
        inertias: Starts of inertia.
        cone: Friction cone of the presets' rollouts; the exact one is several times faster.
    """

    tosses: int = 64
    held_out: int = 100
    seeds: tuple[int, ...] = (0, 1, 2)
    gravities: tuple[float, ...] = WRONG
    inertias: tuple[float, ...] = INERTIAS
    cone: Literal["exact", "polyhedral"] = "polyhedral"

    def variant(self, name: str, **changes: Any) -> ModelSettings:
        """A model's settings with some changed, and with the cone of this study if it is a preset."""
        from tossid.models import variant

        settings = variant(name)
        return replace(settings, cone=self.cone if settings.together else settings.cone, **changes)


@dataclass(frozen=True)
class Measured:
    """What a run gave on held-out tosses.

    Attributes:
        position: Error of rollouts [% of the width].
        rotation: [deg].
        penetration: Of rollouts [mm].
        recorded: Penetration of the recorded tosses [mm].
        gravity: Downward acceleration in flight [m/s²].
        at_rest: Learned acceleration of tosses at rest, root mean square [m/s²].
    """

    position: float
    rotation: float
    penetration: float
    recorded: float
    gravity: float
    at_rest: float


def measure(trained: TrainedModel, held_out: Dataset) -> Measured:
    """A run's figures on held-out tosses."""
    import numpy as np

    from tossid.evaluation.metrics import score_tosses
    from tossid.physics.effects.wrenches import learned_field
    from tossid.types import Phase

    model, measurement = trained.model, trained.model.measurement
    scores = score_tosses(model.simulator(), held_out.object, held_out.tosses, measurement=measurement)
    true = [measurement.true_toss(toss) for toss in held_out.tosses]
    q, v = (np.concatenate([getattr(toss, name)[toss.phase == Phase.REST] for toss in true]) for name in ("q", "v"))
    mechanics = model.mechanics()
    assert mechanics is not None
    field = learned_field(mechanics.object, mechanics.k_res, q, v)[:, :3]
    return Measured(
        position=float(scores.position_error_pct.mean()),
        rotation=float(scores.rotation_error_deg.mean()),
        penetration=float(scores.penetration_mm.mean()),
        recorded=float(scores.recorded_penetration_mm.mean()),
        gravity=float(np.nanmean(scores.gravity_ms2)),
        at_rest=float(np.sqrt(np.square(field).sum(axis=1).mean())) if len(q) else float("nan"),
    )


def final_height(trained: TrainedModel, held_out: Dataset) -> float:
    """Mean height at which rollouts end [m]."""
    from tossid.evaluation.metrics import roll_out

    model = trained.model
    runs = roll_out(model.simulator(), held_out.object, held_out.tosses, measurement=model.measurement)
    return float(sum(run.q[-1, 2] for run in runs) / len(runs))


class Runs:
    """Trainings of one kind of model, each done when it is first asked for.

    Args:
        dataset: Tosses of the cube.
        study: How many tosses and seeds.
        names: Of the models, by the paper's.
        console: Says what is trained.

    Attributes:
        heights: At which rollouts of `cn` end that is given no gravity, by seed [m].
    """

    def __init__(self, dataset: Dataset, study: Study, names: dict[str, str], console: Console) -> None:
        self.dataset, self.study, self.names, self.console = dataset, study, names, console
        test = dataset.split("test")
        self.held_out = replace(test, tosses=test.tosses[: study.held_out])
        self._done: dict[tuple[str, float], list[Measured]] = {}
        self.heights: list[float] = []

    def of(self, model: str, gravity: float) -> list[Measured]:
        """What each seed gave."""
        import tossid

        key = model, gravity
        if key not in self._done:
            self._done[key] = []
            for seed in self.study.seeds:
                settings = self.study.variant(self.names[model], gravity=gravity)
                trained = tossid.train(self.dataset, model=settings, tosses=self.study.tosses, seed=seed)
                found = measure(trained, self.held_out)
                self._done[key].append(found)
                if key == ("cn", 0.0):
                    self.heights.append(final_height(trained, self.held_out))
                self.console.say(
                    f"{self.names[model]}, gravity {gravity:g}, seed {seed}: {trained.seconds:.0f} s, {found}"
                )
        return self._done[key]

    def mean(self, model: str, gravity: float, name: str) -> float:
        """The mean of a figure over seeds."""
        found = [getattr(run, name) for run in self.of(model, gravity)]
        return float(sum(found) / len(found))


def claims(runs: Runs, inertias: np.ndarray, inner: tuple[float, bool]) -> list[str]:
    """What each claim is for one kind of model, in words.

    Args:
        runs: The trainings.
        inertias: Ends of inertia over the true one, by start.
        inner: How far a vertex inside has moved [mm], and whether tosses have shown it.
    """
    from tossid.objects import GRAVITY

    study = runs.study
    shares = [(runs.mean("cnrp", g, "gravity") - g) / (GRAVITY - g) for g in study.gravities]
    position, rotation = (
        {model: runs.mean(model, GRAVITY, name) for model in OURS} for name in ("position", "rotation")
    )
    deep = [f"{runs.mean(model, GRAVITY, 'penetration'):.2f}" for model in OURS]
    basin = [f"{start:g}" for start, end in zip(study.inertias, inertias, strict=True) if abs(end - 1) < NEAR]
    seen = "seen" if inner[1] else "not seen"
    drifting = runs.mean("cn", 0.0, "position")
    return [
        f"{100 * min(shares):.0f} to {100 * max(shares):.0f} %",
        f"{position['cnrp'] - position['cn']:+.1f} %, {rotation['cnrp'] - rotation['cn']:+.1f} deg",
        f"{position['cnrpi'] - position['cnrp']:+.1f} %, {rotation['cnrpi'] - rotation['cnrp']:+.1f} deg",
        f"{', '.join(deep)} mm; recorded {runs.mean('cn', GRAVITY, 'recorded'):.2f} mm",
        f"ends at {sum(runs.heights) / len(runs.heights):.2f} m, {drifting:.0f} % off",
        f"{runs.mean('cnrp', GRAVITY, 'at_rest'):.2f} m/s²; given no gravity {runs.mean('cnrp', 0.0, 'at_rest'):.2f}",
        f"moved by {inner[0]:.2f} mm, {seen}",
        f"starts {', '.join(basin) or 'none'} of {', '.join(f'{start:g}' for start in study.inertias)}",
    ]


CLAIMS = (
    ("the residual recovers gravity", "at least 75 %"),
    ("`cnrp` is close to `cn`", "within 6 % and 3 deg"),
    ("`cnrpi` beside `cnrp`", "slightly worse"),
    ("penetration of `cn`, `cnrp`, `cnrpi`", "within the noise"),
    ("`cn` without gravity", "drifts into free space"),
    ("the residual at rest", "zero"),
    ("a vertex inside", "not seen"),
    ("basin of inertia (ends within 10 %)", "small"),
)
"""Each claim, and the paper's figure."""


def inner_vertex(dataset: Dataset, study: Study, model: str) -> tuple[float, bool]:
    """How far a ninth vertex at the cube's centre moves [mm], and whether tosses have shown it."""
    import numpy as np

    import tossid

    cube = dataset.object
    corners = np.concatenate([cube.corner_pos, np.zeros((1, 3))])
    body = np.zeros(len(corners), dtype=np.int64)
    given = replace(dataset, object=cube.with_changes(corner_pos=corners, corner_body=body))
    settings = study.variant(model, random_start=False)
    trained = tossid.train(given, model=settings, tosses=study.tosses)
    shown = trained.parameters["geometry"][0]["seen"][-1]
    return 1e3 * float(np.linalg.norm(trained.object.corner_pos[-1])), bool(shown)


def ends_of_inertia(study: Study, model: str) -> np.ndarray:
    """The learned inertia's trace over the true one, by start, of simulated tosses."""
    import numpy as np

    import tossid
    from tossid.settings.synthesis import NoiseSettings

    noise = NoiseSettings(position=5e-5, rotation=5e-4, velocity=5e-3, spin=5e-2)
    data = tossid.synthesize("cube", tosses=round(1.6 * study.tosses), engine="lcp", seed=1, noise=noise)
    ends = []
    for start in study.inertias:
        settings = study.variant(model, random_start=False, start_inertia=start)
        trained = tossid.train(data, model=settings)
        ends.append(np.trace(trained.object.inertia[0]) / np.trace(data.object.inertia[0]))
    return np.array(ends)


def main(folder: Path, study: Study, console: Console) -> None:
    """Train what is needed, then print a Markdown row for each claim.

    Args:
        folder: Holds contactnets_cube.
        study: How many tosses, seeds and values.
        console: Where the rows go.
    """
    import tossid

    dataset = tossid.ingest(folder / "contactnets_cube", source="contactnets")
    columns = []
    for names in (PAPER, OURS):
        inertias = ends_of_inertia(study, names["cnrpi"])
        console.say(f"{names['cnrpi']}: inertia from {study.inertias} ends at {inertias.round(2).tolist()}")
        inner = inner_vertex(dataset, study, names["cn"])
        columns.append(claims(Runs(dataset, study, names, console), inertias, inner))
    for line in table(columns):
        console.say(line)


def table(columns: Sequence[Sequence[str]]) -> list[str]:
    """A Markdown table with a row for each claim: of the paper, the presets and the default models."""
    rows = [("claim", "paper", "presets", "default models"), ("---",) * 4]
    rows += [(*claim, *found) for claim, *found in zip(CLAIMS, *columns, strict=True)]
    return ["| " + " | ".join(row) + " |" for row in rows]


def parsed(arguments: list[str]) -> tuple[Path, Study]:
    """The command's arguments."""
    parser = ArgumentParser(prog="python -m experiments.paper", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--tosses", type=int, default=Study.tosses)
    parser.add_argument("--held-out", type=int, default=Study.held_out)
    parser.add_argument("--seeds", type=int, default=len(Study.seeds))
    parser.add_argument("--gravities", type=float, nargs="+", default=list(WRONG))
    parser.add_argument("--inertias", type=float, nargs="+", default=list(INERTIAS))
    parser.add_argument("--cone", default=Study.cone, choices=("exact", "polyhedral"))
    found = parser.parse_args(arguments)
    return found.folder, Study(
        found.tosses,
        found.held_out,
        tuple(range(found.seeds)),
        tuple(found.gravities),
        tuple(found.inertias),
        found.cone,
    )


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(*parsed(sys.argv[1:]), Console()), "paper"))
