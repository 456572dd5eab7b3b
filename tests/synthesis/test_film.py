"""Films with all effects, of an object with joints too, and their truth beside."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tossid.errors import InputError
from tossid.objects import body_poses, load_object
from tossid.rotations import transform, transform_points
from tossid.settings.synthesis import CameraSettings, SynthesizeSettings
from tossid.synthesis.film import TRUE_FILM
from tossid.synthesis.synthesize import synthesize
from tossid.vision.cameras.shutter import poses_at
from tossid.vision.detection.detect import detect_frames
from tossid.vision.recordings.formats.frames import read_recording
from tossid.vision.recordings.npz import read_tracks
from tossid.vision.setup.faces import tag_corners

SMALL = SynthesizeSettings(
    tosses=1, seconds=0.4, camera=CameraSettings(samples=4, carry_s=(0.2, 0.2), pause_s=(0.1, 0.1))
)
EFFECTS = {
    "line_s": 5e-6,
    "clocks_s": (0, 0.003),
    "dropped": 0.1,
    "glare": 0.5,
    "aperture_m": 0.004,
    "texture": 15,
    "clutter": 12,
    "hand": True,
    "sweeps": 1,
}


def filmed(folder: Path, thing: str = "cube", **keys: Any) -> dict[str, Any]:
    """Film into a folder; returns the truth about the film."""
    synthesize(thing, frames=True, out=folder, settings=SMALL, **keys)
    found: dict[str, Any] = json.loads((folder / TRUE_FILM).read_text())
    return found


def test_an_elbow_is_filmed_with_everything(tmp_path: Path) -> None:
    facts = filmed(tmp_path / "film", "elbow", release__joint_rate=(4, 6), count=2, **EFFECTS)
    assert facts["cameras"]["cam1"]["clock_late_s"] == 0.003
    assert facts["line_s"] == 5e-6
    assert {reach["kind"] for reach in facts["hand"]} <= {"holds", "sweeps"}
    assert len(facts["clutter"]) == 12
    views = np.load(tmp_path / "film" / "truth_views.npz")
    assert sum(len(camera["dropped_s"]) for camera in facts["cameras"].values()) == (~views["kept"]).sum() > 0
    assert np.isfinite(views["visible"][views["kept"]]).all()
    assert np.isnan(views["visible"][~views["kept"]]).all()

    recording, model = read_recording(tmp_path / "film"), load_object("elbow")
    assert recording.n_frames == views["kept"].sum()
    (truth,) = read_tracks(tmp_path / "film" / "truth_poses.npz")
    assert truth.q.shape[1] == 8
    assert np.ptp(truth.q[:, 7]) > 0.3
    errors, joint = [], set()
    for d in detect_frames(recording, model):  # row r of h is exposed line (r - (h - 1) / 2) after the true time
        row = facts["line_s"] * (d.corners[:, 1] - (facts["cameras"][d.camera]["rows"] - 1) / 2)
        at = d.t - facts["cameras"][d.camera]["clock_late_s"] + row
        p, quat = body_poses(model, poses_at(truth.t, truth.q, at))
        tag = next(tag for tag in model.tags if tag.id == d.tag_id)
        world = transform_points(transform(p[:, tag.body], quat[:, tag.body]), tag_corners(tag)[:, None])[:, 0]
        errors.append(np.linalg.norm(d.corners - recording.camera(d.camera).project(world), axis=1).max())
        joint.add(tag.body)
    assert joint == {0, 1}
    assert len(errors) > 100
    assert np.median(errors) < 0.3
    assert max(errors) < 3.0


def test_an_interrupted_film_leaves_what_was_there(tmp_path: Path) -> None:
    def stop(what: str, share: float) -> None:
        if what == "rendering":
            raise KeyboardInterrupt

    synthesize("cube", tosses=1, out=tmp_path / "film")
    with pytest.raises(KeyboardInterrupt):
        synthesize("cube", frames=True, out=tmp_path / "film", settings=SMALL, progress=stop)
    assert sorted(path.name for path in (tmp_path / "film").glob("*.h5")) == ["tosses.h5", "truth.h5"]
    assert [path.name for path in tmp_path.iterdir() if not path.name.endswith(".lock")] == ["film"]


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"clocks_s": (0, 0, 0, 0.1)}, "camera.clocks_s: has 4 values for 3 cameras"),
        ({"line_s": 0.001}, "512 rows follow each other by 0.001 s"),
        ({"clocks_s": (-30, 0, 0)}, "'cam0': its clock would give times before zero"),
    ],
)
def test_what_cannot_be_filmed_is_said(tmp_path: Path, keys: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        filmed(tmp_path / "film", **keys)
    assert not (tmp_path / "film").exists()
