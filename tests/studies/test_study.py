"""The verb `study`: it goes on where it was, by one process and by many, with the same numbers."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pytest

import tossid
from tests.studies.made import computed, dataset
from tossid.errors import DivergedError, InputError, OutputError
from tossid.objects import ObjectModel
from tossid.outputs import only_writer
from tossid.studies import study as studies
from tossid.studies.cells import CellResult, StudyCell, StudyData
from tossid.studies.study import study

ASKED: dict[str, Any] = {"key": "gravity", "values": [0.0, 9.81], "models": ["cn", "cnrp"]}


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Labels of the cells that are computed; the computation itself costs nothing."""
    seen: list[str] = []

    def count(cell: StudyCell, data: StudyData) -> CellResult:
        seen.append(f"{cell.model} {cell.value:g}")
        return computed(cell, data)

    monkeypatch.setattr(studies, "compute_cell", count)
    return seen


def test_an_interrupted_study_goes_on_where_it_was(cube: ObjectModel, counted: list[str], tmp_path: Path) -> None:
    def stop_at_second(cell: StudyCell, outcome: object) -> None:
        if len(counted) == 2:
            raise KeyboardInterrupt

    data = dataset(cube)
    with pytest.raises(KeyboardInterrupt):
        study(data, **ASKED, folder=tmp_path / "one", each_cell=stop_at_second)
    assert counted == ["cn 0", "cn 9.81"]
    whole = study(data, **ASKED, folder=tmp_path / "one")
    assert counted == ["cn 0", "cn 9.81", "cnrp 0", "cnrp 9.81"]
    assert [(row["model"], row["gravity"]) for row in whole.rows] == [
        ("cn", 0.0), ("cn", 9.81), ("cnrp", 0.0), ("cnrp", 9.81),
    ]  # fmt: skip
    again = study(data, **ASKED, folder=tmp_path / "one")
    assert len(counted) == 4
    assert again.rows == whole.rows
    longer = study(data, **{**ASKED, "values": [0.0, 9.81, 19.62]}, folder=tmp_path / "longer")
    assert counted[4:] == ["cn 19.62", "cnrp 19.62"]
    assert len(longer.rows) == 6


def test_a_cell_that_fails_is_reported_and_tried_again(
    cube: ObjectModel, counted: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def diverge(cell: StudyCell, data: StudyData) -> CellResult:
        if cell.model == "cnrp":
            raise DivergedError("the loss became nan")
        return computed(cell, data)

    count = studies.compute_cell
    monkeypatch.setattr(studies, "compute_cell", diverge)
    seen: list[tuple[str, bool]] = []

    def each(cell: StudyCell, outcome: object) -> dict[str, Any]:
        seen.append((cell.model, isinstance(outcome, CellResult)))
        return {"place": len(seen)}

    found = study(dataset(cube), **ASKED, folder=tmp_path / "one", each_cell=each)
    assert seen == [("cn", True), ("cn", True), ("cnrp", False), ("cnrp", False)]
    assert [row["place"] for row in found.rows] == [1, 2]
    assert found.failed[1] == {"model": "cnrp", "seed": 0, "gravity": 9.81, "error": "the loss became nan"}
    with pytest.raises(InputError, match="all 2 cells failed; the first: the loss became nan"):
        study(dataset(cube), **{**ASKED, "models": ["cnrp"]})
    monkeypatch.setattr(studies, "compute_cell", count)
    assert len(study(dataset(cube), **ASKED, folder=tmp_path / "one").rows) == 4
    assert counted == ["cnrp 0", "cnrp 9.81"]


def test_any_executor_computes_it(cube: ObjectModel, counted: list[str]) -> None:
    with ThreadPoolExecutor(3) as pool:
        found = study(dataset(cube), **ASKED, submit=pool.submit)
    assert sorted(counted) == ["cn 0", "cn 9.81", "cnrp 0", "cnrp 9.81"]
    assert [row["gravity"] for row in found.rows] == [0.0, 9.81, 0.0, 9.81]


def test_an_executor_begins_with_the_cells_that_learn_most(cube: ObjectModel, counted: list[str]) -> None:
    with ThreadPoolExecutor(1) as pool:
        found = study(dataset(cube), **ASKED, submit=pool.submit)
    assert counted == ["cnrp 0", "cnrp 9.81", "cn 0", "cn 9.81"]
    assert [row["model"] for row in found.rows] == ["cn", "cn", "cnrp", "cnrp"]


def test_two_processes_do_not_write_one_study(cube: ObjectModel, counted: list[str], tmp_path: Path) -> None:
    with only_writer(tmp_path / "one" / "cells"), pytest.raises(OutputError, match="cells"):
        study(dataset(cube), **ASKED, folder=tmp_path / "one")
    assert counted == []


@pytest.mark.usefixtures("counted")
def test_cells_that_ask_for_more_tosses_than_there_are_are_left_out(cube: ObjectModel) -> None:
    found = study(dataset(cube), key="tosses", values=[2, 4, 64], models=["cn"])
    assert [row["tosses"] for row in found.rows] == [2, 4]
    assert "has 4 training tosses; left out: 64" in found.notes[0]
    with pytest.raises(InputError, match="left out: 64"):
        study(dataset(cube), key="tosses", values=[64], models=["cn"])


@pytest.mark.usefixtures("counted")
def test_copies_between_splits_are_noted(cube: ObjectModel) -> None:
    assert study(dataset(cube), **ASKED).notes == ()
    some = dataset(cube)
    copy = replace(some.of_split("train")[0], name="copy", split="test")
    (note,) = study(replace(some, tosses=(*some.tosses, copy)), **ASKED).notes
    assert "test tosses equal one of train or validation" in note


def test_processes_give_the_numbers_of_this_one(cube: ObjectModel, tmp_path: Path) -> None:
    path = tmp_path / "tosses.h5"
    dataset(cube).save(path)
    asked: dict[str, Any] = {**ASKED, "models": ["cn"], "epochs": 1, "horizons": ()}
    here = tossid.study(path, **asked)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        apart = tossid.study(path, **asked, folder=tmp_path / "study", submit=pool.submit)
    assert [{**row, "seconds": 0} for row in apart.rows] == [{**row, "seconds": 0} for row in here.rows]
    assert here.rows[0]["position_error_pct"]["mean"] != here.rows[1]["position_error_pct"]["mean"]
    assert apart.model(0).parameters == here.model(0).parameters
    assert apart.model(0).data == path
