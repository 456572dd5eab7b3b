"""A study's folder: what is whole is found again, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from tests.studies.made import computed
from tossid.studies.cells import StudyCell, StudyData, study_cells
from tossid.studies.kept import CELL, CHECKPOINT, CONFIG, find_cell, keep_cell

DATA = StudyData(None, Path("x.h5"), "hash of the data")


@pytest.fixture
def cell() -> StudyCell:
    return study_cells(DATA, key="gravity", values=[9.81], models=["cn"])[0]


def test_a_kept_cell_is_found_in_its_study_and_from_one_beside_it(cell: StudyCell, tmp_path: Path) -> None:
    assert find_cell(cell, tmp_path / "one") is None
    kept = keep_cell(cell, computed(cell, DATA), tmp_path / "one")
    assert isinstance(kept.checkpoint, Path)
    assert kept.checkpoint.read_bytes() == b"a checkpoint"
    assert yaml.safe_load((kept.checkpoint.parent / CONFIG).read_text())["model"]["gravity"] == 9.81
    for study in ("one", "another"):
        assert find_cell(cell, tmp_path / study) == kept
    assert find_cell(replace(cell, digest=cell.digest[:12] + "of other code"), tmp_path / "one") is None


@pytest.mark.parametrize("text", ["", "[]", '{"schema": "tossid.cell/0"}'])
def test_what_is_not_whole_is_not_found(cell: StudyCell, tmp_path: Path, text: str) -> None:
    place = tmp_path / "one" / "cells" / cell.name
    keep_cell(cell, computed(cell, DATA), tmp_path / "one")
    (place / CELL).write_text(text)
    assert find_cell(cell, tmp_path / "one") is None
    (place / CELL).unlink()  # killed between the checkpoint and the numbers
    assert (place / CHECKPOINT).is_file()
    assert find_cell(cell, tmp_path / "one") is None
