"""An object by name, file or settings: which values it has, and where its files are sought."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tossid.errors import ConfigError, FileError
from tossid.objects import OBJECT_FILES, absolute_paths, load_object
from tossid.settings.objects import PRESETS

PUBLISHED_FRICTION = {"cube": 0.18, "elbow": 0.3}
"""The cube's as ContactNets states it, the elbow's as both links of dair_pll's contactnets_elbow.urdf have it."""


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_found_from_any_folder(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    model, preset = load_object(name), PRESETS[name]
    assert (model.name, model.friction, model.restitution, model.width) == (
        name,
        PUBLISHED_FRICTION[name],
        0.0,
        preset.width,
    )
    assert sorted(tag.id for tag in model.tags) == list(range(len(model.tags)))
    assert {tag.body for tag in model.tags} == set(range(model.n_bodies))


def test_the_cubes_tags_lie_in_the_middle_of_its_faces() -> None:
    centres = np.array([tag.T_body_tag[:3, 3] for tag in load_object("cube").tags])
    half = 0.0524
    expected = half * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    np.testing.assert_allclose(centres, expected, atol=1e-12)


def test_a_file_of_the_user_goes_before_tossids_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    own = tmp_path / PRESETS["cube"].path
    own.parent.mkdir(parents=True)
    own.write_text((OBJECT_FILES / "cube.xml").read_text().replace('mass="0.37"', 'mass="0.5"'))
    assert load_object("cube").mass.item() == 0.5


def test_a_file_is_an_object_with_the_values_that_are_stated(tmp_path: Path) -> None:
    shutil.copy(OBJECT_FILES / "elbow.xml", tmp_path / "mine.xml")
    model = load_object(
        str(tmp_path / "mine.xml"), name="mine", friction=0.4, width=0.2, tags=OBJECT_FILES / "elbow_tags.yaml"
    )
    assert (model.name, model.friction, model.width, len(model.tags)) == ("mine", 0.4, 0.2, 20)


def test_what_is_stated_goes_before_a_preset_and_a_loaded_object() -> None:
    assert load_object("cube", restitution=0.3).restitution == 0.3
    assert load_object(load_object("cube"), friction=0.5).friction == 0.5
    assert load_object(replace(PRESETS["cube"], friction=0.5), width=1.0).width == 1.0


def test_a_name_of_nothing_is_said_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"no 'cubes'; expected cube, elbow or a file.*'cube'"):
        load_object("cubes")
    with pytest.raises(FileError, match="no such object file"):
        load_object("cubes.xml")


def test_absolute_paths_mean_the_same_files_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = absolute_paths(PRESETS["elbow"])
    monkeypatch.chdir(tmp_path)
    assert settings.path.is_absolute()
    assert load_object(settings).mjcf == load_object("elbow").mjcf
