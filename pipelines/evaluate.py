"""`tossid evaluate`: open-loop rollouts of a trained model on held-out tosses; or a study, with `--sweep`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.console import Console
from pipelines.project import dataset_path
from pipelines.schemas import EvaluateConfig
from tossid.errors import FileError, InputError

if TYPE_CHECKING:
    from pipelines.checkpoints import Checkpoint
    from pipelines.runs import RunRecord
    from tossid.types import Dataset

FOLDER = Path("outputs/evaluate")


def run(config: EvaluateConfig, console: Console) -> dict[str, Any]:
    """Evaluate; returns CONTRACT.md's metrics and the figures' paths."""
    if config.sweep is not None:
        from pipelines.sweep import run_sweep

        return run_sweep(config, config.sweep, console)

    from pipelines.checkpoints import load_checkpoint
    from pipelines.runs import find_run
    from tossid.store import open_dataset

    record = find_run(config.run)
    if record.checkpoint is None:
        raise InputError(f"run {record.name} ({record.id or record.folder}) has no checkpoint")
    trained = load_checkpoint(record.checkpoint)
    data, split, sha256 = _data(config, trained)
    with open_dataset(data, split="test" if split == "test" else None) as dataset:
        if not dataset.tosses:
            raise InputError(f"{data}: no held-out tosses to judge")
        return _judge(config, record, trained, dataset, data, split, sha256, console)


def _judge(
    config: EvaluateConfig,
    record: RunRecord,
    trained: Checkpoint,
    dataset: Dataset,
    data: Path,
    split: str,
    sha256: str,
    console: Console,
) -> dict[str, Any]:
    """Metrics and figures of a trained model on the dataset's tosses."""
    from pipelines.calling import jsonable
    from pipelines.learning import evaluate_model, predicted_motions
    from pipelines.outputs import output_folder
    from pipelines.pictures import (
        evaluation_figures,
        gravity_given,
        joint_figure,
        residual_figure,
        write_figures,
        write_film,
    )
    from pipelines.tracking import tracked_run

    name, model, tosses = trained.config.name, trained.model, dataset.tosses
    judged = evaluate_model(model, dataset.object, tosses)
    result: dict[str, Any] = {
        "run": record.id,
        "model": name,
        "data": str(data),
        "n_tosses": len(tosses),
        "split": split,
        **judged.metrics,
        "parameters": model.parameters_report(),
    }
    folder = FOLDER / _folder_name(record, data, split)
    with tracked_run(f"evaluate-{record.name}", config, command="evaluate") as tracked:
        tracked.data(data, sha256, context="evaluation")
        tracked.tag("evaluated_run", record.id)
        tracked.metrics(means(judged.metrics))
        rollouts = predicted_motions(model, dataset.object, tosses, dt=judged.dt)
        figures = evaluation_figures(judged, tosses, rollouts, dataset.object, name=name)
        figures |= residual_figure(
            model, judged, tosses, name=f"{name.upper()}, {gravity_given(trained.config.gravity)}"
        )
        figures |= joint_figure(model, rollouts, dataset.object, name=name.upper())
        with output_folder(folder, made_by="evaluate") as temporary:
            paths = write_figures(figures, temporary / "figures")
            paths += write_film(judged, tosses, rollouts, dataset.object, temporary / "figures", name=name)
            result["figures"] = [str(folder / "figures" / path.name) for path in paths]
            (temporary / "metrics.json").write_text(json.dumps(jsonable(result), indent=2) + "\n")
        tracked.artifact(folder / "figures")
        tracked.artifact(folder / "metrics.json")
    console.table(
        ["metric", "mean", "95 % interval", "from flight", "95 % interval ", "16 steps", "95 % interval  "],
        table_rows(judged.metrics),
        title=f"{name}: {len(tosses)} tosses",
    )
    if judged.scores.diverged:
        console.warn(f"{judged.scores.diverged} of {len(tosses)} rollouts diverged")
    console.say(f"{len(paths)} figures in {folder / 'figures'}")
    return result


def _data(config: EvaluateConfig, trained: Checkpoint) -> tuple[Path, str, str]:
    """The dataset to judge on, which of its tosses, and its hash."""
    from tossid.store import file_sha256

    if config.data is not None:
        data = dataset_path(config.data)
        return data, "all", file_sha256(data)
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


def means(metrics: dict[str, Any]) -> dict[str, float]:
    """The metrics' means and the counts, as they are tracked; those that are not known are left out."""
    nested = {"": metrics, **{f"{part}/": metrics.get(part, {}) for part in ("from_flight", "sixteen_steps")}}
    found = {
        f"{prefix}{name}": value["mean"] if isinstance(value, dict) and "mean" in value else value
        for prefix, part in nested.items()
        for name, value in part.items()
    }
    return {name: float(value) for name, value in found.items() if isinstance(value, (int, float))}


def table_rows(metrics: dict[str, Any]) -> list[list[str]]:
    """A row for each metric: from the first state, from the flight where that is there, and over 16 steps."""
    rows = []
    for name, value in metrics.items():
        if isinstance(value, dict) and "mean" in value:
            others = (metrics.get(part, {}).get(name) for part in ("from_flight", "sixteen_steps"))
            rows.append([name, *_cells(value), *(cell for other in others for cell in _cells(other))])
    return rows


def _cells(value: dict[str, Any] | None) -> list[str]:
    if value is None:
        return ["-", "-"]
    low, high = value["ci95"]
    few = value.get("n", 2) < 2  # one toss has no spread
    return [f"{value['mean']:.3g}", "-" if few else f"{low:.3g} to {high:.3g}"]
