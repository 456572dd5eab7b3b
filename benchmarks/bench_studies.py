"""Trainings and a study that `make bench` times, and how good the trained models are.

python -m benchmarks.bench_studies                        # trainings of the real cube, then whole commands
python -m benchmarks.bench_studies --models cnrpi --gravities 0 19.62
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from experiments.harness import options
from pipelines.cli.console import Console

CUBE = Path("data/datasets/contactnets_cube.h5")
"""The real cube's tosses, as `make bench` and `make experiments` make them."""
MODELS, GRAVITY = ("cn", "cnrp", "cnrpi"), 9.81
HEADS = ("model", "gravity", "train: CPU s", "evaluate: CPU s", "position %", "rotation deg", "from flight: %", "deg")


def main() -> None:
    """Print the tables."""
    given = options(__doc__, models=MODELS, gravities=(GRAVITY,))
    console = Console()
    trainings(console, models=given.models, gravities=given.gravities)
    whole_commands(console)


def trainings(console: Console, *, models: Sequence[str] = MODELS, gravities: Sequence[float] = (GRAVITY,)) -> None:
    """Train on the real cube's training tosses, on one thread, and evaluate on its held-out tosses.

    Args:
        console: Gets the table.
        models: Variants by name.
        gravities: That the models are given [m/s²].
    """
    if not CUBE.is_file():
        console.say(f"no trainings: {CUBE} is missing")
        return
    import tossid
    from tossid.models import variant

    dataset, rows = tossid.read_dataset(CUBE), []
    for model in models:
        for gravity in gravities:
            began = time.process_time()
            trained = tossid.train(dataset, model=replace(variant(model), gravity=gravity), threads=1)
            learned = time.process_time()
            scores = tossid.evaluate(trained, dataset.split("test")).metrics
            seconds = (learned - began, time.process_time() - learned)
            starts = (scores, scores["from_flight"])
            errors = [each[key]["mean"] for each in starts for key in ("position_error_pct", "rotation_error_deg")]
            rows.append([model, f"{gravity:g}", *(f"{s:.1f}" for s in seconds), *(f"{x:.3f}" for x in errors)])
    counts = (len(dataset.of_split(split)) for split in ("train", "test"))
    console.table(HEADS, rows, title="Trainings on {} real tosses, {} held out, one thread".format(*counts))


def whole_commands(console: Console) -> None:
    """Time a training of the real cube and the sample's study as commands, on all cores, in a folder of their own.

    Args:
        console: Gets the figures.
    """
    root, facts = Path(__file__).resolve().parents[1], {}
    with tempfile.TemporaryDirectory() as folder:

        def elapsed(*words: str) -> float:
            started = time.perf_counter()
            command = [sys.executable, "-m", "pipelines.cli.app", *words, "--quiet"]
            environment = {**os.environ, "PYTHONPATH": str(root)}
            subprocess.run(command, check=True, cwd=folder, env=environment, stdout=subprocess.DEVNULL)
            return time.perf_counter() - started

        elapsed("ingest", f"source.path={root / 'data/raw/sample'}", f"out={folder}/tosses.h5")
        took = elapsed("evaluate", "--sweep", "gravity", f"data={folder}/tosses.h5")
        facts["tossid evaluate --sweep gravity, 15 trainings of the sample"] = f"{took:.1f} s"
        if (root / CUBE).is_file():
            took = elapsed("train", "model=cnrpi", f"data={root / CUBE}")
            facts["tossid train model=cnrpi, the real cube"] = f"{took:.1f} s"
    console.facts(facts, title="Whole commands, elapsed, all cores (compiled before)")


if __name__ == "__main__":
    from pipelines.cli.failures import guarded

    sys.exit(guarded(main, "bench"))
