"""`tossid synthesize` films with all its effects, of an object with joints too, and leaves their truth beside."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines import app
from pipelines.project import load_object, object_named
from tests.pipelines.conftest import one_line
from tossid.objects import body_poses
from tossid.rotations import transform, transform_points
from tossid.vision.detect import detect_frames
from tossid.vision.faces import tag_corners
from tossid.vision.files import read_tracks
from tossid.vision.recording import read_recording
from tossid.vision.shutter import poses_at

SMALL = ["tosses=1", "seconds=0.4", "camera.samples=4", "camera.carry_s=[0.2,0.2]", "camera.pause_s=[0.1,0.1]"]
EFFECTS = [
    "camera.line_s=5e-6",
    "camera.clocks_s=[0,0.003]",
    "camera.dropped=0.1",
    "camera.glare=0.5",
    "camera.aperture_m=0.004",
    "camera.texture=15",
    "camera.clutter=12",
    "camera.hand=true",
    "camera.sweeps=1",
]


def test_an_elbow_is_filmed_with_everything(project: Path, answer: Any) -> None:
    keys = ["object=elbow", "release.joint_rate=[4,6]", "camera.count=2", "out=film"]
    made = answer("synthesize", *keys, *SMALL, *EFFECTS)
    facts = json.loads((project / "film" / "truth_film.json").read_text())
    assert facts["cameras"]["cam1"]["clock_late_s"] == 0.003
    assert facts["line_s"] == 5e-6
    assert {reach["kind"] for reach in facts["hand"]} <= {"holds", "sweeps"}
    assert len(facts["clutter"]) == 12
    views = np.load(project / "film" / "truth_views.npz")
    assert views["kept"].sum() == made["n_images"]
    assert sum(len(camera["dropped_s"]) for camera in facts["cameras"].values()) == (~views["kept"]).sum() > 0
    assert np.isfinite(views["visible"][views["kept"]]).all()
    assert np.isnan(views["visible"][~views["kept"]]).all()

    recording, model = read_recording(project / "film"), load_object(object_named("elbow"))
    (truth,) = read_tracks(project / "film" / "truth_poses.npz")
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


def test_without_effects_the_truth_says_so(project: Path, answer: Any) -> None:
    answer("synthesize", *SMALL, "camera.count=1", "out=film")
    facts = json.loads((project / "film" / "truth_film.json").read_text())
    assert facts["hand"] == facts["clutter"] == facts["cameras"]["cam0"]["dropped_s"] == []
    assert facts["effects"]["glare"] == facts["effects"]["aperture_m"] == facts["line_s"] == 0.0
    kept = np.load(project / "film" / "truth_views.npz")["kept"]
    assert kept.all()


def test_an_effect_is_not_left_out_silently(project: Path, capfd: Any) -> None:
    assert app.run(["synthesize", *SMALL, "camera.renderer=mujoco", "camera.glare=1", "out=film", "--quiet"]) == 2
    assert "camera.glare: is not known to camera.renderer=mujoco" in one_line(capfd.readouterr().err)


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("camera.clocks_s=[0,0,0,0.1]", "camera.clocks_s: has 4 values for 3 cameras"),
        ("camera.line_s=0.001", "512 rows follow each other by 0.001 s"),
        ("camera.dropped=1.5", "camera.dropped"),
        ("camera.focus_m=0", "camera.focus_m"),
    ],
)
def test_what_cannot_be_filmed_is_one_line(project: Path, capfd: Any, key: str, message: str) -> None:
    assert app.run(["synthesize", *SMALL, key, "out=film", "--quiet"]) == 2
    assert message in one_line(capfd.readouterr().err)
    assert not (project / "film").exists()
