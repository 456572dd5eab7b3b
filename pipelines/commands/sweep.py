"""`tossid evaluate --sweep NAME`: gives the cells of a study to workers; tracks and prints what is found.

Results lie in `outputs/sweeps/NAME-DIGEST`: a folder for each cell, and the whole as `cells.json`, `cells.csv`,
`table.md` and figures. A cell that is done, in this study or in another, is never computed again (`tossid.studies`).
MLflow gets a run for the study and a nested one for each cell; only the command writes to it, never a worker.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.cli.console import Console
from pipelines.config.compose import as_plain, load, part_of
from pipelines.config.schemas import EvaluateConfig, SweepConfig, TrainConfig
from pipelines.execution.workers import submitting
from pipelines.files.project import dataset_path
from pipelines.tracking.mlflow_store import client
from pipelines.tracking.run import TrackedRun, tracked_run
from pipelines.tracking.runs import RUN, find_runs, run_id_in
from tossid.errors import ConfigError, TossidError
from tossid.evaluation.evaluate import metric_means
from tossid.models import EpochRecord
from tossid.outputs import only_writer, write_whole
from tossid.plain_json import digest_of
from tossid.settings.changed import changed
from tossid.settings.training import TrainSettings
from tossid.studies.cells import CellResult, StudyCell, StudyData, study_cell
from tossid.studies.result import Study
from tossid.studies.study import plan_study

FOLDER = Path("outputs/sweeps")
CELL_TAG = "tossid.cell"


def run_sweep(config: EvaluateConfig, sweep: SweepConfig, console: Console) -> dict[str, Any]:
    """Compute what is missing, report all; returns the cells and the figures' paths."""
    started = time.perf_counter()
    if config.run is not None:
        raise ConfigError("run", "a study trains its own models; leave it out.")
    path = dataset_path(config.data)
    data = StudyData.of(path)
    configs = study_cells(sweep, path, data.sha256)
    plan = plan_study(list(configs), data)
    folder = FOLDER / f"{sweep.name}-{digest_of([sweep.key, *[cell.digest for cell in plan.cells]])[:12]}"
    plan = replace(plan, folder=folder)
    for note in plan.notes:
        console.warn(note)
    with only_writer(folder / "study"):
        missing = plan.missing()
        console.say(f"{folder}: {len(plan.cells) - len(missing)} of {len(plan.cells)} cells are done")
        with submitting(config.launcher, sweep.workers, len(missing)) as submit, ExitStack() as last:
            begun = plan.begin(missing, submit)  # workers are at work while the tracker opens
            named = f"sweep-{sweep.name}"
            parent = last.enter_context(tracked_run(named, config, command="sweep", resume=run_id_in(folder)))
            bar = last.enter_context(console.progress(f"sweep {sweep.name}", len(plan.cells), unit="cells"))
            logged = _logged_cells(parent)
            if not parent.resumed:
                parent.data(path, data.sha256, context="study")
                write_whole(folder / RUN, (json.dumps({"run": parent.id}) + "\n").encode())

            def each(cell: StudyCell, outcome: CellResult | TossidError) -> Mapping[str, Any] | None:
                what = f"{cell.model}, {cell.swept} {cell.value:g}"
                bar.advance(1, note=what)
                if isinstance(outcome, TossidError):
                    console.warn(f"{what}, seed {cell.seed}: {outcome}")
                    return None
                if cell.digest not in logged:
                    tags = {"sweep": sweep.name, CELL_TAG: cell.digest}
                    logged[cell.digest] = _log_cell(cell, outcome, configs[cell], data.sha256, parent, tags)
                return {"run": logged[cell.digest]}

            found = plan.run(each_cell=each, begun=begun)
            files = found.save(folder)
            for file in files:
                parent.artifact(file, folder=None if file.parent == folder else file.parent.name)
            parent.metrics({"cells": len(found.rows), "failed": len(found.failed)})
            _track_errors(parent, found, folder / "table.md")
    report = {
        "run": parent.id,
        "sweep": sweep.name,
        "key": sweep.key,
        "data": str(path),
        **found.as_json(),
        "out": str(folder),
        "figures": [str(file) for file in files if file.parent != folder],
        "seconds": time.perf_counter() - started,
    }
    _show(sweep, found, report, console)
    return report


_OWN = ("data", "restart", "model", "seed")
"""Keys of train that a study sets itself."""


def study_cells(sweep: SweepConfig, data: Path, sha256: str) -> dict[StudyCell, TrainConfig]:
    """The cells of a study with the keys of their trainings, in the order models, values, seeds.

    Args:
        sweep: The study's keys.
        data: The dataset.
        sha256: Of the dataset.

    Raises:
        ConfigError: Nothing is swept, or `tossid train` would refuse a key.
    """
    _check(sweep)
    cells = {}
    for model in sweep.models:
        first = f"{sweep.key}={_number(sweep.values[0])}"
        name, *keys = model.split()
        base = replace(load("train", TrainConfig, [f"model={name}", first, *sweep.train, *keys]), data=data)
        for value in sweep.values:
            for seed in sweep.seeds:
                config = changed(base, {sweep.key: _number(value), "seed": seed})
                cell = study_cell(
                    model, sweep.key, value, part_of(config, TrainSettings), sha256, keys=as_plain(config)
                )
                cells[cell] = config
    return cells


def _check(sweep: SweepConfig) -> None:
    for name in ("values", "models", "seeds"):
        if not getattr(sweep, name):
            raise ConfigError(f"sweep.{name}", "is empty; a study needs at least one.")
        if len(set(getattr(sweep, name))) < len(getattr(sweep, name)):
            raise ConfigError(f"sweep.{name}", "names one twice.")
    own = [text for model in sweep.models for text in model.split()[1:]]
    for where, texts in (("sweep.train", sweep.train), ("sweep.key", [f"{sweep.key}="]), ("sweep.models", own)):
        for text in texts:
            if text.partition("=")[0] in _OWN:
                raise ConfigError(where, f"{text.partition('=')[0]} is set by the study itself.")


def _number(value: float) -> int | float:
    return int(value) if value.is_integer() else value


def _logged_cells(parent: TrackedRun) -> dict[str, str]:
    """The runs of cells that an earlier command has logged below a study's run, by the cell's digest.

    What it had half logged when it was killed is deleted.
    """
    logged = {}
    for run in find_runs(parent=parent.id):
        if run.info.status == "FINISHED":
            logged[run.data.tags[CELL_TAG]] = run.info.run_id
        else:
            client().delete_run(run.info.run_id)
    return logged


def _log_cell(
    cell: StudyCell, got: CellResult, config: TrainConfig, sha256: str, parent: TrackedRun, tags: Mapping[str, str]
) -> str:
    """Log what a cell gave below the study's run; returns the id of its own."""
    name = f"{cell.model}-{cell.swept}{cell.value:g}-s{cell.seed}"
    with tracked_run(name, config, command="train", parent=parent, tags=tags) as run:
        assert config.data is not None
        run.data(config.data, sha256, context="training")
        for step, row in enumerate(got.history, start=1):
            run.metrics(EpochRecord(**row).losses(), step=step)
        run.metrics(metric_means(got.scores), step=len(got.history))
        run.text(json.dumps(got.scores, indent=1), "result.json")
        assert isinstance(got.checkpoint, Path)  # a study with a folder keeps it there
        run.artifact(got.checkpoint)
    return run.id


ERRORS = ("position_error_pct", "rotation_error_deg")


def _track_errors(parent: TrackedRun, found: Study, table: Path) -> None:
    """Log errors by model, means over seeds: a curve each, whose steps number the swept values; and the table."""
    values = sorted({row[found.swept] for row in found.rows})
    for step, value in enumerate(values):
        for name in ERRORS:
            of_model: dict[str, list[float]] = {}
            for row in found.rows:
                if row[found.swept] == value:
                    model = re.sub(r"[^\w./: -]", "_", row["model"])  # MLflow bears no other letters
                    of_model.setdefault(f"{name}/{model}", []).append(row[name]["mean"])
            parent.metrics({key: float(np.mean(errors)) for key, errors in of_model.items()}, step=step)
    steps = ", ".join(f"{step} is {value:g}" for step, value in enumerate(values))
    parent.describe(f"Steps of the curves number the swept {found.swept}: {steps}.\n\n{table.read_text()}")


def _show(sweep: SweepConfig, found: Study, report: Mapping[str, Any], console: Console) -> None:
    """Means over seeds, for a person."""
    seeds = len(sweep.seeds)
    title = f"{sweep.name}: {report['n_tosses']} held-out tosses" + (f", means of {seeds} seeds" * (seeds > 1))
    console.table(*found.table(), title=title)
    trained = sum(row["seconds"] for row in found.rows)
    console.facts(
        {
            "tables": f"{report['out']}/table.md, cells.csv",
            "figures": report["figures"],
            "run": report["run"],
            "took": f"{report['seconds']:.0f} s now; all trainings together {trained:.0f} s",
        }
    )
