"""An object beside a recording: written, read back, and refused where it is none."""

from __future__ import annotations

from pathlib import Path

import pytest

from tossid.errors import FileError
from tossid.objects import OBJECT_FILES, load_object, recorded_object, write_object

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
        ("name: box", "name: 3", "name is 3, expected text"),
        ("path: object.xml", f"path: {'x' * 300}", "path is .*, expected text"),
        ("friction: 0.2", "friction: -0.2", "friction: -0.2 is out of range"),
        ("friction: 0.2", "friction: much", "friction is 'much', expected a finite number"),
        ("tags: null", "mass: 3", "mass is no setting of one"),
    ],
)
def test_what_is_no_object_is_said(tmp_path: Path, was: str, now: str, says: str) -> None:
    (tmp_path / "object.yaml").write_text(SOUND.replace(was, now))
    with pytest.raises(FileError, match=says):
        recorded_object(tmp_path)
