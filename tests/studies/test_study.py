"""Studies: cells, what identifies them, the verb that goes on where it was, and its tables."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pytest
import yaml

import tossid
from tests.studies.made import computed, dataset
from tossid.errors import ConfigError, DivergedError, FileError, InputError, OutputError
from tossid.models import variant
from tossid.objects import ObjectModel
from tossid.outputs import only_writer
from tossid.settings.training import TrainSettings
from tossid.studies import cells
from tossid.studies import study as studies
from tossid.studies.cells import (
    CELL,
    CHECKPOINT,
    CONFIG,
    CellResult,
    StudyCell,
    StudyData,
    find_cell,
    keep_cell,
    memory_sha256,
    study_cells,
)
from tossid.studies.study import study

DATA = StudyData(None, Path("x.h5"), "hash of the data")


def digests(**keys: object) -> list[str]:
    asked = {"key": "gravity", "values": [4.905, 9.81], "models": ["cn", "cnrp"], "data": DATA, **keys}
    return [cell.digest for cell in study_cells(asked.pop("data"), **asked)]  # type: ignore[arg-type]


def test_cells_come_in_the_order_models_values_seeds() -> None:
    found = study_cells(DATA, key="model.gravity", values=[0.0, 9.81], models=["cn", "cnrpi"], seeds=[0, 1])
    assert [cell.label for cell in found[:3]] == [
        {"model": "cn", "seed": 0, "gravity": 0.0},
        {"model": "cn", "seed": 1, "gravity": 0.0},
        {"model": "cn", "seed": 0, "gravity": 9.81},
    ]
    assert len(found) == 8
    assert {(c.settings.model.gravity, c.settings.seed) for c in found} == {(0.0, 0), (0.0, 1), (9.81, 0), (9.81, 1)}
    named = study_cells(DATA, key="tosses", values=[2], models={"stiff": replace(variant("cn"), gravity=3.0)})
    assert (named[0].model, named[0].settings.model.gravity, named[0].settings.tosses) == ("stiff", 3.0, 2)


def test_a_digest_depends_on_settings_data_and_code_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    one = digests()
    assert len(set(one)) == 4
    assert digests(settings=TrainSettings(threads=3)) == one
    for other in (
        digests(data=replace(DATA, sha256="other")),
        digests(seeds=[1]),
        digests(settings=TrainSettings(epochs=3)),
    ):
        assert not set(other) & set(one)
    monkeypatch.setattr(cells, "code_digest", lambda *modules: "changed")
    assert not set(digests()) & set(one)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"values": []}, "values: is empty"),
        ({"seeds": [1, 1]}, "seeds: names one twice"),
        ({"key": "gravty"}, "Did you mean 'gravity'?"),
        ({"values": [-1.0]}, "gravity: -1"),
        ({"models": ["cnx"]}, "cnx"),
    ],
)
def test_wrong_studies(keys: dict[str, object], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        digests(**keys)


def test_data_in_memory_are_known_again_by_all_that_they_hold(cube: ObjectModel) -> None:
    one = dataset(cube)
    first, *rest = one.tosses
    assert memory_sha256(one) == memory_sha256(dataset(cube))
    moved = first.q.copy()
    moved[3, 2] += 1e-12
    for other in (
        replace(one, tosses=(replace(first, q=moved), *rest)),
        replace(one, tosses=(replace(first, split="test"), *rest)),
        replace(one, tosses=(replace(first, q_cov=first.q_cov + 1e-9), *rest)),
        replace(one, object=cube.with_changes(mass=2 * cube.mass)),
    ):
        assert memory_sha256(other) != memory_sha256(one)


def test_a_file_that_changes_during_a_study_is_refused(cube: ObjectModel, tmp_path: Path) -> None:
    path = tmp_path / "tosses.h5"
    dataset(cube).save(path)
    data = StudyData.of(path)
    dataset(cube, train=3).save(path)
    with pytest.raises(FileError, match="is not the file that the study began with"):
        data.read()


@pytest.fixture
def cell() -> StudyCell:
    return study_cells(DATA, key="gravity", values=[9.81], models=["cn"])[0]


def test_a_kept_cell_is_found_in_its_study_and_from_one_beside_it(cell: StudyCell, tmp_path: Path) -> None:
    assert find_cell(cell, tmp_path / "one") is None
    kept = keep_cell(cell, computed(cell, DATA), tmp_path / "one")
    assert isinstance(kept.checkpoint, Path)
    assert kept.checkpoint.read_bytes() == b"a checkpoint"
    assert yaml.safe_load((kept.checkpoint.parent / CONFIG).read_text())["model"]["gravity"] == 9.81
    for name in ("one", "another"):
        assert find_cell(cell, tmp_path / name) == kept
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


# ---------------------------------------------------------------- the verb


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


def test_an_executor_begins_with_the_cells_that_learn_most(cube: ObjectModel, counted: list[str]) -> None:
    with ThreadPoolExecutor(1) as pool:
        found = study(dataset(cube), **ASKED, submit=pool.submit)
    assert counted == ["cnrp 0", "cnrp 9.81", "cn 0", "cn 9.81"]
    assert [row["model"] for row in found.rows] == ["cn", "cn", "cnrp", "cnrp"]


@pytest.mark.usefixtures("counted")
def test_cells_that_ask_for_more_tosses_than_there_are_are_left_out(cube: ObjectModel) -> None:
    found = study(dataset(cube), key="tosses", values=[2, 4, 64], models=["cn"])
    assert [row["tosses"] for row in found.rows] == [2, 4]
    assert "has 4 training tosses; left out: 64" in found.notes[0]
    with pytest.raises(InputError, match="left out: 64"):
        study(dataset(cube), key="tosses", values=[64], models=["cn"])


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


def test_two_processes_do_not_write_one_study_and_copies_between_splits_are_noted(
    cube: ObjectModel, counted: list[str], tmp_path: Path
) -> None:
    some = dataset(cube)
    with only_writer(tmp_path / "one" / "cells"), pytest.raises(OutputError, match="cells"):
        study(some, **ASKED, folder=tmp_path / "one")
    assert counted == []
    assert study(some, **ASKED).notes == ()
    copy = replace(some.of_split("train")[0], name="copy", split="test")
    (note,) = study(replace(some, tosses=(*some.tosses, copy)), **ASKED).notes
    assert "test tosses equal one of train or validation" in note
