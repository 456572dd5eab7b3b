"""`make demo`: the main job on embedded defaults, and what was found against the truth."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from pipelines.calling import call_with_keys
from pipelines.console import Console

RECORDING = Path("data/raw/demo")
DATASET = Path("data/datasets/demo.h5")


def main() -> int:
    """Synthesize, ingest, train, evaluate; then the table."""
    console = Console()
    started = time.perf_counter()
    stages: list[tuple[str, list[str]]] = [
        ("synthesize", ["object=cube", "engine=mujoco", "tosses=12", "seed=0", "frames=true", f"out={RECORDING}"]),
        ("ingest", ["source=frames", f"source.path={RECORDING}", f"out={DATASET}"]),
        ("train", ["model=cnrpi", f"data={DATASET}"]),
        ("evaluate", []),
    ]
    for command, keys in stages:
        console.say(f"\n$ tossid {command} {' '.join(keys)}")
        call_with_keys(command, keys, json=False, quiet=False)

    import numpy as np

    from pipelines.checkpoints import load_checkpoint
    from pipelines.runs import find_run
    from tossid.evaluation.metrics import score_tosses
    from tossid.rotations import geodesic_angle
    from tossid.store import read_dataset

    truth, found = read_dataset(RECORDING / "truth.h5"), read_dataset(DATASET)
    position, angle = [], []
    for toss in found.tosses:
        for true in truth.tosses:
            row = np.round((toss.t - true.t[0]) * truth.rate_hz).astype(int)
            inside = (row >= 0) & (row < len(true))
            position.append(np.linalg.norm(toss.q[inside, :3] - true.q[row[inside], :3], axis=1))
            angle.append(np.rad2deg(geodesic_angle(toss.q[inside, 3:7], true.q[row[inside], 3:7])))
    distance, turn = np.concatenate(position), np.concatenate(angle)
    record = find_run()
    assert record.checkpoint is not None
    model = load_checkpoint(record.checkpoint).model
    learned, given = model.learned_object(), truth.object
    fall = float(np.nanmean(score_tosses(model.system(), found.object, found.tosses).gravity_ms2))
    rows = [
        ["tosses", str(len(truth.tosses)), str(len(found.tosses))],
        ["pose error, median [mm]", "0", f"{1e3 * np.median(distance):.3f}"],
        ["pose error, median [deg]", "0", f"{np.median(turn):.3f}"],
        ["pose error, worst [deg]", "0", f"{turn.max():.2f}"],
        ["gravity [m/s²]", "9.81", f"{fall:.2f}"],
        ["friction", f"{given.friction:.3f}", f"{learned.friction:.3f}"],
        ["worst corner [mm]", "0", f"{1e3 * np.linalg.norm(learned.corner_pos - given.corner_pos, axis=1).max():.1f}"],
        ["centre of mass, offset [mm]", "0", f"{1e3 * np.linalg.norm(learned.com - given.com):.1f}"],
        ["inertia / mass, relative", "1", f"{np.trace(learned.inertia[0]) / np.trace(given.inertia[0]):.3f}"],
    ]
    console.table(["quantity", "truth", "found"], rows, title="What was found, against the truth that was synthesized")
    console.say(
        f"{time.perf_counter() - started:.0f} s. Next: 'mlflow ui' shows the runs; 'tossid train --help' the keys."
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
