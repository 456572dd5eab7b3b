"""A small dataset with all splits, and cells that cost nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from tests.models.made import tosses
from tossid.objects import ObjectModel
from tossid.store import Dataset
from tossid.studies.cells import CellResult, StudyCell, StudyData


def dataset(cube: ObjectModel, *, train: int = 4) -> Dataset:
    """Exact tosses of the cube: some to train on, two to stop by, two held out."""
    splits = ["train"] * train + ["validation"] * 2 + ["test"] * 2
    made = tosses(cube, len(splits), seed=3, frames=40)
    return Dataset(cube, tuple(replace(t, split=s) for t, s in zip(made, splits, strict=True)), 148.0, "made")


def computed(cell: StudyCell, data: StudyData) -> CellResult:
    """What a cell gives whose error is its value."""
    metric = {"mean": cell.value, "ci95": [cell.value - 1, cell.value + 1], "n": 2}
    names = ("gravity_ms2", "position_error_pct", "rotation_error_deg", "penetration_mm")
    scores: dict[str, Any] = {"n_tosses": 2, **dict.fromkeys(names, metric), "parameters": {}, "seconds": 1.0}
    return CellResult(scores, [{"stage": "contact", "validation_loss": 0.5}], b"a checkpoint")
