"""What a hand hides is not found, and nothing is found wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.vision.tosses import thrown
from tossid.objects import ObjectModel
from tossid.rotations import geodesic_angle, transform, transform_points
from tossid.settings.rendering import RenderSettings
from tossid.synthesis.timeline import Filming, FilmTruth, Timeline, make_timeline, render_timeline
from tossid.types import Detection
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig
from tossid.vision.cameras.shutter import Shutter, poses_at
from tossid.vision.detection.detect import detect_frames
from tossid.vision.pose_graph.track import track
from tossid.vision.recordings.formats.frames import read_recording
from tossid.vision.recordings.recording import Recording
from tossid.vision.recordings.writing import RecordingWriter
from tossid.vision.rendering.hand import hand_poses
from tossid.vision.rendering.render import Renderer
from tossid.vision.setup.faces import tag_corners
from tossid.vision.setup.layout import layout_of

IMAGES = RenderSettings(samples=8)


def _filmed(
    timeline: Timeline,
    model: ObjectModel,
    cameras: tuple[Camera, ...],
    folder: Path,
    filming: Filming,
    settings: RenderSettings = IMAGES,
) -> tuple[Recording, FilmTruth]:
    with RecordingWriter(folder, cameras, layout_of(model), quality=90) as writer:
        rng = np.random.default_rng(7)
        truth = render_timeline(timeline, model, cameras, writer, rng, settings=settings, filming=filming)
    return read_recording(folder), truth


def _wrongness(detection: Detection, recording: Recording, model: ObjectModel, timeline: Timeline) -> float:
    """Rms distance of a detection's corners from the true ones [px]."""
    q = poses_at(timeline.t, timeline.q, np.array([detection.t]))[0]
    tag = next(tag for tag in model.tags if tag.id == detection.tag_id)
    true = recording.camera(detection.camera).project(transform_points(transform(q[:3], q[3:7]), tag_corners(tag)))
    return float(np.sqrt(np.mean(np.sum((detection.corners - true) ** 2, axis=-1))))


@pytest.fixture(scope="module")
def timeline(tagged: ObjectModel) -> Timeline:
    rng = np.random.default_rng(3)
    return make_timeline([thrown(tagged, rng, longest=0.8)], tagged, rng, start=2.0)


@pytest.fixture(scope="module")
def cameras() -> tuple[Camera, ...]:
    return default_rig(resolution=(480, 384))


def test_what_a_hand_hides_is_not_found_and_nothing_is_found_wrong(
    tagged: ObjectModel, timeline: Timeline, cameras, tmp_path: Path
):
    hand, reaches = hand_poses(
        timeline.t,
        timeline.q,
        lift=timeline.lift,
        release=timeline.release,
        rest=timeline.rest,
        holds=True,
        sweeps=1.0,
        cameras=cameras,
        rng=np.random.default_rng(2),
    )
    assert {reach.kind for reach in reaches} == {"holds", "sweeps"}
    release = timeline.t[timeline.release[0]]
    assert all(np.isfinite(hand[(timeline.t >= r.t0) & (timeline.t <= r.t1)]).all() for r in reaches)
    recording, truth = _filmed(timeline, tagged, cameras, tmp_path / "r", Filming(hand=hand))
    renderer = Renderer(tagged, cameras)
    held = np.flatnonzero((timeline.t > release - 0.2) & (timeline.t < release))
    clear = np.array(
        [[renderer.visible(Shutter().expose(timeline.t, timeline.q, i, 384, 8), c.name) for c in cameras] for i in held]
    )
    # it is held, not wrapped up
    assert 0.2 * clear.sum() < truth.visible[held].sum() < 0.8 * clear.sum()
    index = {
        (camera.name, round(t * 1e9)): (i, c) for c, camera in enumerate(cameras) for i, t in enumerate(timeline.t)
    }
    detections = list(detect_frames(recording, tagged))
    shares = []
    for d in detections:
        i, c = index[d.camera, round(d.t * 1e9)]
        shares.append(truth.visible[i, c, d.tag_id])
        assert _wrongness(d, recording, tagged, timeline) < 2.0
    assert min(shares) > 0.6  # a tag can spare a little of its edge
    poses, _ = track(detections, recording.cameras, tagged)
    true = poses_at(timeline.t, timeline.q, poses.t)
    off = poses.q[:, :3] - true[:, :3]
    assert np.linalg.norm(off, axis=1).max() < 0.01
    nees = np.einsum("ni,nij,nj->n", off, np.linalg.inv(poses.q_cov[:, :3, :3]), off) / 3
    assert nees.max() < 12.0  # a pose that is less sure says so
    assert nees.mean() < 1.6
    assert np.rad2deg(geodesic_angle(poses.q[:, 3:7], true[:, 3:7])).max() < 4.0
