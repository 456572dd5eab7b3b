"""Bodies on hinges: kinematics as the object's own, derivatives, and tracks of articulated objects against truth."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from tests.vision.sights import motion, nees, seen, tangent
from tossid.errors import ObjectError
from tossid.objects import ObjectModel, body_poses
from tossid.rotations import quat_boxminus, quat_normalize, transform, transform_inv
from tossid.types import Detection, PoseTrack
from tossid.vision.camera import Camera
from tossid.vision.faces import default_tags
from tossid.vision.factors import Noise, View, view_factor
from tossid.vision.hinge import Hinge, Hinges
from tossid.vision.layout import TagLayout, articulated, chain, layout_of, limbs
from tossid.vision.rig import default_rig
from tossid.vision.track import TrackSettings, track, track_scene


@pytest.fixture(scope="module")
def tagged_elbow(elbow: ObjectModel) -> ObjectModel:
    return elbow.with_changes(tags=default_tags(elbow))


def _hinge(model: ObjectModel) -> Hinge:
    hinge = articulated(layout_of(model), model).bodies[-1].hinge
    assert hinge is not None
    return hinge


def _some_hinge(rng: np.random.Generator, parent: str = "a") -> Hinge:
    axis = rng.normal(size=3)
    T = transform(0.1 * rng.normal(size=3), quat_normalize(rng.normal(size=4)))
    return Hinge(parent, T, axis / np.linalg.norm(axis), 0.05 * rng.normal(size=3))


def _swaying(n: int, rng: np.random.Generator) -> np.ndarray:
    return np.concatenate([motion(n, rng), 0.8 * np.sin(np.linspace(0, 9, n) + rng.uniform(0, 6))[:, None]], axis=1)


def _sights(
    cameras: tuple[Camera, ...], model: ObjectModel, q: np.ndarray, rng: np.random.Generator, sigma: float = 0.1
) -> list[Detection]:
    return [d for i in range(len(q)) for d in seen(cameras, model, i / 148, q[i], rng, sigma)]


def test_a_hinge_is_the_objects_own(elbow: ObjectModel) -> None:
    rng, hinge = np.random.default_rng(0), _hinge(elbow)
    for angle in rng.uniform(-3, 3, 20):
        q = np.array([*rng.normal(size=3), *quat_normalize(rng.normal(size=4)), angle])
        base, limb = (transform(p, quat) for p, quat in zip(*body_poses(elbow, q), strict=True))
        np.testing.assert_allclose(base @ hinge.pose(angle), limb, atol=1e-12)
        assert hinge.angle(transform_inv(base) @ limb) == pytest.approx(angle, abs=1e-12)
        assert hinge.miss(transform_inv(base) @ limb) == pytest.approx(0.0, abs=1e-9)
        flipped = limb @ transform(np.zeros(3), np.array([0.0, 1.0, 0.0, 0.0]))
        assert hinge.miss(transform_inv(base) @ flipped) > 100


def test_how_a_chain_moves() -> None:
    rng = np.random.default_rng(1)
    hinges, angles = Hinges.of([_some_hinge(rng) for _ in range(3)]), rng.uniform(-2, 2, 3)
    T_root = transform(rng.normal(size=3), quat_normalize(rng.normal(size=4)))
    T, J = hinges.swing(T_root, angles)
    for k in range(9):
        ends = []
        for step in (1e-6, -1e-6):
            root, turned = gtsam.Pose3(T_root), angles.copy()
            if k < 6:
                root = root.retract(step * np.eye(6)[k])
            else:
                turned[k - 6] += step
            ends.append(hinges.swing(root.matrix(), turned)[0])
        numerical = (gtsam.Pose3(T).localCoordinates(gtsam.Pose3(ends[0])) * 1.0) / 2e-6
        numerical -= gtsam.Pose3(T).localCoordinates(gtsam.Pose3(ends[1])) / 2e-6
        np.testing.assert_allclose(J[:, k], numerical, atol=1e-6)


def test_a_limbs_view_has_exact_derivatives() -> None:
    rng = np.random.default_rng(2)
    hinges = [_some_hinge(rng), _some_hinge(rng)]
    values, joints = gtsam.Values(), [int(gtsam.symbol("j", k)) for k in range(2)]
    values.insert(2, gtsam.Pose3(transform(np.array([0.0, 0, 1.2]), quat_normalize(rng.normal(size=4)))))
    for key in joints:
        values.insert(key, float(rng.uniform(-1, 1)))
    fixed = {0: np.eye(4), 1: np.eye(4), 3: transform(np.array([0.02, 0, 0]), np.array([1.0, 0, 0, 0]))}
    view = View(
        0, 1, 2, (3,), np.array([0.03]), np.zeros((1, 4, 2)), np.tile(np.eye(2), (1, 4, 1, 1)), 1e9 * np.ones(1), 0.0,
        np.zeros(6), np.zeros(6), None, tuple(zip(joints, hinges, strict=True)),
    )  # fmt: skip
    factor = view_factor(view, fixed, Noise())
    A, _ = gtsam.JacobianFactor(factor.linearize(values)).jacobian()
    at = 0
    for key in list(factor.keys()):
        n, columns = (6, []) if key == 2 else (1, [])
        for e in np.eye(n):
            both = []
            for sign in (1, -1):
                delta = gtsam.VectorValues()
                for other in (2, *joints):
                    delta.insert(other, sign * 1e-6 * e if other == key else np.zeros(6 if other == 2 else 1))
                both.append(factor.unwhitenedError(values.retract(delta)))
            columns.append((both[0] - both[1]) / 2e-6)
        np.testing.assert_allclose(A[:, at : at + n], np.stack(columns, axis=1), atol=1e-6)
        at += n


def test_an_articulated_object_is_tracked_with_honest_covariances(tagged_elbow: ObjectModel) -> None:
    """Poses and angle together: NEES 1 on average over seven degrees of freedom."""
    rng, cameras = np.random.default_rng(3), default_rig()
    q = _swaying(200, rng)
    found, report = track(_sights(cameras, tagged_elbow, q, rng), cameras, tagged_elbow)
    assert len(found.t) == 200
    assert found.q.shape == (200, 8)
    error = tangent(found, q)
    assert np.rad2deg(np.median(np.abs(error[:, 6]))) < 0.1
    assert np.mean(nees(found, q)) == pytest.approx(1.0, abs=0.12)
    assert found.q_cov is not None
    angle = error[:, 6] ** 2 / found.q_cov[:, 6, 6]
    assert angle.mean() == pytest.approx(1.0, abs=0.3)
    assert report.n_poses == 200


def test_the_hinge_tells_more_than_two_bodies_do(tagged_elbow: ObjectModel) -> None:
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


def test_a_limb_out_of_sight_is_said(tagged_elbow: ObjectModel) -> None:
    rng, cameras = np.random.default_rng(5), default_rig()
    q = _swaying(40, rng)
    limb = {tag.id for tag in tagged_elbow.tags if tag.body == 1}
    detections = [
        d for d in _sights(cameras, tagged_elbow, q, rng) if not (d.tag_id in limb and 10 <= round(d.t * 148) < 15)
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


def test_the_bodies_of_an_object_hang_together(tagged_elbow: ObjectModel) -> None:
    layout = articulated(layout_of(tagged_elbow), tagged_elbow)
    names = [body.name for body in layout.bodies]
    assert chain(layout.bodies, names.index("elbow_2")) == (names.index("elbow_1"), [names.index("elbow_2")])
    assert limbs(layout.bodies, names.index("elbow_1")) == [names.index("elbow_2")]
    with pytest.raises(ObjectError, match="elbow_2"):
        articulated(TagLayout(layout_of(tagged_elbow).bodies[:-1]), tagged_elbow)


def test_a_track_with_joints_is_a_pose_track(tagged_elbow: ObjectModel) -> None:
    rng, cameras = np.random.default_rng(7), default_rig()
    found, _ = track(_sights(cameras, tagged_elbow, _swaying(10, rng), rng), cameras, tagged_elbow, name="mine")
    assert isinstance(found, PoseTrack)
    assert found.name == "mine"
