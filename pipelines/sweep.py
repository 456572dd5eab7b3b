"""`tossid evaluate --sweep NAME`: a study, cell by cell.

Results lie in `outputs/sweeps/NAME-DIGEST`: a folder for each cell, and the
whole as `cells.json`, `cells.csv`, `table.md` and figures. A cell that is done, in this
study or in another, is never computed again. MLflow gets a run for the study
and a nested one for each cell; only the command writes to it, never a worker.
"""

from __future__ import annotations

import io
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipelines.calling import digest_of, jsonable
from pipelines.cells import SCHEMA, Cell, Computed, compute_all, study_cells
from pipelines.console import Console
from pipelines.evaluate import means
from pipelines.mlflow_store import client
from pipelines.outputs import only_writer, output_file
from pipelines.project import dataset_path
from pipelines.runs import find_runs
from pipelines.schemas import EvaluateConfig, SweepConfig
from pipelines.tables import csv_table, inertia_errors, markdown_table, validation_loss
from pipelines.tracking import TrackedRun, tracked_run
from tossid.errors import ConfigError, InputError, TossidError
from tossid.objects import GRAVITY, corner_positions
from tossid.store import file_sha256, read_dataset
from tossid.types import Dataset

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
        raise InputError(f"{data}: no held-out tosses to judge (split 'test')")
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
    import torch
    import yaml

    from pipelines.checkpoints import build_model, save_checkpoint
    from pipelines.config import as_plain
    from pipelines.runs import CHECKPOINT, CONFIG

    folder = study.folder / "cells" / cell.name
    model = build_model(cell.config.model, study.dataset.object, seed=cell.seed)
    model.load_state_dict(torch.load(io.BytesIO(computed.state), weights_only=True))
    save_checkpoint(
        folder / CHECKPOINT,
        model=model,
        config=cell.config.model,
        seed=cell.seed,
        data=study.data,
        sha256=study.sha256,
        fit={},
    )
    _write(folder / CONFIG, yaml.safe_dump(as_plain(cell.config), sort_keys=False, allow_unicode=True))
    content = {"schema": SCHEMA, "digest": cell.digest, "result": computed.result, "history": computed.history}
    content = jsonable(content)
    _write(folder / CELL, json.dumps(content, indent=1) + "\n")
    return {**content, "folder": str(folder)}


def _track(study: Study, cell: Cell, stored: dict[str, Any], parent: TrackedRun, runs: dict[str, Any]) -> None:
    """Log a cell as a run under the study's, once."""
    if cell.digest in runs["cells"]:
        return
    from pipelines.learning import numbers_of
    from pipelines.runs import CHECKPOINT
    from tossid.training.fit import EpochRecord

    name = f"{cell.model}-{study.swept}{cell.value:g}-s{cell.seed}"
    tags = {"sweep": study.sweep.name, CELL_TAG: cell.digest}
    with tracked_run(name, cell.config, command="train", parent=parent, tags=tags) as run:
        run.data(study.data, study.sha256, context="training")
        for step, row in enumerate(stored["history"], start=1):
            run.metrics(numbers_of(EpochRecord(**row)), step=step)
        run.metrics(means(stored["result"]), step=len(stored["history"]))
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
    from pipelines.pictures import sweep_figures, write_figures

    done = [cell for cell in study.cells if cell.digest in results]
    cells = [_row(study, cell, results[cell.digest], run=runs["cells"][cell.digest]) for cell in done]
    depth = _measured_penetration(study.dataset)
    pictures = sweep_figures(study.sweep.key, cells, measured_penetration_mm=depth)
    if study.sweep.key == "model.gravity":
        pictures |= _residual_of_worst_given(study, done, results)
    figures = write_figures(pictures, study.folder / "figures")
    report: dict[str, Any] = {
        "run": parent.id,
        "sweep": study.sweep.name,
        "key": study.sweep.key,
        "data": str(study.data),
        "n_tosses": len(study.dataset.of_split("test")),
        "split": "test",
        "measured": {"penetration_mm": depth},
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


def _row(study: Study, cell: Cell, stored: dict[str, Any], *, run: str) -> dict[str, Any]:
    """A cell as it is reported."""
    row = {"model": cell.model, "seed": cell.seed, study.swept: cell.value, **stored["result"]}
    if study.sweep.key == "model.start_inertia" and "inertia_kgm2" in row["parameters"]:
        row |= inertia_errors(cell.config.model, row["parameters"], study.dataset.object)
    return {**row, "validation_loss": validation_loss(stored["history"]), "run": run}


def _residual_of_worst_given(study: Study, done: list[Cell], results: dict[str, Any]) -> dict[str, Figure]:
    """What the residual repairs, of the cell that was given the most wrong gravity."""
    from pipelines.checkpoints import load_checkpoint
    from pipelines.learning import evaluate_model
    from pipelines.pictures import gravity_given, residual_figure
    from pipelines.runs import CHECKPOINT

    able = [cell for cell in done if cell.config.model.name in ("cnrp", "cnrpi")]
    if not able:
        return {}
    worst = max(able, key=lambda cell: abs(cell.value - GRAVITY))
    model = load_checkpoint(Path(results[worst.digest]["folder"]) / CHECKPOINT).model
    tosses = study.dataset.of_split("test")
    judged = evaluate_model(model, study.dataset.object, tosses)
    name = f"{worst.config.model.name.upper()}, {gravity_given(worst.value)}"
    return residual_figure(model, judged, tosses, name=name)


def _measured_penetration(dataset: Dataset) -> float:
    """Mean over held-out tosses of the measured motions' own penetration, as `penetration_mm` [mm]."""
    tosses = dataset.of_split("test")
    lowest = [corner_positions(dataset.object, toss.q)[..., 2].min(axis=1) for toss in tosses]
    return float(np.mean([1e3 * np.maximum(-height, 0).mean() for height in lowest]))


def _show(study: Study, report: dict[str, Any], console: Console) -> None:
    """Means over seeds, for a person."""
    metrics = ["gravity_ms2", "position_error_pct", "rotation_error_deg", "penetration_mm"]
    if all("inertia_error_rel" in cell for cell in report["cells"]):
        metrics = ["inertia_error_rel", "com_error_m", *metrics[1:3]]
    rows = []
    for model, value in dict.fromkeys((cell["model"], cell[study.swept]) for cell in report["cells"]):
        same = [cell for cell in report["cells"] if (cell["model"], cell[study.swept]) == (model, value)]
        found = [[c[name]["mean"] if isinstance(c[name], dict) else c[name] for c in same] for name in metrics]
        known = [[number for number in part if number is not None] for part in found]
        rows.append([model, f"{value:g}", *[f"{np.mean(part):.3g}" if part else "-" for part in known]])
    seeds = len(study.sweep.seeds)
    title = f"{study.sweep.name}: {report['n_tosses']} held-out tosses" + (f", means of {seeds} seeds" * (seeds > 1))
    console.table(["model", study.swept, *metrics], rows, title=title)
    trained = sum(cell["seconds"] for cell in report["cells"])
    console.facts(
        {
            "tables": f"{report['out']}/table.md, cells.csv",
            "figures": report["figures"],
            "run": report["run"],
            "took": f"{report['seconds']:.0f} s now; all trainings together {trained:.0f} s",
        }
    )
