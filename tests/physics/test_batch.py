"""Kinematic quantities of a batch of states, by differences along the motion."""

from __future__ import annotations

import numpy as np

from tests.physics.trees import random_state, random_tree
from tossid.physics import make_system, tree_batch
from tossid.rotations import quat_exp, quat_mul


def test_jacobians_and_accelerations_are_derivatives_along_the_motion() -> None:
    """At dv/dt = 0: v is constant in the world for the base's origin, in the base's axes for its spin."""
    rng = np.random.default_rng(0)
    model = random_tree(rng, n_bodies=3)
    q, v = map(np.array, zip(*(random_state(rng, model) for _ in range(4)), strict=True))
    system = make_system(model)

    def after(h: float):  # type: ignore[no-untyped-def]
        turned = np.array([quat_mul(a, quat_exp(h * w)) for a, w in zip(q[:, 3:7], v[:, 3:6], strict=True)])
        return tree_batch(system, np.concatenate([q[:, :3] + h * v[:, :3], turned, q[:, 7:] + h * v[:, 6:]], axis=1), v)

    now, h = tree_batch(system, q, v), 1e-5
    ahead, behind = after(h), after(-h)
    twist = np.einsum("bnij,bj->bni", now.X, v)
    np.testing.assert_allclose(twist[..., :3], now.omega, atol=1e-12)
    back = np.swapaxes(now.R, -1, -2)
    speed = np.einsum("bnij,bnj->bni", back, (ahead.x - behind.x) / (2 * h))
    np.testing.assert_allclose(twist[..., 3:], speed, atol=1e-6)
    spinning = back @ ((ahead.R - behind.R) / (2 * h))
    np.testing.assert_allclose(spinning[..., [2, 0, 1], [1, 2, 0]], now.omega, atol=1e-6)
    world = np.einsum("bnij,bnj->bni", ahead.R, ahead.omega) - np.einsum("bnij,bnj->bni", behind.R, behind.omega)
    np.testing.assert_allclose(np.einsum("bnij,bnj->bni", back, world / (2 * h)), now.alpha, atol=1e-5)
    second = (ahead.x - 2 * now.x + behind.x) / h**2
    np.testing.assert_allclose(np.einsum("bnij,bnj->bni", back, second), now.xdd, atol=1e-3)
