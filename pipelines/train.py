"""`tossid train`: fit a model, log the run, save its checkpoint."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.calling import digest_of
from pipelines.console import Console
from pipelines.project import dataset_path
from pipelines.schemas import TrainConfig
from tossid.errors import InputError

if TYPE_CHECKING:
    from pipelines.learning import Trained
    from pipelines.under_way import UnderWay
    from tossid.training.fit import EpochRecord, Fit

FOLDER = Path("outputs/train")

SAVE_INTERVAL = 10.0
"""Longest time between two saves of a training under way [s]; an interrupt saves too."""


def run(config: TrainConfig, console: Console) -> dict[str, Any]:
    """Train; returns the run's id, checkpoint, model, learned parameters, seconds and figures."""
    data = dataset_path(config.data)

    from pipelines.learning import learning_keys, prepare
    from pipelines.outputs import only_writer
    from pipelines.under_way import UnderWay
    from tossid.store import file_sha256, read_dataset

    dataset, sha256 = read_dataset(data), file_sha256(data)
    try:
        fit = prepare(dataset, config, n_threads=os.cpu_count() or 1)
    except InputError as error:
        raise InputError(f"{data}: {error}") from error
    digest = digest_of([learning_keys(config), sha256])[:12]
    folder = FOLDER / f"{config.model.name}-{digest}"
    with only_writer(folder / "training"):
        under_way = UnderWay(folder / "under_way")
        if config.restart:
            under_way.clear()
        return _train(config, console, fit, data, sha256, folder, under_way)


def _train(
    config: TrainConfig,
    console: Console,
    fit: Fit,
    data: Path,
    sha256: str,
    folder: Path,
    under_way: UnderWay,
) -> dict[str, Any]:
    """The training with its run; `under_way` keeps what an interrupted one needs."""
    from pipelines.learning import numbers_of
    from pipelines.pictures import training_figures, write_figures
    from pipelines.tracking import tracked_run
    from tossid.training.uncertainty import parameter_intervals

    name, left, state = config.model.name, under_way.run(), under_way.state()
    with tracked_run(f"{name}-g{config.model.gravity:g}", config, command="train", resume=left) as tracked:
        if tracked.resumed:
            console.say(f"{under_way.folder}: going on with run {tracked.id}, {_epochs(state)} done")
        elif left is not None:
            console.say(
                f"{under_way.folder}: {_epochs(state)} done; run {left} is not in this store, {tracked.id} is new"
            )
        if not tracked.resumed:
            tracked.data(data, sha256, context="training")
        under_way.begin(tracked.id)
        logged = tracked.last_step()

        def log(step: int, record: EpochRecord) -> None:
            if step > logged:
                tracked.metrics(numbers_of(record), step=step)

        trained = _fit(config, console, fit, under_way, state, log)
        parameters = trained.model.parameters_report()
        known = parameter_intervals(fit, seed=config.seed)
        if known is not None:
            parameters["uncertainty"] = known
        files = write_outputs(folder, config, trained, data=data, sha256=sha256, run=tracked.id)
        figures = write_figures(training_figures(trained, name=name), folder / "figures")
        numbers = {key: value for key, value in parameters.items() if isinstance(value, float)}
        tracked.metrics({**numbers, "seconds": trained.seconds}, step=len(trained.history))
        tracked.text(json.dumps(parameters, indent=1), "parameters.json")
        tracked.checkpoint(files)
        for path in figures:
            tracked.artifact(path, folder="figures")
        tracked.flush()
        under_way.clear()
    facts = {**numbers, "seconds": round(trained.seconds, 1), "run": tracked.id, "figures": str(folder / "figures")}
    console.facts(facts, title=f"{name} on {data}")
    if known is not None:
        rows = [
            [key, f"{each['value']:.3g}", f"{each['ci95'][0]:.3g} to {each['ci95'][1]:.3g}"]
            for key, each in known["intervals"].items()
        ]
        console.table(["learned from rollouts", "value", "95 % interval"], rows, title=known["method"])
        for text in known["not_seen"]:
            console.say(f"not seen: {text}")
    return {
        "run": tracked.id,
        "checkpoint": str(files),
        "model": name,
        "parameters": parameters,
        "seconds": trained.seconds,
        "figures": [str(path) for path in figures],
    }


def _fit(
    config: TrainConfig,
    console: Console,
    fit: Fit,
    under_way: UnderWay,
    state: dict[str, Any] | None,
    log: Callable[[int, EpochRecord], None],
) -> Trained:
    """Fit with progress; the state is kept now and then, and when the fit is stopped."""
    from pipelines.learning import train_model
    from tossid.training.fit import EpochRecord

    latest, saved = state, time.perf_counter()
    for step, row in enumerate(state["history"] if state else [], start=1):
        log(step, EpochRecord(**row))
    with console.progress(f"training {config.model.name}", config.epochs * len(fit.stages), unit="epochs") as bar:
        bar.advance(len(state["history"]) if state else 0)

        def watch(step: int, record: EpochRecord, state_now: Callable[[], dict[str, Any]]) -> None:
            nonlocal latest, saved
            latest = state_now()
            log(step, record)
            bar.advance(1, note=f"{record.stage}: validation loss {record.validation_loss:.3g}")
            if time.perf_counter() - saved > SAVE_INTERVAL:
                under_way.save(latest)
                saved = time.perf_counter()

        try:
            return train_model(fit, state=state, watch=watch)
        except KeyboardInterrupt:
            if latest is not None:
                under_way.save(latest)
            raise


def _epochs(state: dict[str, Any] | None) -> str:
    count = len(state["history"]) if state else 0
    return f"{count} epoch{'' if count == 1 else 's'}"


def write_outputs(folder: Path, config: TrainConfig, trained: Trained, *, data: Path, sha256: str, run: str) -> Path:
    """Write checkpoint, config and run id, so that the folder can be named as a run; returns the checkpoint."""
    import yaml

    from pipelines.checkpoints import save_checkpoint
    from pipelines.config import as_plain
    from pipelines.outputs import output_file
    from pipelines.runs import CHECKPOINT, CONFIG, RUN

    texts = {CONFIG: yaml.safe_dump(as_plain(config), sort_keys=False, allow_unicode=True)}
    texts[RUN] = json.dumps({"run": run}) + "\n"
    save_checkpoint(
        folder / CHECKPOINT,
        model=trained.model,
        config=config.model,
        seed=config.seed,
        data=data,
        sha256=sha256,
        fit={},
    )
    for name, text in texts.items():
        with output_file(folder / name) as temporary:
            temporary.write_text(text)
    return folder / CHECKPOINT
