"""Cells of a study: which there are, what identifies them, and that what is kept whole is found again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from tests.studies.made import computed, dataset
from tossid.errors import ConfigError, FileError
from tossid.models import variant
from tossid.objects import ObjectModel
from tossid.settings.training import TrainSettings
from tossid.studies import cells
from tossid.studies.cells import (
    CELL,
    CHECKPOINT,
    CONFIG,
    StudyCell,
    StudyData,
    find_cell,
    keep_cell,
    memory_sha256,
    study_cells,
)

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
