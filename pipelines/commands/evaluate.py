"""`tossid evaluate`: open-loop rollouts of a trained model on held-out tosses; or a study, with `--sweep`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.cli.console import Console
from pipelines.config.schemas import EvaluateConfig
from pipelines.files.project import dataset_path
from tossid.errors import FileError, InputError

if TYPE_CHECKING:
    from pipelines.tracking.runs import RunRecord
    from tossid.models import TrainedModel

FOLDER = Path("outputs/evaluate")


def run(config: EvaluateConfig, console: Console) -> dict[str, Any]:
    """Evaluate; returns CONTRACT.md's metrics and the figures' paths."""
    if config.sweep is not None:
        from pipelines.commands.sweep import run_sweep

        return run_sweep(config, config.sweep, console)

    from pipelines.tracking.run import tracked_run
    from pipelines.tracking.runs import find_run
    from tossid import evaluate
    from tossid.evaluation.evaluate import metric_means
    from tossid.outputs import output_folder
    from tossid.store import open_dataset

    record = find_run(config.run)
    trained = record.trained_model()
    data, split, sha256 = _data(config, trained)
    with open_dataset(data, split="test" if split == "test" else None) as dataset:
        if not dataset.tosses:
            raise InputError(f"{data}: no held-out tosses to evaluate on")
        name, count = trained.name, len(dataset.tosses)
        scores = evaluate(trained, dataset, settings=config)
        folder = FOLDER / _folder_name(record, data, split)
        with tracked_run(f"evaluate-{record.name}", config, command="evaluate") as tracked:
            tracked.data(data, sha256, context="evaluation")
            tracked.tag("evaluated_run", record.id)
            tracked.metrics(metric_means(scores.metrics))
            tracked.describe(f"`{name}` (run {record.name}) on {count} tosses of `{data}`.", *scores.table())
            with output_folder(folder, made_by="evaluate") as temporary:
                metrics, *figures = scores.save(temporary)
                result = {**scores.as_json(), "run": record.id, "data": str(data), "split": split}
                result["figures"] = [str(folder / path.relative_to(temporary)) for path in figures]
                metrics.write_text(json.dumps(result, indent=2) + "\n")
            tracked.artifact(folder / "figures")
            tracked.artifact(folder / "metrics.json")
    head, rows = scores.table()
    console.table(head, rows, title=f"{name}: {count} tosses")
    if scores.per_toss.diverged:
        console.warn(f"{scores.per_toss.diverged} of {count} rollouts diverged")
    leak = trained.parameters.get("copies")
    if leak is not None and split == "test":
        console.warn(f"{data}: {leak['warning']}")
    console.say(f"{len(figures)} figures in {folder / 'figures'}")
    return result


def _data(config: EvaluateConfig, trained: TrainedModel) -> tuple[Path, str, str]:
    """The dataset to evaluate on, which of its tosses, and its hash."""
    from tossid.store import file_sha256

    if config.data is not None:
        data = dataset_path(config.data)
        return data, "all", file_sha256(data)
    if trained.data is None:
        raise InputError("the run was trained on a dataset in memory; name one with data=FILE.h5")
    if not trained.data.is_file():
        raise FileError(trained.data, "the run's dataset is gone; name one with data=FILE.h5")
    sha256 = file_sha256(trained.data)
    if sha256 != trained.sha256:
        raise FileError(trained.data, "the run's dataset has changed since training; name it with data=FILE.h5")
    return trained.data, "test", sha256


def _folder_name(record: RunRecord, data: Path, split: str) -> str:
    """A run's evaluation on its own dataset, or on another, goes to a folder of its own."""
    name = f"{record.name}-{record.id[:8]}" if record.id else record.name
    return name if split == "test" else f"{name}-{data.stem}"
