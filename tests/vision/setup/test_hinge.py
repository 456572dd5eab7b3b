"""Bodies on hinges: kinematics as the object's own, and exact derivatives."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from tossid.objects import ObjectModel, body_poses
from tossid.rotations import quat_normalize, transform, transform_inv
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
        np.testing.assert_allclose(Hinges.of([hinge]).swing(base, [angle])[0], limb, atol=1e-12)
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
