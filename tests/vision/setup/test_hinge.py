"""Bodies on hinges: kinematics as the object's own, and exact derivatives."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from tossid.objects import ObjectModel, body_poses
from tossid.rotations import quat_normalize, transform, transform_inv
from tossid.vision.pose_graph.factors import Noise, View, view_factor
from tossid.vision.setup.hinge import Hinge, Hinges
from tossid.vision.setup.layout import articulated, layout_of


def _hinge(model: ObjectModel) -> Hinge:
    hinge = articulated(layout_of(model), model).bodies[-1].hinge
    assert hinge is not None
    return hinge


def _some_hinge(rng: np.random.Generator, parent: str = "a") -> Hinge:
    axis = rng.normal(size=3)
    T = transform(0.1 * rng.normal(size=3), quat_normalize(rng.normal(size=4)))
    return Hinge(parent, T, axis / np.linalg.norm(axis), 0.05 * rng.normal(size=3))


def test_a_hinge_is_the_objects_own(elbow: ObjectModel) -> None:
    rng, hinge = np.random.default_rng(0), _hinge(elbow)
    for angle in rng.uniform(-3, 3, 20):
        q = np.array([*rng.normal(size=3), *quat_normalize(rng.normal(size=4)), angle])
        base, limb = (transform(p, quat) for p, quat in zip(*body_poses(elbow, q), strict=True))
        np.testing.assert_allclose(base @ hinge.pose(angle), limb, atol=1e-12)
        assert hinge.angle(transform_inv(base) @ limb) == pytest.approx(angle, abs=1e-12)
        assert hinge.misfit(transform_inv(base) @ limb) == pytest.approx(0.0, abs=1e-9)
        flipped = limb @ transform(np.zeros(3), np.array([0.0, 1.0, 0.0, 0.0]))
        assert hinge.misfit(transform_inv(base) @ flipped) > 100


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


def test_a_view_of_a_link_has_exact_derivatives() -> None:
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
