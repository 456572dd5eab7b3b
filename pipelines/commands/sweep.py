"""`tossid evaluate --sweep NAME`: a study, cell by cell.

Results lie in `outputs/sweeps/NAME-DIGEST`: a folder for each cell, and the
whole as `cells.json`, `cells.csv`, `table.md` and figures. A cell that is done, in this
study or in another, is never computed again. MLflow gets a run for the study
and a nested one for each cell; only the command writes to it, never a worker.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipelines.cli.call import digest_of
from pipelines.cli.console import Console
from pipelines.commands.cells import SCHEMA, Cell, Computed, compute_all, study_cells
from pipelines.config.schemas import EvaluateConfig, SweepConfig
from pipelines.files.project import dataset_path
from pipelines.tracking.mlflow_store import client
from pipelines.tracking.run import TrackedRun, tracked_run
from pipelines.tracking.runs import find_runs
from tossid.errors import ConfigError, InputError, TossidError
from tossid.outputs import only_writer, output_file, write_whole
from tossid.plain_json import jsonable
from tossid.store import Dataset, file_sha256, read_dataset

FOLDER = Path("outputs/sweeps")
CELL = "cell.json"
RUNS = "runs.json"
CELL_TAG = "tossid.cell"


@dataclass(frozen=True)
class Study:
    """A study with its data and its place."""

    sweep: SweepConfig
    data: Path
    sha256: str
    dataset: Dataset
    cells: tuple[Cell, ...]
    folder: Path

    @property
    def swept(self) -> str:
        """What the swept value is called in a cell: "gravity" for model.gravity."""
        return self.sweep.key.rpartition(".")[2]


def run_sweep(config: EvaluateConfig, sweep: SweepConfig, console: Console) -> dict[str, Any]:
    """Compute what is missing, report all; returns the cells and the figures' paths."""
    started = time.perf_counter()
    if config.run is not None:
        raise ConfigError("run", "a study trains its own models; leave it out.")
    study = _open(config, sweep, console)
    with only_writer(study.folder / "study"):
        results = {cell.digest: found for cell in study.cells if (found := _stored(cell)) is not None}
        console.say(f"{study.folder}: {len(results)} of {len(study.cells)} cells are done")
        runs = _runs(study)
        failed: list[dict[str, Any]] = []
        with tracked_run(f"sweep-{sweep.name}", config, command="sweep", resume=runs.get("run")) as parent:
            if not parent.resumed:
                parent.data(study.data, study.sha256, context="study")
                runs = {"run": parent.id, "cells": {}}
                _write(study.folder / RUNS, json.dumps(runs) + "\n")
            else:
                _recall(parent, runs)
            for cell in study.cells:
                if cell.digest in results:
                    _track(study, cell, results[cell.digest], parent, runs)
            missing = [cell for cell in study.cells if cell.digest not in results]
            computed = compute_all(missing, sha256=study.sha256, workers=sweep.workers, launcher=config.launcher)
            with console.progress(f"sweep {sweep.name}", len(study.cells), unit="cells") as bar:
                bar.advance(len(results))
                for cell, outcome in computed:
                    if isinstance(outcome, TossidError):
                        failed.append({"model": cell.model, "seed": cell.seed, study.swept: cell.value})
                        failed[-1]["error"] = str(outcome)
                        console.warn(f"{cell.model}, {study.swept} {cell.value:g}, seed {cell.seed}: {outcome}")
                    else:
                        results[cell.digest] = _keep(study, cell, outcome)
                        _track(study, cell, results[cell.digest], parent, runs)
                    bar.advance(1, note=f"{cell.model}, {study.swept} {cell.value:g}")
            if not results:
                raise InputError(f"all {len(failed)} cells failed; the first: {failed[0]['error']}")
            report = _report(study, results, runs, failed, parent)
    report["seconds"] = time.perf_counter() - started
    _show(study, report, console)
    return report


def _open(config: EvaluateConfig, sweep: SweepConfig, console: Console) -> Study:
    data = dataset_path(config.data)
    dataset, sha256 = read_dataset(data), file_sha256(data)
    if not dataset.of_split("test"):
        raise InputError(f"{data}: no held-out tosses to evaluate on (split 'test')")
    cells = study_cells(sweep, data, sha256)
    there = len(dataset.of_split("train"))
    kept = tuple(cell for cell in cells if cell.config.tosses is None or cell.config.tosses <= there)
    left_out = sorted({cell.value for cell in cells} - {cell.value for cell in kept})
    if left_out:
        what = f"{data} has {there} training tosses; left out: {', '.join(f'{value:g}' for value in left_out)}"
        if not kept:
            raise InputError(what)
        console.warn(what)
    digest = digest_of([sweep.key, *[cell.digest for cell in kept]])[:12]
    return Study(sweep, data, sha256, dataset, kept, FOLDER / f"{sweep.name}-{digest}")


# ---------------------------------------------------------------- a cell on disk and in MLflow


def _stored(cell: Cell) -> dict[str, Any] | None:
    """A cell that any study has computed."""
    for path in sorted(FOLDER.glob(f"*/cells/{cell.name}/{CELL}")):
        try:
            found = json.loads(path.read_text())
        except (OSError, ValueError):
            continue
        if isinstance(found, dict) and found.get("schema") == SCHEMA and found.get("digest") == cell.digest:
            return {**found, "folder": str(path.parent)}
    return None


def _keep(study: Study, cell: Cell, computed: Computed) -> dict[str, Any]:
    """Write a cell: its checkpoint and config, and last, as the sign that all is there, its numbers."""
    import yaml

    from pipelines.config.compose import as_plain
    from pipelines.tracking.runs import CHECKPOINT, CONFIG

    folder = study.folder / "cells" / cell.name
    write_whole(folder / CHECKPOINT, computed.checkpoint)
    _write(folder / CONFIG, yaml.safe_dump(as_plain(cell.config), sort_keys=False, allow_unicode=True))
    content = {"schema": SCHEMA, "digest": cell.digest, "result": computed.result, "history": computed.history}
    content = jsonable(content)
    _write(folder / CELL, json.dumps(content, indent=1) + "\n")
    return {**content, "folder": str(folder)}


def _track(study: Study, cell: Cell, stored: dict[str, Any], parent: TrackedRun, runs: dict[str, Any]) -> None:
    """Log a cell as a run under the study's, once."""
    if cell.digest in runs["cells"]:
        return
    from pipelines.tracking.runs import CHECKPOINT
    from tossid.evaluation.evaluate import metric_means
    from tossid.models import EpochRecord

    name = f"{cell.model}-{study.swept}{cell.value:g}-s{cell.seed}"
    tags = {"sweep": study.sweep.name, CELL_TAG: cell.digest}
    with tracked_run(name, cell.config, command="train", parent=parent, tags=tags) as run:
        run.data(study.data, study.sha256, context="training")
        for step, row in enumerate(stored["history"], start=1):
            run.metrics(EpochRecord(**row).losses(), step=step)
        run.metrics(metric_means(stored["result"]), step=len(stored["history"]))
        run.text(json.dumps(stored["result"], indent=1), "result.json")
        run.checkpoint(Path(stored["folder"]) / CHECKPOINT)
    runs["cells"][cell.digest] = run.id
    _write(study.folder / RUNS, json.dumps(runs, indent=1) + "\n")


def _recall(parent: TrackedRun, runs: dict[str, Any]) -> None:
    """Know the runs of cells that a killed command had logged and not noted; what it had half logged goes."""
    for run in find_runs(parent=parent.id):
        digest = run.data.tags.get(CELL_TAG)
        if digest is None or digest in runs["cells"]:
            continue
        if run.info.status == "FINISHED":
            runs["cells"][digest] = run.info.run_id
        else:
            client().delete_run(run.info.run_id)


def _runs(study: Study) -> dict[str, Any]:
    """The runs that this study has in MLflow: its own, and each cell's by digest."""
    try:
        runs = json.loads((study.folder / RUNS).read_text())
        return {"run": str(runs["run"]), "cells": dict(runs["cells"])}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _write(path: Path, text: str) -> None:
    with output_file(path) as temporary:
        temporary.write_text(text)


# ---------------------------------------------------------------- the whole


def _report(
    study: Study, results: dict[str, Any], runs: dict[str, Any], failed: list[dict[str, Any]], parent: TrackedRun
) -> dict[str, Any]:
    """The study's table, figures and JSON, on disk and in MLflow."""
    from pipelines.drawing.figures import write_figures
    from pipelines.tracking.runs import CHECKPOINT
    from tossid import TrainedModel
    from tossid.evaluation.study import csv_table, markdown_table, measured_penetration
    from tossid.evaluation.study_figures import study_figures

    done = {runs["cells"][cell.digest]: cell for cell in study.cells if cell.digest in results}
    cells = [{**_row(study, cell, results[cell.digest]), "run": run} for run, cell in done.items()]
    held_out = study.dataset.split("test")

    def model_of(cell: Mapping[str, Any]) -> TrainedModel:
        return TrainedModel.load(Path(results[done[cell["run"]].digest]["folder"]) / CHECKPOINT)

    figures = write_figures(study_figures(study.swept, cells, held_out, model_of=model_of), study.folder / "figures")
    report: dict[str, Any] = {
        "run": parent.id,
        "sweep": study.sweep.name,
        "key": study.sweep.key,
        "data": str(study.data),
        "n_tosses": len(held_out.tosses),
        "split": "test",
        "measured": {"penetration_mm": measured_penetration(held_out.tosses, held_out.object)},
        "cells": cells,
        "failed": failed,
        "out": str(study.folder),
        "figures": [str(path) for path in figures],
    }
    _write(study.folder / "cells.json", json.dumps(jsonable(cells), indent=1) + "\n")
    _write(study.folder / "cells.csv", csv_table(cells, study.swept))
    _write(study.folder / "table.md", markdown_table(cells, study.swept))
    for name in ("cells.json", "cells.csv", "table.md"):
        parent.artifact(study.folder / name)
    for path in figures:
        parent.artifact(path, folder="figures")
    parent.metrics({"cells": len(cells), "failed": len(failed)})
    return report


def _row(study: Study, cell: Cell, stored: dict[str, Any]) -> dict[str, Any]:
    """A cell as it is reported."""
    from tossid.evaluation.study import study_cell

    about = {"model": cell.model, "seed": cell.seed, study.swept: cell.value}
    settings, truth = cell.config.model, study.dataset.object
    return study_cell(about, stored["result"], stored["history"], settings=settings, truth=truth)


def _show(study: Study, report: dict[str, Any], console: Console) -> None:
    """Means over seeds, for a person."""
    from tossid.evaluation.study import seed_means

    head, rows = seed_means(report["cells"], study.swept)
    seeds = len(study.sweep.seeds)
    title = f"{study.sweep.name}: {report['n_tosses']} held-out tosses" + (f", means of {seeds} seeds" * (seeds > 1))
    console.table(head, rows, title=title)
    trained = sum(cell["seconds"] for cell in report["cells"])
    console.facts(
        {
            "tables": f"{report['out']}/table.md, cells.csv",
            "figures": report["figures"],
            "run": report["run"],
            "took": f"{report['seconds']:.0f} s now; all trainings together {trained:.0f} s",
        }
    )
