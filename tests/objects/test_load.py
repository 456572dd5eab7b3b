"""An object by name, file or settings, beside a recording, and its tags."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tossid.errors import ConfigError, FileError, ObjectError
from tossid.objects import OBJECT_FILES, absolute_paths, load_object, read_tags, recorded_object, write_object
from tossid.settings.objects import PRESETS
from tossid.vision.setup.layout import object_tags
from tossid.vision.setup.tagslam import read_tagslam

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


SOUND = "name: box\npath: object.xml\nfriction: 0.2\nrestitution: 0.0\nwidth: null\ntags: null\n"


def test_an_object_comes_back(tmp_path: Path) -> None:
    elbow = load_object("elbow")
    write_object(elbow, elbow.mjcf, tmp_path)
    (tmp_path / "tagslam.yaml").write_bytes((OBJECT_FILES / "elbow_tags.yaml").read_bytes())
    settings = recorded_object(tmp_path)
    assert settings is not None
    assert settings.path == tmp_path / "object.xml"
    again, model = load_object(settings), load_object("elbow")
    assert (again.name, again.friction, again.width, len(again.tags)) == ("elbow", 0.3, 0.1, len(model.tags))
    assert again.mjcf == model.mjcf


def test_a_folder_without_one_has_none(tmp_path: Path) -> None:
    assert recorded_object(tmp_path) is None


@pytest.mark.parametrize(
    ("was", "now", "says"),
    [
        ("path: object.xml", f"path: {'x' * 300}", "path: .* will not do"),
        ("friction: 0.2", "friction: -0.2", "friction: -0.2 is out of range"),
        ("friction: 0.2", "friction: much", "friction: 'much' will not do; expected a number"),
        ("tags: null", "mass: 3", "mass: there is no such key"),
    ],
)
def test_what_is_no_object_is_said(tmp_path: Path, was: str, now: str, says: str) -> None:
    (tmp_path / "object.yaml").write_text(SOUND.replace(was, now))
    with pytest.raises(FileError, match=says):
        recorded_object(tmp_path)


POSE = "{position: {x: 0.1, y: 0, z: 0}, rotation: {x: 0, y: 0, z: 1.5707963267948966}}"


def written(folder: Path, bodies: str) -> Path:
    path = folder / "tagslam.yaml"
    path.write_text(f"bodies:\n{bodies}")
    return path


@pytest.mark.parametrize("name", ["cube", "elbow"])
def test_the_tags_are_those_that_the_reader_of_whole_scenes_finds(name: str) -> None:
    path, names = OBJECT_FILES / f"{name}_tags.yaml", load_object(name).body_names
    for ours, theirs in zip(read_tags(path, names), object_tags(read_tagslam(path), names), strict=True):
        assert (ours.id, ours.size, ours.body) == (theirs.id, theirs.size, theirs.body)
        np.testing.assert_array_equal(ours.T_body_tag, theirs.T_body_tag)


def test_a_tag_has_its_pose_and_the_bodys_default_size(tmp_path: Path) -> None:
    bodies = f"- box: {{is_static: false, default_tag_size: 0.05, tags: [{{id: 7, pose: {POSE}}}, {{id: 8}}]}}"
    (tag,) = read_tags(written(tmp_path, bodies), ["box"])  # tag 8 has no known pose
    assert (tag.id, tag.size, tag.body) == (7, 0.05, 0)
    expected = np.array([[0, -1, 0, 0.1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    np.testing.assert_allclose(tag.T_body_tag, expected, atol=1e-12)


def test_the_only_moving_body_stands_for_an_object_of_one_body(tmp_path: Path) -> None:
    bodies = f"- rig: {{is_static: true}}\n- thing: {{is_static: false, tags: [{{id: 7, size: 0.05, pose: {POSE}}}]}}"
    assert len(read_tags(written(tmp_path, bodies), ["box"])) == 1
    with pytest.raises(ObjectError, match=r"no tag of known pose on box, lid \(bodies: rig, thing\)"):
        read_tags(written(tmp_path, bodies), ["box", "lid"])


@pytest.mark.parametrize(
    ("tags", "says"),
    [
        ("[{id: 7, size: 0.05, pose: 3}]", r"box.tags\[7\].pose needs position and rotation"),
        (f"[{{id: 7, size: -1, pose: {POSE}}}]", r"box.tags\[7\].size is -1.0, expected a positive length"),
        (f"[{{id: 7, pose: {POSE}}}]", r"box.tags\[7\].size is None, expected a finite number"),
        (f"[{{size: 0.05, pose: {POSE}}}]", "has no whole-number id"),
        (f"[{{id: 7, size: 0.05, pose: {POSE}}}, {{id: 7, size: 0.05, pose: {POSE}}}]", "a tag is listed twice"),
        ("5", "box.tags is 5, expected a list of tags"),
    ],
)
def test_what_is_no_tag_is_said(tmp_path: Path, tags: str, says: str) -> None:
    with pytest.raises(FileError, match=says):
        read_tags(written(tmp_path, f"- box: {{is_static: false, tags: {tags}}}"), ["box"])
