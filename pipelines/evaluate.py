"""`tossid evaluate`: open-loop rollouts of a trained model on held-out tosses."""

from __future__ import annotations

from typing import Any

from pipelines.console import Console
from pipelines.project import dataset_path
from pipelines.schemas import EvaluateConfig
from tossid.errors import FileError, InputError


def run(config: EvaluateConfig, console: Console) -> dict[str, Any]:
    """Evaluate; returns CONTRACT.md's metrics."""
    from pipelines.checkpoints import load_checkpoint
    from pipelines.runs import find_run
    from pipelines.tracking import tracked_run
    from tossid.evaluation.metrics import score_tosses, summarize_scores
    from tossid.store import file_sha256, read_dataset

    record = find_run(config.run)
    if record.checkpoint is None:
        raise InputError(f"run {record.name} ({record.id or record.folder}) has no checkpoint")
    trained = load_checkpoint(record.checkpoint)
    if config.data is None:
        data, split = trained.data, "test"
        if not data.is_file():
            raise FileError(data, "the run's dataset is gone; name one with data=FILE.h5")
        sha256 = file_sha256(data)
        if sha256 != trained.sha256:
            raise FileError(data, "the run's dataset has changed since training; name it with data=FILE.h5")
    else:
        data, split = dataset_path(config.data), "all"
        sha256 = file_sha256(data)
    dataset = read_dataset(data)
    tosses = dataset.of_split("test") if split == "test" else dataset.tosses
    if not tosses:
        raise InputError(f"{data}: no held-out tosses to judge")

    system, nominal = trained.model.system(), dataset.object
    scores = score_tosses(system, nominal, tosses)
    metrics = summarize_scores(scores)
    result: dict[str, Any] = {
        "run": record.id,
        "model": trained.config.name,
        "data": str(data),
        "n_tosses": len(tosses),
        "split": split,
        **metrics,
        "unsolved": scores.unsolved,
        "diverged": scores.diverged,
        "parameters": trained.model.parameters_report(),
    }
    if nominal.n_joints == 0:
        result["from_flight"] = summarize_scores(score_tosses(system, nominal, tosses, from_flight=True))
    with tracked_run(f"evaluate-{record.name}", config, command="evaluate") as tracked:
        tracked.data(data, sha256, context="evaluation")
        tracked.tag("evaluated_run", record.id)
        tracked.metrics({name: value["mean"] for name, value in metrics.items()})
    rows = [
        [name, f"{value['mean']:.3g}", f"{value['ci95'][0]:.3g} to {value['ci95'][1]:.3g}"]
        for name, value in metrics.items()
    ]
    console.table(["metric", "mean", "95 % interval"], rows, title=f"{trained.config.name}: {len(tosses)} tosses")
    return result
