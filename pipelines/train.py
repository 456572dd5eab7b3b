"""`tossid train`: fit a model, log the run, save its checkpoint."""

from __future__ import annotations

import hashlib
import json
import time
from pathlib import Path
from typing import Any

from pipelines.console import Console
from pipelines.project import dataset_path
from pipelines.schemas import TrainConfig
from tossid.errors import InputError

SAVE_INTERVAL = 10.0
"""Longest time between two saves of a training under way [s]."""


def run(config: TrainConfig, console: Console) -> dict[str, Any]:
    """Train; returns the run's id, checkpoint, model, learned parameters and seconds."""
    data = dataset_path(config.data)

    from pipelines.checkpoints import build_model, read_checkpoint, save_checkpoint
    from pipelines.config import as_plain
    from pipelines.tracking import tracked_run
    from tossid.models.transitions import make_transitions
    from tossid.store import file_sha256, read_dataset
    from tossid.training.fit import Fit, FitSettings

    dataset, sha256 = read_dataset(data), file_sha256(data)
    for split in ("train", "validation"):
        if not dataset.of_split(split):
            raise InputError(f"{data}: no tosses in split '{split}'; training needs at least three tosses")
    model = build_model(config.model, dataset.object, seed=config.seed)
    fit = Fit(
        model,
        make_transitions(dataset.object, dataset.of_split("train")),
        make_transitions(dataset.object, dataset.of_split("validation")),
        FitSettings(epochs=config.epochs, patience=config.patience),
    )
    keys = as_plain(config)
    keys = {name: keys[name] for name in ("model", "seed", "epochs", "patience")}
    digest = hashlib.sha256(json.dumps([keys, sha256], sort_keys=True).encode()).hexdigest()[:12]
    folder = Path("outputs/train") / f"{config.model.name}-{digest}"
    checkpoint = folder / "checkpoint.pt"

    def save(state: dict[str, Any]) -> None:
        save_checkpoint(
            checkpoint, model=model, config=config.model, seed=config.seed, data=data, sha256=sha256, fit=state
        )

    if checkpoint.is_file() and not config.restart:
        state = read_checkpoint(checkpoint)["fit"]
        if state:
            fit.load_state_dict(state)
            console.say(f"{checkpoint}: going on in stage {fit.stage + 1}, epoch {fit.epoch + 1}")
    folder.mkdir(parents=True, exist_ok=True)

    started = saved = time.perf_counter()
    step = 0
    with tracked_run(f"{config.model.name}-g{config.model.gravity:g}", config, command="train") as tracked:
        tracked.data(data, sha256, context="training")
        with console.progress(f"training {config.model.name}", config.epochs * len(fit.stages), unit="epochs") as bar:
            for record in fit.epochs():
                step += 1
                losses = {"train": record.train_loss, "validation": record.validation_loss, **record.parts}
                tracked.metrics({f"{record.stage}/{name}": value for name, value in losses.items()}, step=step)
                bar.advance(1, note=f"{record.stage}: validation loss {record.validation_loss:.3g}")
                if time.perf_counter() - saved > SAVE_INTERVAL:
                    save(fit.state_dict())
                    saved = time.perf_counter()
        save({})
        seconds = time.perf_counter() - started
        parameters = model.parameters_report()
        tracked.text(json.dumps(parameters, indent=1), "parameters.json")
        numbers = {name: value for name, value in parameters.items() if isinstance(value, float)}
        tracked.metrics({**numbers, "seconds": seconds}, step=step)
        tracked.checkpoint(checkpoint)
    console.facts({**numbers, "seconds": round(seconds, 1), "run": tracked.id}, title=f"{config.model.name} on {data}")
    return {
        "run": tracked.id,
        "checkpoint": str(checkpoint),
        "model": config.model.name,
        "parameters": parameters,
        "seconds": seconds,
    }
