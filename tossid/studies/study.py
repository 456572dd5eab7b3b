"""The verb `tossid.study`: many trainings and their evaluations; what is done is kept, and never computed again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from tossid.errors import InputError, TossidError
from tossid.motion.sessions.copies import leak_words
from tossid.outputs import only_writer
from tossid.parallel import as_done
from tossid.settings.changed import changed
from tossid.settings.training import ModelSettings, TrainSettings
from tossid.store import Dataset
from tossid.studies.cells import CellResult, StudyCell, StudyData, compute_cell, find_cell, keep_cell, study_cells
from tossid.studies.result import Study
from tossid.studies.tables import study_row

Submit = Callable[..., Future[Any]]
"""Gives a call to a worker, as `concurrent.futures.Executor.submit`."""
EachCell = Callable[[StudyCell, CellResult | TossidError], Mapping[str, Any] | None]
"""Called with each cell and what it gave, once; what it returns is added to the cell's row."""
Outcomes = Iterator[tuple[StudyCell, CellResult | TossidError]]
"""Cells, each with what it gave."""


def study(
    data: str | Path | Dataset,
    *,
    key: str,
    values: Sequence[float],
    models: Sequence[str] | Mapping[str, str | ModelSettings] = ("cnrpi",),
    seeds: Sequence[int] = (0,),
    settings: TrainSettings = TrainSettings(),
    folder: str | Path | None = None,
    submit: Submit | None = None,
    each_cell: EachCell | None = None,
    **keys: Any,
) -> Study:
    """Train and evaluate each model with each value of a setting and each seed.

    Args:
        data: A dataset with the splits train, validation and test, or the path of its file. Workers read a file for
            themselves.
        key: The setting that is swept, by name: "gravity", "tosses", "model.start_inertia".
        values: Its values.
        models: Variants by name; or by a name of one's own, each a variant or its settings.
        seeds: Of the trainings.
        settings: All else of the trainings.
        folder: Where each cell is kept as soon as it is done. The same call goes on from there, and takes over cells
            that a study in a folder beside it has computed from the same settings, data and code. None keeps nothing.
        submit: Of an executor, to compute several cells at a time: `ProcessPoolExecutor(4).submit`. None computes one
            after another, in this process.
        each_cell: Called with each cell as it is found or done, with what it gave or the error that it ended in. What
            it returns is added to the cell's row.
        **keys: Settings of the trainings by name, such as `epochs=30`.

    Returns:
        A row for each cell, with tables and figures; `save(folder)` writes them.

    Raises:
        ConfigError: Nothing is swept, or the key is no setting or out of range.
        InputError: There are no test tosses, or all cells failed.
        OutputError: Another process computes the same study.
        SolverError: A worker died. What is done is kept.
    """
    of = StudyData.of(data)
    cells = study_cells(of, key=key, values=values, models=models, seeds=seeds, settings=changed(settings, keys))
    return plan_study(cells, of, folder=folder).run(submit=submit, each_cell=each_cell)


def plan_study(cells: Sequence[StudyCell], data: StudyData, *, folder: str | Path | None = None) -> StudyPlan:
    """What a study will compute: cells that ask for more training tosses than there are, are left out.

    Args:
        cells: Of one swept setting.
        data: What they learn from.
        folder: Where each cell is kept; None keeps nothing.

    Raises:
        InputError: There are no test tosses, or no cell is left.
    """
    dataset, where = data.read(), data.path or "the dataset"
    if not dataset.of_split("test"):
        raise InputError(f"{where}: no held-out tosses to evaluate on (split 'test')")
    available, leak = len(dataset.of_split("train")), leak_words(dataset.tosses)
    notes: tuple[str, ...] = () if leak is None else (f"{where}: {leak}",)
    kept = tuple(cell for cell in cells if cell.settings.tosses is None or cell.settings.tosses <= available)
    left_out = sorted({cell.value for cell in cells} - {cell.value for cell in kept})
    if left_out:
        values = ", ".join(f"{value:g}" for value in left_out)
        notes += (f"{where} has {available} training tosses; left out: {values}",)
        if not kept:
            raise InputError(notes[-1])
    return StudyPlan(kept, data, None if folder is None else Path(folder), notes)


class Begun(NamedTuple):
    """A study whose missing cells are given to workers: these cells, and they as they are done."""

    missing: tuple[StudyCell, ...]
    computed: Outcomes


@dataclass(frozen=True)
class StudyPlan:
    """What a study computes.

    Attributes:
        cells: Of one swept setting, in the order of their rows.
        data: What they learn from.
        folder: Where each cell is kept; None keeps nothing.
        notes: What its splits leak by copies, and what was left out, and why.
    """

    cells: tuple[StudyCell, ...]
    data: StudyData
    folder: Path | None = None
    notes: tuple[str, ...] = ()

    def missing(self) -> tuple[StudyCell, ...]:
        """The cells that are not kept yet."""
        return tuple(cell for cell in self.cells if self._kept(cell) is None)

    def begin(self, missing: tuple[StudyCell, ...], submit: Submit | None) -> Begun:
        """Give what is missing to workers (`submit` as of `study`), and do not wait; `run` goes on from there."""
        if submit is not None:  # the longest first, so that no worker is left with one of them at the end
            missing = tuple(sorted(missing, key=_how_much_is_learned, reverse=True))
        return Begun(missing, as_done(partial(compute_cell, data=self.data), missing, submit))

    def run(
        self, *, submit: Submit | None = None, each_cell: EachCell | None = None, begun: Begun | None = None
    ) -> Study:
        """Compute what is missing.

        Args:
            submit: As of `study`.
            each_cell: As of `study`.
            begun: What `begin` returned, if that was done before.

        Raises:
            InputError: All cells failed.
            OutputError: Another process computes the same study.
            SolverError: A worker died. What is done is kept.
        """
        found: dict[StudyCell, tuple[CellResult, Mapping[str, Any]]] = {}
        failed: list[dict[str, Any]] = []
        with nullcontext() if self.folder is None else only_writer(self.folder / "cells"):
            for cell, outcome in self._outcomes(self.begin(self.missing(), submit) if begun is None else begun):
                more = (None if each_cell is None else each_cell(cell, outcome)) or {}
                if isinstance(outcome, TossidError):
                    failed.append({**cell.label, "error": str(outcome)})
                else:
                    found[cell] = outcome, more
        if not found:
            raise InputError(f"all {len(failed)} cells failed; the first: {failed[0]['error']}")
        dataset = self.data.read()
        done = [cell for cell in self.cells if cell in found]
        rows = []
        for cell in done:
            outcome, more = found[cell]
            settings = cell.settings.model
            row = study_row(cell.label, outcome.scores, outcome.history, settings=settings, truth=dataset.object)
            rows.append({**row, **more})
        checkpoints = tuple(found[cell][0].checkpoint for cell in done)
        return Study(done[0].swept, tuple(rows), tuple(failed), dataset.split("test"), checkpoints, self.notes)

    def _outcomes(self, begun: Begun) -> Outcomes:
        """Each cell with what it gave: first what is kept, then what is computed, as it is done."""
        for cell in self.cells:
            kept = None if cell in begun.missing else self._kept(cell)
            if kept is not None:
                yield cell, kept
        for cell, outcome in begun.computed:
            if self.folder is not None and isinstance(outcome, CellResult):
                outcome = keep_cell(cell, outcome, self.folder)
            yield cell, outcome

    def _kept(self, cell: StudyCell) -> CellResult | None:
        return None if self.folder is None else find_cell(cell, self.folder)


def _how_much_is_learned(cell: StudyCell) -> int:
    """In how many respects a cell's model learns: differences by parameters take most of a training's time."""
    model = asdict(cell.settings.model)
    return sum(bool(value) for name, value in model.items() if name.startswith("learn_"))
