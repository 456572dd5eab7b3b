"""`tossid train`: fit a model, log the run, save its checkpoint."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.cli.console import Console
from pipelines.config.schemas import TrainConfig
from pipelines.files.project import dataset_path
from pipelines.tracking.runs import TRAININGS
from tossid.errors import InputError
from tossid.plain_json import digest_of
from tossid.settings.training import TrainSettings

if TYPE_CHECKING:
    from pipelines.files.resume import Unfinished
    from pipelines.tracking.run import TrackedRun
    from tossid.models import EpochRecord, TrainedModel
    from tossid.training.api import Epoch
    from tossid.training.fit import Fit


def run(config: TrainConfig, console: Console) -> dict[str, Any]:
    """Train; returns the run's id, checkpoint, model, learned parameters, seconds and figures."""
    data = dataset_path(config.data)

    from pipelines.files.resume import Unfinished
    from tossid.code_digest import code_digest
    from tossid.outputs import only_writer
    from tossid.store import file_sha256, read_dataset
    from tossid.training.api import prepare

    dataset, sha256 = read_dataset(data), file_sha256(data)
    try:
        fit = prepare(dataset, config.settings())
    except InputError as error:
        raise InputError(f"{data}: {error}") from error
    if "copies" in fit.remarks:
        console.warn(f"{data}: {fit.remarks['copies']['warning']}")
    unknown = fit.settings.object
    if unknown is not None and config.object is None:
        said = f"states no object: it is learned as object=unknown object.links={unknown.links} learns it"
        console.say(f"{data}: {said}, with a mass of {unknown.mass:g} kg (object.mass says another)")
    folder = TRAININGS / f"{config.model.name}-{digest_of([learning_keys(config), sha256])[:12]}"
    with only_writer(folder / "training"):
        unfinished = Unfinished(folder / "under_way", code=code_digest())
        if unfinished.of_other_code():
            console.say(
                f"{unfinished.folder}: the code, or a package that computes, has changed since; training begins anew"
            )
        if config.restart or unfinished.of_other_code():
            unfinished.clear()
        return _train(replace(config, data=data), console, fit, sha256, folder, unfinished)


def _train(
    config: TrainConfig, console: Console, fit: Fit, sha256: str, folder: Path, unfinished: Unfinished
) -> dict[str, Any]:
    """The training with its run; `unfinished` keeps what an interrupted one needs."""
    from pipelines.drawing.figures import training_figures, write_figures, write_hull_film
    from pipelines.tracking.run import tracked_run
    from tossid.outputs import move_files

    assert config.data is not None
    name, left, state = config.model.name, unfinished.run(), unfinished.state()
    with tracked_run(f"{name}-g{config.model.gravity:g}", config, command="train", resume=left) as tracked:
        if tracked.resumed:
            console.say(f"{unfinished.folder}: going on with run {tracked.id}, {_epochs(state)} done")
        elif left is not None:
            console.say(
                f"{unfinished.folder}: {_epochs(state)} done; run {left} is not in this store, {tracked.id} is new"
            )
        if not tracked.resumed:
            tracked.data(config.data, sha256, context="training")
        unfinished.begin(tracked.id)
        trained = _fit(config, console, fit, unfinished, state, logger(tracked))
        trained = replace(trained, data=config.data, sha256=sha256)
        made = unfinished.folder / "made"
        checkpoint = write_outputs(made, config, trained, run=tracked.id)
        figures = write_figures(training_figures(trained, name=name), made / "figures")
        if fit.unknown is not None and not trained.object.n_joints:
            figures.append(write_hull_film(trained, fit.true_tosses, made / "figures" / "hull_over_tosses.gif"))
        numbers = {key: value for key, value in trained.parameters.items() if isinstance(value, float)}
        tracked.metrics({**numbers, "seconds": trained.seconds}, step=len(trained.history))
        tracked.text(json.dumps(trained.parameters, indent=1), "parameters.json")
        tracked.describe(
            f"`{name}`, learned from `{config.data}`. Its shape is `figures/learned_geometry.png`, under Artifacts.",
            ("learned", "value"),
            [(key, f"{value:.4g}") for key, value in numbers.items()],
        )
        tracked.checkpoint(checkpoint)
        for path in figures:
            tracked.artifact(path, folder="figures")
        tracked.flush()
        move_files(made, folder)  # only now, so that all of an earlier training stays if something fails
        unfinished.clear()
    facts = {**numbers, "seconds": round(trained.seconds, 1), "run": tracked.id, "figures": str(folder / "figures")}
    console.facts(facts, title=f"{name} on {config.data}")
    _show_intervals(trained, console)
    _show_convergence(trained, console)
    return {
        "run": tracked.id,
        "checkpoint": str(folder / checkpoint.name),
        "model": name,
        "parameters": trained.parameters,
        "geometry": trained.parameters.get("geometry", []),
        "converged": trained.converged,
        "seconds": trained.seconds,
        "figures": [str(folder / path.relative_to(made)) for path in figures],
    }


def _fit(
    config: TrainConfig,
    console: Console,
    fit: Fit,
    unfinished: Unfinished,
    state: dict[str, Any] | None,
    log: Callable[[int, EpochRecord], None],
) -> TrainedModel:
    """Train with a progress bar; the state is saved now and then, and when something stops the training."""
    from tossid.models import EpochRecord
    from tossid.training.api import fit_model

    latest, saved = state, time.perf_counter()
    done = state["history"] if state else []
    for step, row in enumerate(done, start=1):
        log(step, EpochRecord(**row))
    with console.progress(f"training {config.model.name}", fit.most_epochs, unit="epochs") as bar:
        bar.advance(len(done))

        def each_epoch(epoch: Epoch) -> None:
            nonlocal latest, saved
            latest = epoch.state()
            log(epoch.number, epoch.record)
            bar.advance(1, note=f"{epoch.record.stage}: validation loss {epoch.record.validation_loss:.3g}")
            if time.perf_counter() - saved > config.save_every_s:
                unfinished.save(latest)
                saved = time.perf_counter()

        try:
            return fit_model(fit, each_epoch=each_epoch, state=state)
        except BaseException:
            if latest is not None:
                unfinished.save(latest)
            raise


def logger(tracked: TrackedRun) -> Callable[[int, EpochRecord], None]:
    """Logs the losses of an epoch, given its number, unless the run has them."""
    logged = tracked.last_step()

    def log(step: int, record: EpochRecord) -> None:
        if step > logged:
            tracked.metrics(record.losses(), step=step)

    return log


def learning_keys(config: TrainSettings) -> dict[str, Any]:
    """The keys that decide, with the data, what is learned."""
    from pipelines.config.compose import as_plain

    own = {field.name for field in fields(TrainSettings)}
    return {name: value for name, value in as_plain(config).items() if name in own}


def _show_intervals(trained: TrainedModel, console: Console) -> None:
    found = trained.parameters.get("uncertainty")
    if found is None:
        return
    rows = [
        [key, f"{each['value']:.3g}", f"{each['ci95'][0]:.3g} to {each['ci95'][1]:.3g}"]
        for key, each in found["intervals"].items()
        if each["ci95"] is not None
    ]
    if rows:
        console.table(["learned from rollouts", "value", "95 % interval"], rows, title=found["method"])
    console.say(f"not determined: {found['not_determined']}")


def _show_convergence(trained: TrainedModel, console: Console) -> None:
    """Warn where training has not converged; say what was started again, and which corners no toss has shown."""
    size = trained.parameters.get("stated_size")
    if size is not None:
        console.warn(size["warning"])
    off = trained.parameters.get("from_nothing", {}).get("rest_off_ground_m", {})
    if off:
        console.warn(
            f"{len(off)} tosses come to rest up to {1e3 * max(map(abs, off.values())):.0f} mm off the ground with the "
            f"shape that the others show: {', '.join([*off][:5])}"
        )
    found = trained.parameters.get("convergence")
    if found is None:
        return
    from tossid.training.restarts import UNDETERMINED

    for restart in found["restarts"]:
        if restart["what"] == UNDETERMINED:
            console.warn(
                f"{restart['what']}: these tosses are too few to learn them. Validation tosses are predicted no better "
                "than with friction alone, so they stay as before"
            )
            continue
        count = f"{restart['moved']} corners" if restart["what"] == "corners" else restart["what"]
        console.say(f"{restart['stage']}: {count} started again")
    unseen = sum(not seen for link in trained.parameters["geometry"] for seen in link["seen"])
    if unseen:
        console.warn(f"{unseen} learned corners never came down to the ground: no toss decides where they are")
    for reason in found["reasons"]:
        console.warn(f"not converged: {reason}")


def _epochs(state: dict[str, Any] | None) -> str:
    count = len(state["history"]) if state else 0
    return f"{count} epoch{'' if count == 1 else 's'}"


def write_outputs(folder: Path, config: TrainConfig, trained: TrainedModel, *, run: str) -> Path:
    """Write checkpoint, config and run id, so that the folder can be named as a run; returns the checkpoint."""
    import yaml

    from pipelines.config.compose import as_plain
    from pipelines.tracking.runs import CHECKPOINT, CONFIG, RUN
    from tossid.outputs import output_file

    trained.save(folder / CHECKPOINT)
    texts = {CONFIG: yaml.safe_dump(as_plain(config), sort_keys=False, allow_unicode=True)}
    texts[RUN] = json.dumps({"run": run}) + "\n"
    for name, text in texts.items():
        with output_file(folder / name) as temporary:
            temporary.write_text(text)
    return folder / CHECKPOINT
