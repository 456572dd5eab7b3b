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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.cli.console import Console
from pipelines.commands.cells import study_cells
from pipelines.config.schemas.learning import EvaluateConfig, SweepConfig, TrainConfig
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
from tossid.studies.cells import CellResult, StudyCell, StudyData
from tossid.studies.result import Study
from tossid.studies.study import StudyPlan, plan_study

FOLDER = Path("outputs/sweeps")
CELL_TAG = "tossid.cell"


def run_sweep(config: EvaluateConfig, sweep: SweepConfig, console: Console) -> dict[str, Any]:
    """Compute what is missing, report all; returns the cells and the figures' paths."""
    started = time.perf_counter()
    if config.run is not None:
        raise ConfigError("run", "a study trains its own models; leave it out.")
    study = _open(sweep, dataset_path(config.data))
    plan, folder = study.plan, study.folder
    for note in plan.notes:
        console.warn(note)
    with only_writer(folder / "study"):
        missing = plan.missing()
        console.say(f"{folder}: {len(plan.cells) - len(missing)} of {len(plan.cells)} cells are done")
        with submitting(config.launcher, sweep.workers, len(missing)) as submit, ExitStack() as last:
            begun = plan.begin(missing, submit)  # workers are at work while the tracker opens
            named = f"sweep-{sweep.name}"
            parent = last.enter_context(tracked_run(named, config, command="sweep", resume=run_id_in(folder)))
            import tossid.evaluation.figures  # needed at the end; now workers are at work  # noqa: F401

            bar = last.enter_context(console.progress(f"sweep {sweep.name}", len(plan.cells), unit="cells"))
            runs = CellRuns(study, parent)

            def each(cell: StudyCell, outcome: CellResult | TossidError) -> Mapping[str, Any] | None:
                what = f"{cell.model}, {cell.swept} {cell.value:g}"
                if isinstance(outcome, TossidError):
                    console.warn(f"{what}, seed {cell.seed}: {outcome}")
                row = None if isinstance(outcome, TossidError) else {"run": runs.tracked(cell, outcome)}
                bar.advance(1, note=what)
                return row

            found = plan.run(each_cell=each, begun=begun)
            files = found.save(folder)
            for path in files:
                parent.artifact(path, folder=None if path.parent == folder else path.parent.name)
            parent.metrics({"cells": len(found.rows), "failed": len(found.failed)})
            _track_errors(parent, found, folder / "table.md")
    report = {
        "run": parent.id,
        "sweep": sweep.name,
        "key": sweep.key,
        "data": str(study.data),
        **found.as_json(),
        "out": str(folder),
        "figures": [str(path) for path in files if path.parent != folder],
        "seconds": time.perf_counter() - started,
    }
    _show(sweep, found, report, console)
    return report


@dataclass(frozen=True)
class OpenStudy:
    """A study with its data and its place."""

    name: str
    data: Path
    sha256: str
    configs: dict[StudyCell, TrainConfig]
    plan: StudyPlan
    folder: Path


def _open(sweep: SweepConfig, data: Path) -> OpenStudy:
    of = StudyData.of(data)
    configs = study_cells(sweep, data, of.sha256)
    plan = plan_study(list(configs), of)
    folder = FOLDER / f"{sweep.name}-{digest_of([sweep.key, *[cell.digest for cell in plan.cells]])[:12]}"
    return OpenStudy(sweep.name, data, of.sha256, configs, replace(plan, folder=folder), folder)


class CellRuns:
    """The runs of a study's cells in MLflow, below the study's own; each cell is logged once.

    Cells that an earlier command has logged are known by their tag. What it had half logged when it was killed goes.

    Args:
        study: The study.
        parent: Its run.
    """

    def __init__(self, study: OpenStudy, parent: TrackedRun) -> None:
        self._study, self._parent = study, parent
        self._of_cell: dict[str, str] = {}
        if not parent.resumed:
            parent.data(study.data, study.sha256, context="study")
            write_whole(study.folder / RUN, (json.dumps({"run": parent.id}) + "\n").encode())
            return
        for run in find_runs(parent=parent.id):
            if run.info.status == "FINISHED":
                self._of_cell[run.data.tags[CELL_TAG]] = run.info.run_id
            else:
                client().delete_run(run.info.run_id)

    def tracked(self, cell: StudyCell, got: CellResult) -> str:
        """Log a cell, unless it is logged already; returns its run's id.

        Args:
            cell: The cell.
            got: What it gave.
        """
        if cell.digest in self._of_cell:
            return self._of_cell[cell.digest]
        name = f"{cell.model}-{cell.swept}{cell.value:g}-s{cell.seed}"
        tags = {"sweep": self._study.name, CELL_TAG: cell.digest}
        with tracked_run(name, self._study.configs[cell], command="train", parent=self._parent, tags=tags) as run:
            run.data(self._study.data, self._study.sha256, context="training")
            for step, row in enumerate(got.history, start=1):
                run.metrics(EpochRecord(**row).losses(), step=step)
            run.metrics(metric_means(got.scores), step=len(got.history))
            run.text(json.dumps(got.scores, indent=1), "result.json")
            assert isinstance(got.checkpoint, Path)  # a study with a folder keeps it there
            run.checkpoint(got.checkpoint)
        self._of_cell[cell.digest] = run.id
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
