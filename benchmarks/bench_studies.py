"""Trainings and a study that `make bench` times: by stage and as commands, and how good the trained models are.

python -m benchmarks.bench_studies         # the real cube's trainings and the sample's study
python -m benchmarks.bench_studies cnrpi   # the training of one model, at gravity 9.81
python -m benchmarks.bench_studies cnrpi 0 19.62   # at these gravities
python -m benchmarks.bench_studies --unknown cnrpi   # from nothing
python -m benchmarks.bench_studies commands   # a training and the study as commands, elapsed
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipelines.cli.console import Console
from tossid.errors import ConfigError

CUBE = Path("data/datasets/contactnets_cube.h5")
"""The real cube's tosses, as `make bench` and `make experiments` make them."""
MODELS = ("cn", "cnrp", "cnrpi")
GRAVITY = 9.81
HEADS = ("model", "gravity", "stage", "epochs", "passes", "CPU s")
SCORES = ("model", "gravity", "CPU s in all", "position %", "rotation deg", "from flight: %", "deg", "friction")


def main() -> None:
    """Print the tables."""
    console = Console()
    unknown, rest = "--unknown" in sys.argv, [word for word in sys.argv[1:] if word != "--unknown"]
    model, *words = rest or [""]
    gravities = [_gravity(word) for word in words] or [GRAVITY]
    if model != "commands":
        trainings(console, models=(model,) if model else MODELS, gravities=gravities, unknown=unknown)
    if not model or model == "commands":
        whole_commands(console)


def _gravity(text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise ConfigError("gravity", f"'{text}' is no number [m/s²]; one model is named, then gravities.") from error


def trainings(
    console: Console,
    *,
    models: Sequence[str] = MODELS,
    gravities: Sequence[float] = (GRAVITY,),
    unknown: bool = False,
) -> None:
    """Train on the real cube's training tosses, on one thread, and evaluate on its held-out tosses.

    Args:
        console: Gets the tables.
        models: Variants by name.
        gravities: That the models are given [m/s²].
        unknown: Whether to learn the object from nothing; errors are then in % of the learned object's width.
    """
    if not CUBE.is_file():
        console.say(f"no trainings: {CUBE} is missing")
        return
    from tossid.store import read_dataset

    started = time.process_time()
    dataset = read_dataset(CUBE)
    stages, scores = [["all", "", "read", "", "", f"{time.process_time() - started:.1f}"]], []
    for model in models:
        for gravity in gravities:
            rows, score = _trained(dataset, model, gravity, unknown)
            stages += rows
            scores.append(score)
    count = len(dataset.of_split("train"))
    console.table(HEADS, stages, title=f"Trainings on {count} real tosses, one thread (compiled before)")
    console.table(SCORES, scores, title=f"Held-out errors, {len(dataset.of_split('test'))} tosses")


def _trained(dataset: Any, model: str, gravity: float, unknown: bool) -> tuple[list[list[str]], list[str]]:
    """Rows of a training's stages, and the row of its scores."""
    from tossid.evaluation.evaluate import evaluate
    from tossid.models import variant
    from tossid.settings.objects import UnknownObjectSettings
    from tossid.settings.training import TrainSettings
    from tossid.training.api import Epoch, fit_model, prepare

    at = [time.process_time()]

    def lap() -> float:
        at.append(time.process_time())
        return at[-1] - at[-2]

    nothing = UnknownObjectSettings(mass=float(dataset.object.mass[0])) if unknown else None
    settings = TrainSettings(model=replace(variant(model), gravity=gravity), object=nothing, threads=1)
    fit = prepare(dataset, settings)
    name = f"{gravity:g}"
    rows = [[model, name, "prepare", "", "", f"{lap():.1f}"]]
    epochs: dict[str, list[float]] = {}

    def each_epoch(epoch: Epoch) -> None:
        stage = epochs.setdefault(epoch.record.stage, [0, 0, 0.0])
        stage[0] += 1
        stage[1] += epoch.record.passes
        stage[2] += lap()

    trained = fit_model(fit, each_epoch=each_epoch)
    rows += [[model, name, stage, f"{n}", f"{passes}", f"{s:.1f}"] for stage, (n, passes, s) in epochs.items()]
    rows.append([model, name, "intervals", "", "", f"{lap():.1f}"])
    scores = evaluate(trained, dataset.split("test")).as_json()
    rows.append([model, name, "evaluate", "", "", f"{lap():.1f}"])
    return rows, [model, name, f"{at[-1] - at[0]:.1f}", *_errors(scores), f"{trained.object.friction:.4f}"]


def _errors(scores: dict[str, Any]) -> Iterator[str]:
    for part in (scores, scores["from_flight"]):
        for key in ("position_error_pct", "rotation_error_deg"):
            yield f"{part[key]['mean']:.3f}"


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
