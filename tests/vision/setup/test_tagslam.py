"""TagSLAM's scene files: written, read, and damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tossid.errors import FileError
from tossid.rotations import transform_from_rotvec
from tossid.vision.setup.layout import Body, BodyTag, TagLayout
from tossid.vision.setup.tagslam import read_tagslam, write_tagslam


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=st.lists(st.floats(-1.8, 1.8), min_size=6, max_size=6), size=st.floats(0.01, 0.5))
def test_tag_layouts_come_back_as_written(tmp_path: Path, values: list[float], size: float):
    T = transform_from_rotvec(values[:3], np.array(values[3:]))
    layout = TagLayout(
        (
            Body("lab", True, T, size, (BodyTag(9, size, None),)),
            Body("thing", False, None, None, (BodyTag(3, size, T, np.full(3, 1e-5), np.full(3, 0.1)),)),
        ),
        default_body="lab",
    )
    write_tagslam(layout, tmp_path / "tagslam.yaml")
    again = read_tagslam(tmp_path / "tagslam.yaml")
    lab, thing = again.bodies
    assert again.default_body == "lab"
    assert (lab.is_static, thing.is_static) == (True, False)
    assert lab.tags[0].T_body_tag is None
    np.testing.assert_allclose(lab.T_map_body, T, atol=1e-12)
    np.testing.assert_allclose(thing.tags[0].T_body_tag, T, atol=1e-12)
    assert thing.tags[0].size == size
    np.testing.assert_array_equal(thing.tags[0].rotation_noise, np.full(3, 0.1))


BOX = "{is_static: false, type: simple, tags: [{id: 1, size: 0.1}]"


def test_what_tagslam_takes_in_is_read(tmp_path: Path):
    (tmp_path / "tagslam.yaml").write_text(
        f"""
tagslam_parameters: {{optimizer_mode: full, sync_queue_size: 9, anything_of_a_fork: 3}}
amnesia: true
warn_ignore_tags: false
bodies:
 - lab: {{is_static: true, default_tag_size: 0.1, ignore_tags: [9]}}
 - box: {BOX}, T_body_odom: {{}}, odom_topic: /o, odom_frame_id: o, odom_acceleration: 1.0, max_hamming_distance: 2}}
default_body: lab
max_hamming_distance: 1
distance_measurements:
 - wall: {{tag1: 1, tag2: 2, corner1: 0, corner2: 3, distance: 1.5, noise: 0.001}}
coordinate_measurements:
 - high: {{tag: 1, corner: 2, direction: [0, 0, 1], length: 0.7, noise: 0.01}}
plane_measurements:
 - floor: {{tags: [3, 4], direction: [0, 0, 1.0], distance: 0.0, noise: 0.002}}
tag_id_remap:
 - id: 20
   remaps:
    - {{remap_id: 420, start_time: "1541686885.999522770", end_time: "1541686936.513937363"}}
squash:
 - {{time: "1527206556.891942748", tags: [85]}}
 - {{camera: cam1, tags: [8]}}
"""
    )
    layout = read_tagslam(tmp_path / "tagslam.yaml")
    assert [m.name for m in layout.measurements] == ["wall", "high", "floor_tag_3", "floor_tag_4"]
    assert [corner for _, corner in layout.measurements[0].points] == [0, 3]
    assert layout.measurements[2].points == ((3, None),)
    assert (layout.remaps[0].id, layout.remaps[0].new_id) == (20, 420)
    assert layout.remaps[0].end == pytest.approx(1541686936.513937363)
    assert layout.squashes[1].camera == "cam1"
    assert layout.max_hamming == 1
    assert layout.bodies[0].ignored_tags == {9}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("bodies: []", "bodies"),
        ("bodies: [{cube: {is_static: maybe}}]", "is_static"),
        ("bodies: [{cube: {is_static: false, tags: [{id: one}]}}]", "id"),
        ("bodies: [{cube: {is_static: false, tags: [{id: 1}]}}]", "size"),
        ("bodies: [{cube: {is_static: false, tags: [{id: 1, size: 1}, {id: 1, size: 1}]}}]", "twice"),
        ("bodies: [{cube: {is_static: false, tags: [{id: 1, size: 1, pose: {position: 3}}]}}]", "rotation"),
        ("bodies: [{a: {is_static: true, tags: [&t {id: 1, size: 1}]}}, {b: {is_static: true, tags: [*t]}}]",
         "tag 1 is listed twice"),
        ("bodies: [{a: {is_static: false, pose: {}}}]", "moves"),
        ("bodies: [{a: {is_static: true}}]\nsquash: [{tags: [1]}]", "time or a camera"),
        ("bodies: [{a: {is_static: true}}]\ndistance_measurements: [{d: {tag1: 1}}]", "tag2"),
        ("bodies: [{a: {is_static: true}}]\nplane_measurements: [{d: {tags: [1], direction: [1, 1, 0], distance: 1, "
         "noise: 1}}]", "unit vector"),
        (f"bodys: []\nbodies: [box: {BOX}}}]", "bodys is no key that is read; did you mean 'bodies'"),
        (f"remap: []\nbodies: [box: {BOX}}}]", "remap is no key that is read; expected tag_id_remap"),
        (f"body_defaults: {{pos_noise: 1}}\nbodies: [box: {BOX}}}]", "body_defaults.pos_noise .* 'position_noise'"),
        (f"bodies: [box: {BOX}, tag_size: 0.1}}]", "box.tag_size is no key that is read; expected default_tag_size"),
        (f"bodies: [box: {BOX}, fixed: true}}]", "box.fixed is no key that is read; expected one of is_static"),
        ("bodies: [box: {is_static: false, tags: 5}]", "box.tags is 5, expected a list of tags"),
        ("bodies: [box: {is_static: false, tags: [{id: 1, sise: 0.1}]}]", r"box.tags\[1\].sise .* 'size'"),
        (f"distance_measurements: [a: {{tag1: 1, tag2: 2, corner1: 0, corner2: 0, length: 1, noise: 1}}]\n"
         f"bodies: [box: {BOX}}}]", "distance_measurements.a.length is no key"),
    ],
)  # fmt: skip
def test_what_a_scene_cannot_say_is_named(tmp_path: Path, text: str, words: str):
    (tmp_path / "tagslam.yaml").write_text(text)
    with pytest.raises(FileError, match=words):
        read_tagslam(tmp_path / "tagslam.yaml")


def test_families_are_read_and_written(tmp_path: Path):
    path = tmp_path / "tagslam.yaml"
    path.write_text(
        "tag_family: 25h9\n"
        "bodies:\n"
        "- lab: {is_static: true, tags: [{id: 1, size: 0.1}, {id: 2, size: 0.1, family: tag16h5}]}\n"
        "- thing: {is_static: false, tag_family: tag36h11, tags: [{id: 3, size: 0.1}]}\n"
    )
    for _ in range(2):
        layout = read_tagslam(path)
        assert layout.tag_family == "tag25h9"
        assert layout.families == {1: "tag25h9", 2: "tag16h5", 3: "tag36h11"}
        write_tagslam(layout, path)
    path.write_text("tag_family: 21h7\nbodies:\n- lab: {is_static: true}\n")
    with pytest.raises(FileError, match="tag_family is '21h7', expected one of tag36h11, tag25h9, tag16h5"):
        read_tagslam(path)
