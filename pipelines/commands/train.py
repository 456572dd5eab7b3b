"""`tossid train`: fit a model, log the run, save its checkpoint."""

from __future__ import annotations

import json
import shutil
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from pipelines.cli.console import Console
from pipelines.config.compose import as_plain, part_of
from pipelines.config.schemas import TrainConfig
from pipelines.files.project import dataset_path
from pipelines.tracking.runs import CHECKPOINT, CONFIG, RUN, TRAININGS
from tossid import budget
from tossid.errors import FileError, InputError
from tossid.plain_json import digest_of
from tossid.settings.training import TrainSettings

if TYPE_CHECKING:
    from pipelines.tracking.run import TrackedRun
    from tossid.models import EpochRecord, TrainedModel
    from tossid.training.api import Epoch
    from tossid.training.fit import Fit

SAVE_EVERY_S = 10.0
"""Longest time between two saves of a training in progress [s]; what stops it saves too."""
SCHEMA = "tossid.training/2"
STATE = "state.pt"


class Unfinished:
    """The folder of a training that has not finished: its run's id, and its state after the last saved epoch.

    Args:
        folder: Where they are.
        code: Digest of the code that trains. What other code has left is not gone on with.
    """

    def __init__(self, folder: Path, *, code: str) -> None:
        self.folder, self.code = folder, code
        self.run: str | None = None
        self.state: dict[str, Any] | None = None

    def recall(self) -> bool:
        """Read the run and the state that are kept here; says whether other code has left something else.

        Raises:
            FileError: The file is damaged, or none of ours.
        """
        path = self.folder / STATE
        if not path.is_file():
            return False
        import torch

        budget.check_archive(path)
        try:
            content = torch.load(path, weights_only=True)
        except Exception as error:
            problem = f"not the readable state of a training ({type(error).__name__}); restart=true starts anew"
            raise FileError(path, problem) from error
        if not isinstance(content, dict) or not str(content.get("schema")).startswith(SCHEMA.partition("/")[0]):
            raise FileError(path, f"not a training's state of schema {SCHEMA}; restart=true starts anew")
        if (content["schema"], content.get("code")) != (SCHEMA, self.code):
            return True
        self.run, self.state = content["run"], content["state"]
        return False

    def save(self, run: str, state: dict[str, Any] | None) -> None:
        """Keep a state, whole or not at all.

        Args:
            run: The run's id.
            state: Of `tossid.training.api.Epoch`; None before the first.
        """
        from tossid.models.trained import tensor_bytes
        from tossid.outputs import write_whole

        content = {"schema": SCHEMA, "code": self.code, "run": run, "state": state}
        write_whole(self.folder / STATE, tensor_bytes(content))

    def clear(self) -> None:
        """Forget it: the training has finished, or starts anew."""
        shutil.rmtree(self.folder, ignore_errors=True)


def run(config: TrainConfig, console: Console) -> dict[str, Any]:
    """Train; returns the run's id, checkpoint, model, learned parameters, seconds and figures."""
    data = dataset_path(config.data)

    from tossid.code_digest import code_digest
    from tossid.outputs import only_writer
    from tossid.store import file_sha256, read_dataset
    from tossid.training.api import prepare

    dataset, sha256 = read_dataset(data), file_sha256(data)
    try:
        fit = prepare(dataset, part_of(config, TrainSettings))
    except InputError as error:
        raise InputError(f"{data}: {error}") from error
    if "copies" in fit.remarks:
        console.warn(f"{data}: {fit.remarks['copies']['warning']}")
    unknown = fit.settings.object
    if unknown is not None and config.object is None:
        said = f"states no object: it is learned as object=unknown object.links={unknown.links} learns it"
        console.say(f"{data}: {said}, with a mass of {unknown.mass:g} kg (object.mass says another)")
    folder = TRAININGS / f"{config.model.name}-{digest_of([as_plain(part_of(config, TrainSettings)), sha256])[:12]}"
    with only_writer(folder / "training"):
        unfinished = Unfinished(folder / "under_way", code=code_digest())
        if config.restart:
            unfinished.clear()
        elif unfinished.recall():
            console.say(
                f"{unfinished.folder}: the code, or a package that computes, has changed since; training begins anew"
            )
            unfinished.clear()
        return _train(replace(config, data=data), console, fit, sha256, folder, unfinished)


def _train(
    config: TrainConfig, console: Console, fit: Fit, sha256: str, folder: Path, unfinished: Unfinished
) -> dict[str, Any]:
    """The training with its run; `unfinished` keeps what an interrupted one needs."""
    from pipelines.drawing.figures import training_figures, write_figures, write_hull_film
    from pipelines.tracking.run import tracked_run
    from tossid.outputs import move_files, write_whole

    assert config.data is not None
    name, left, done = config.model.name, unfinished.run, _epochs(unfinished.state)
    with tracked_run(f"{name}-g{config.model.gravity:g}", config, command="train", resume=left) as tracked:
        if tracked.resumed:
            console.say(f"{unfinished.folder}: going on with run {tracked.id}, {done} done")
        elif left is not None:
            console.say(f"{unfinished.folder}: {done} done; run {left} is not in this store, {tracked.id} is new")
        if not tracked.resumed:
            tracked.data(config.data, sha256, context="training")
        trained = _fit(config, console, fit, unfinished, tracked)
        trained = replace(trained, data=config.data, sha256=sha256)
        made = unfinished.folder / "made"
        write_whole(made / CONFIG, yaml.safe_dump(as_plain(config), sort_keys=False, allow_unicode=True).encode())
        write_whole(made / RUN, (json.dumps({"run": tracked.id}) + "\n").encode())
        checkpoint = trained.save(made / CHECKPOINT)
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
        tracked.artifact(checkpoint)
        tracked.artifact(made / "figures")
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


def _fit(config: TrainConfig, console: Console, fit: Fit, unfinished: Unfinished, tracked: TrackedRun) -> TrainedModel:
    """Train with a progress bar; the state is saved now and then, and when something stops the training."""
    from tossid.models import EpochRecord
    from tossid.training.api import fit_model

    latest, saved = unfinished.state, time.perf_counter()
    unfinished.save(tracked.id, latest)
    done = latest["history"] if latest else []
    logged = tracked.last_step()

    def log(step: int, record: EpochRecord) -> None:
        if step > logged:
            tracked.metrics(record.losses(), step=step)

    for step, row in enumerate(done, start=1):
        log(step, EpochRecord(**row))
    with console.progress(f"training {config.model.name}", fit.most_epochs, unit="epochs") as bar:
        bar.advance(len(done))

        def each_epoch(epoch: Epoch) -> None:
            nonlocal latest, saved
            latest = epoch.state()
            log(epoch.number, epoch.record)
            bar.advance(1, note=f"{epoch.record.stage}: validation loss {epoch.record.validation_loss:.3g}")
            if time.perf_counter() - saved > SAVE_EVERY_S:
                unfinished.save(tracked.id, latest)
                saved = time.perf_counter()

        try:
            return fit_model(fit, each_epoch=each_epoch, state=unfinished.state)
        except BaseException:
            unfinished.save(tracked.id, latest)
            raise


def _show_intervals(trained: TrainedModel, console: Console) -> None:
    found = trained.parameters.get("uncertainty")
    if found is None:
        return
    known = {key: each for key, each in found["intervals"].items() if each["ci95"] is not None}
    words = {key: "{:.3g} ({:.3g} to {:.3g})".format(each["value"], *each["ci95"]) for key, each in known.items()}
    console.facts(words, title=found["method"])
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
