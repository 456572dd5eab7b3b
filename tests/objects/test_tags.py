"""An object's tags, read from a file in TagSLAM's form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tossid.errors import FileError, ObjectError
from tossid.objects import OBJECT_FILES, load_object, read_tags
from tossid.vision.setup.layout import object_tags
from tossid.vision.setup.tagslam import read_tagslam

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
