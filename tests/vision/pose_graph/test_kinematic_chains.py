"""Bodies that hang on others: tracks of articulated objects, with covariances of pose and angle, against truth."""

from __future__ import annotations

import numpy as np
import pytest

from tests.vision.sights import motion, nees, seen, tangent
from tests.vision.tracked import track
from tossid.objects import ObjectModel
from tossid.rotations import quat_boxminus
from tossid.settings.tracking import TrackSettings
from tossid.types import Detection
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.track import track_scene
from tossid.vision.setup.faces import default_tags
from tossid.vision.setup.layout import layout_of


@pytest.fixture(scope="module")
def tagged_elbow(elbow: ObjectModel) -> ObjectModel:
    return elbow.with_changes(tags=default_tags(elbow))


def _swaying(n: int, rng: np.random.Generator) -> np.ndarray:
    return np.concatenate([motion(n, rng), 0.8 * np.sin(np.linspace(0, 9, n) + rng.uniform(0, 6))[:, None]], axis=1)


def _sights(
    cameras: tuple[Camera, ...], model: ObjectModel, q: np.ndarray, rng: np.random.Generator, sigma: float = 0.1
) -> list[Detection]:
    return [d for i in range(len(q)) for d in seen(cameras, model, i / 148, q[i], rng, sigma)]


def test_an_articulated_object_is_tracked_with_honest_covariances(tagged_elbow: ObjectModel) -> None:
    """Poses and angle together: NEES 1 on average over seven degrees of freedom."""
    rng, cameras = np.random.default_rng(3), default_rig()
    q = _swaying(120, rng)
    found, report = track(_sights(cameras, tagged_elbow, q, rng), cameras, tagged_elbow)
    assert len(found.t) == 120
    assert found.q.shape == (120, 8)
    error = tangent(found, q)
    assert np.rad2deg(np.median(np.abs(error[:, 6]))) < 0.1
    assert np.mean(nees(found, q)) == pytest.approx(1.0, abs=0.12)
    assert found.q_cov is not None
    angle = error[:, 6] ** 2 / found.q_cov[:, 6, 6]
    assert angle.mean() == pytest.approx(1.0, abs=0.3)
    assert report.n_poses == 120


def test_a_hinge_reduces_errors_of_single_bodies(tagged_elbow: ObjectModel) -> None:
    """One camera, small tags: bodies on their own flip or wander where the hinge keeps them together."""
    rng, camera = np.random.default_rng(4), default_rig(n_cameras=1)
    q = _swaying(100, rng)
    detections = _sights(camera, tagged_elbow, q, rng, 0.3)
    loose = TrackSettings(max_sigma=0.1, max_angle_sigma=1.0)
    found, _ = track(detections, camera, tagged_elbow, settings=loose)
    alone = track_scene(detections, camera, layout_of(tagged_elbow), settings=loose)
    index = np.round(found.t * 148).astype(int)
    error = np.rad2deg(np.linalg.norm(tangent(found, q[index])[:, 3:6], axis=1))
    assert len(found.t) >= 95
    assert error.max() < 10.0
    base = alone.tracks["elbow_1"]
    turn = quat_boxminus(base.q[:, 3:7], q[np.round(base.t * 148).astype(int), 3:7])
    assert np.median(error) < 0.7 * np.rad2deg(np.median(np.linalg.norm(turn, axis=1)))


def test_steps_without_one_of_the_bodies_are_rejected(tagged_elbow: ObjectModel) -> None:
    rng, cameras = np.random.default_rng(5), default_rig()
    q = _swaying(40, rng)
    second = {tag.id for tag in tagged_elbow.tags if tag.body == 1}
    detections = [
        d for d in _sights(cameras, tagged_elbow, q, rng) if not (d.tag_id in second and 10 <= round(d.t * 148) < 15)
    ]
    found, report = track(detections, cameras, tagged_elbow)
    assert len(found.t) == 35
    assert report.dropped_steps == {"a body out of sight": 5}


def test_angles_go_on_beyond_half_a_turn(tagged_elbow: ObjectModel) -> None:
    rng, cameras = np.random.default_rng(6), default_rig()
    q = motion(60, rng)
    q = np.concatenate([q, np.linspace(2.5, 4.0, 60)[:, None]], axis=1)
    found, _ = track(_sights(cameras, tagged_elbow, q, rng), cameras, tagged_elbow)
    assert np.abs(np.diff(found.q[:, 7])).max() < 0.1
    assert np.abs(tangent(found, q)[:, 6]).max() < 0.01
