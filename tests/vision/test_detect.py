"""Detection in recordings: prediction, false tags, files between the stages."""

from __future__ import annotations

import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.vision.conftest import Filmed
from tossid.errors import FileError
from tossid.objects import ObjectModel
from tossid.types import Frame
from tossid.vision.detect import DetectSettings, TagFinder, detect_frames
from tossid.vision.faces import tag_spread
from tossid.vision.files import read_detections, write_detections
from tossid.vision.recording import read_recording
from tossid.vision.render import Renderer
from tossid.vision.rig import default_rig

TILTED = np.array([0.9, 0.1, 0.3, 0.3])


def _image(model: ObjectModel, camera, position=(0.0, 0.1, 0.2)) -> np.ndarray:
    q = np.array([*position, *(TILTED / np.linalg.norm(TILTED))])
    return Renderer(model, [camera]).render(q, q, camera.name, None)


def test_prediction_finds_what_a_whole_search_finds(filmed: Filmed, tagged: ObjectModel):
    recording = filmed.recording
    camera = recording.cameras[0]
    files = recording.frames["cam0"][70:130]
    whole, near = Counter(), Counter()
    finders = (
        (TagFinder(camera, tagged, DetectSettings(predict=False)), whole),
        (TagFinder(camera, tagged), near),
    )
    for file in files:
        frame = recording.read(file)
        for finder, seen in finders:
            seen.update(d.tag_id for d in finder.find(frame))
    assert sum(near.values()) >= 0.99 * sum(whole.values())
    assert finders[1][0].tally["searched near the last place"] >= 58


def test_threads_change_nothing(filmed: Filmed, tagged: ObjectModel):
    files = filmed.recording.frames.items()
    part = replace(filmed.recording, frames={name: own[:230] for name, own in files})
    one = list(detect_frames(part, tagged, threads=1))
    done: list[int] = []
    tally: Counter[str] = Counter()
    two = list(detect_frames(part, tagged, threads=2, tally=tally, progress=done.append))
    assert sum(done) == part.n_frames == 690
    assert len(one) == len(two) == tally["tags"]
    key = lambda d: (d.t, d.camera, d.tag_id)  # noqa: E731
    for a, b in zip(sorted(one, key=key), sorted(two, key=key), strict=True):
        assert key(a) == key(b)
        np.testing.assert_array_equal(a.corners, b.corners)


def test_a_lost_object_is_found_again(tagged: ObjectModel):
    (camera,) = default_rig(n_cameras=1)
    finder = TagFinder(camera, tagged)
    empty = _image(tagged, camera, (0, 0, -5.0))
    here, there = _image(tagged, camera, (-0.3, 0, 0.2)), _image(tagged, camera, (0.3, 0.2, 0.2))
    seen = [bool(finder.find(Frame("cam0", float(i), image))) for i, image in enumerate((here, empty, there, here))]
    assert seen == [True, False, True, True]


def test_a_tag_that_is_not_on_the_object_is_rejected(tagged: ObjectModel):
    (camera,) = default_rig(n_cameras=1)
    image = _image(tagged, camera)
    all_ids = {d.tag_id for d in TagFinder(camera, tagged).find(Frame("cam0", 0.0, image))}
    gone = min(all_ids)
    fewer = tagged.with_changes(tags=tuple(tag for tag in tagged.tags if tag.id != gone))
    finder = TagFinder(camera, fewer, DetectSettings(predict=False))
    assert {d.tag_id for d in finder.find(Frame("cam0", 0.0, image))} == all_ids - {gone}
    assert finder.tally["rejected: id not on the object"] == 1


def test_an_id_seen_twice_is_rejected(tagged: ObjectModel):
    (camera,) = default_rig(n_cameras=1)
    one, two = _image(tagged, camera, (-0.3, -0.2, 0.2)), _image(tagged, camera, (0.3, 0.2, 0.2))
    both = np.where(np.abs(two.astype(int) - _image(tagged, camera, (0, 0, -5.0))) > 12, two, one)
    finder = TagFinder(camera, tagged, DetectSettings(predict=False))
    ids = [d.tag_id for d in finder.find(Frame("cam0", 0.0, both))]
    assert finder.tally["rejected: id seen twice in a frame"] >= 2
    assert len(ids) == len(set(ids))


def test_spread_is_the_cubes_geometry(tagged: ObjectModel):
    # from the front tag to the far edge of the tag opposite: the cube's width, 0.1048 m, in edges of 0.08 m
    assert tag_spread(tagged) == pytest.approx(0.1048 / 0.08, rel=1e-6)


def test_a_bad_frame_stops_detection_with_its_name(filmed: Filmed, tagged: ObjectModel, tmp_path: Path):
    copy = tmp_path / "rec"
    shutil.copytree(filmed.recording.folder, copy)
    recording = read_recording(copy)
    victim = recording.frames["cam1"][30].path
    victim.write_bytes(b"no image")
    with pytest.raises(FileError) as caught:
        list(detect_frames(recording, tagged))
    assert caught.value.path == victim


def test_detections_come_back_from_their_file(filmed: Filmed, tagged: ObjectModel, tmp_path: Path):
    finder = TagFinder(filmed.recording.cameras[0], tagged)
    rows = [d for file in filmed.recording.frames["cam0"][:8] for d in finder.find(filmed.recording.read(file))]
    assert rows
    write_detections(rows, tmp_path / "d.npz")
    for read, row in zip(read_detections(tmp_path / "d.npz"), rows, strict=True):
        assert (read.camera, read.t, read.tag_id, read.hamming, read.margin) == (
            row.camera,
            row.t,
            row.tag_id,
            row.hamming,
            row.margin,
        )
        np.testing.assert_array_equal(read.corners, row.corners)
        np.testing.assert_array_equal(read.corner_cov, row.corner_cov)
    with np.load(tmp_path / "d.npz") as archive:  # as it was when four corners shared one covariance
        old = dict(archive) | {"schema": "tossid.detections/1", "corner_cov": archive["corner_cov"][:, 2]}
    np.savez(tmp_path / "old.npz", **old)
    for read, row in zip(read_detections(tmp_path / "old.npz"), rows, strict=True):
        np.testing.assert_array_equal(read.corner_cov, np.tile(row.corner_cov[2], (4, 1, 1)))
    write_detections([], tmp_path / "none.npz")
    assert read_detections(tmp_path / "none.npz") == ()


def test_a_damaged_file_of_detections_is_named(tmp_path: Path):
    write_detections([], tmp_path / "d.npz")
    content = (tmp_path / "d.npz").read_bytes()
    for damaged in (b"", b"text", content[: len(content) // 2]):
        (tmp_path / "d.npz").write_bytes(damaged)
        with pytest.raises(FileError, match=r"d\.npz"):
            read_detections(tmp_path / "d.npz")
    np.savez(tmp_path / "other.npz", schema=np.array("tossid.tracks/1"))
    with pytest.raises(FileError, match="expected tossid"):
        read_detections(tmp_path / "other.npz")
    np.savez(tmp_path / "pickle.npz", schema=np.array([{"code": 1}], dtype=object))
    with pytest.raises(FileError):
        read_detections(tmp_path / "pickle.npz")
