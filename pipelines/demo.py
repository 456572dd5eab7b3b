"""`make demo`: the main job on embedded defaults, what was found against the truth, and where to look next."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.cli.call import call_with_keys
from pipelines.cli.console import Console
from pipelines.cli.failures import guarded

if TYPE_CHECKING:
    from tossid.store import Dataset

RECORDING = Path("data/raw/demo")
DATASET = Path("data/datasets/demo.h5")
FRICTION = 0.3
"""Friction of the synthesized cube; what is given to the training is that of conf/object/cube.yaml."""

STAGES: tuple[tuple[str, tuple[str, ...]], ...] = (
    (
        "synthesize",
        (
            "object=cube",
            f"object.friction={FRICTION}",
            "engine=mujoco",
            "tosses=12",
            "seed=0",
            "frames=true",
            f"out={RECORDING}",
        ),
    ),
    ("ingest", ("source=frames", f"source.path={RECORDING}", "object=cube", f"out={DATASET}")),
    ("train", ("model=cnrpi", f"data={DATASET}")),
    ("evaluate", ()),
)


def main() -> None:
    """Synthesize, ingest, train, evaluate; then the table, and where to look."""
    console = Console()
    started = time.perf_counter()
    results: dict[str, dict[str, Any]] = {}
    for command, keys in STAGES:
        console.say(f"\n$ tossid {command} {' '.join(keys)}".rstrip())
        results[command] = call_with_keys(command, keys, json=False, quiet=False)

    rows = found_and_true(Path(results["train"]["checkpoint"]))
    console.say("\nWhat was found, beside what the training was given and the truth that was synthesized")
    console.table(["quantity", "given", "truth", "found"], rows)
    console.say(f"{time.perf_counter() - started:.0f} s. Where to look next:")
    figures = [path for name in ("train", "evaluate") for path in results[name]["figures"]]
    console.facts(
        {
            "figures": "\n             ".join(figures),
            "runs": "mlflow ui, then http://127.0.0.1:5000",
            "a study": "tossid evaluate --sweep gravity   (which models repair a wrong gravity? a minute)",
            "keys": "tossid train --help",
            "your data": "README.md, 'Your data'",
        }
    )


def found_and_true(checkpoint: Path) -> list[list[str]]:
    """The table's rows: quantity, given, truth, found."""
    import numpy as np

    from tossid import TrainedModel, evaluate
    from tossid.store import read_dataset

    truth, seen = read_dataset(RECORDING / "truth.h5"), read_dataset(DATASET)
    distance, turn = pose_errors(truth, seen)
    trained = TrainedModel.load(checkpoint)
    model = trained.model
    given, learned, true = seen.object, model.learned_object(), truth.object
    fall = evaluate(trained, seen).metrics["gravity_ms2"]["mean"]
    corners = 1e3 * np.linalg.norm(learned.corner_pos - true.corner_pos, axis=1).max()
    return [
        ["tosses", "-", f"{len(truth.tosses)}", f"{len(seen.tosses)}"],
        ["pose error, median [mm]", "-", "0", f"{np.median(distance):.3f}"],
        ["pose error, median [deg]", "-", "0", f"{np.median(turn):.3f}"],
        ["pose error, worst [deg]", "-", "0", f"{turn.max():.2f}"],
        ["gravity [m/s²]", f"{trained.settings.model.gravity:.2f}", "9.81", f"{fall:.2f}"],
        ["friction", f"{given.friction:.3f}", f"{true.friction:.3f}", f"{learned.friction:.3f}"],
        ["worst corner, off by [mm]", "0", "0", f"{corners:.1f}"],
        ["centre of mass, off by [mm]", "0", "0", f"{1e3 * np.linalg.norm(learned.com - true.com):.1f}"],
        ["inertia, relative", "1", "1", f"{np.trace(learned.inertia[0]) / np.trace(true.inertia[0]):.3f}"],
    ]


def pose_errors(truth: Dataset, seen: Dataset) -> tuple[Any, Any]:
    """Distance [mm] and angle [deg] between seen and true poses, in every frame of a seen toss that the truth has."""
    import numpy as np

    from tossid.rotations import geodesic_angle

    distance, angle = [], []
    for toss in seen.tosses:
        for true in truth.tosses:
            row = np.round((toss.t - true.t[0]) * truth.rate_hz).astype(int)
            inside = (row >= 0) & (row < len(true))
            distance.append(1e3 * np.linalg.norm(toss.q[inside, :3] - true.q[row[inside], :3], axis=1))
            angle.append(np.rad2deg(geodesic_angle(toss.q[inside, 3:7], true.q[row[inside], 3:7])))
    return np.concatenate(distance), np.concatenate(angle)


if __name__ == "__main__":
    sys.exit(guarded(main, "demo"))
