"""The smoother's linear system is the derivative of the motion it stands for."""

from __future__ import annotations

import numpy as np
import pytest

from tests.motion.bouncing import bounce, tracked
from tossid.motion.smoothing.system import differences, linearise, pad, retract, unpad
from tossid.objects import ObjectModel
from tossid.rotations import quat_boxminus, quat_exp, quat_mul, quat_rotate


@pytest.fixture(scope="module")
def odd(cube: ObjectModel) -> ObjectModel:
    return cube.with_changes(com=np.array([[0.02, -0.01, 0.015]]), inertia=np.diag([6e-4, 9e-4, 1.2e-3])[None])


def test_transitions_are_derivatives(odd: ObjectModel) -> None:
    """F by central differences of the defect: d(x ⊞ δ) = d(x) + F δ."""
    rng = np.random.default_rng(0)
    track = tracked(bounce(odd, rng, tosses=1, frames=6)[0], rng)
    assert track.q_cov is not None
    batch = pad([track], odd, [track.q_cov])
    q, v = batch.q.copy(), differences(batch.q, batch.h)
    # a reference that moves as the model does, so that the defect is zero
    S, fall = np.ones((5, 1, 6)), np.full((5, 1), 9.81)
    for k in range(5):
        d = linearise(odd, q, v, batch, S, fall).d[k]
        step = np.zeros((6, 1, 12))
        step[k + 1] = d
        q, v = retract(q, v, step)
    system = linearise(odd, q, v, batch, S, fall)
    np.testing.assert_allclose(system.d, 0, atol=1e-9)
    for column in range(12):
        step = np.zeros((6, 1, 12))
        step[:5, :, column] = 1e-5
        # only every second frame is moved, so that the frame after it stays
        for k in range(5):
            only = np.zeros_like(step)
            only[k] = step[k]
            ahead = linearise(odd, *retract(q, v, only), batch, S, fall).d[k, 0]
            back = linearise(odd, *retract(q, v, -only), batch, S, fall).d[k, 0]
            np.testing.assert_allclose((ahead - back) / 2e-5, system.F[k, 0, :, column], atol=2e-5)


def test_covariances_follow_the_origin(odd: ObjectModel) -> None:
    """Brought from the centre of mass to the base frame as samples are."""
    rng = np.random.default_rng(1)
    track = tracked(bounce(odd, rng, tosses=1, frames=5)[0], rng)
    assert track.q_cov is not None
    batch = pad([track], odd, [track.q_cov])
    q, v = batch.q, differences(batch.q, batch.h)
    root = rng.normal(size=(12, 12)) * np.repeat([1e-4, 1e-2, 1e-3, 1e-2], 3)[:, None]
    cov = np.tile(root @ root.T, (5, 1, 1, 1))
    base_q, base_v, q_cov, v_cov = unpad(batch, 0, q, v, cov)
    c = odd.com[0]

    def base_of(at_q: np.ndarray, at_v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p = at_q[..., :3] - quat_rotate(at_q[..., 3:7], c)
        u = at_v[..., :3] - quat_rotate(at_q[..., 3:7], np.cross(at_v[..., 3:6], c))
        return np.concatenate([p, at_q[..., 3:]], -1), np.concatenate([u, at_v[..., 3:]], -1)

    np.testing.assert_allclose(base_q, base_of(q[:, 0], v[:, 0])[0], atol=1e-12)
    np.testing.assert_allclose(base_v, base_of(q[:, 0], v[:, 0])[1], atol=1e-12)
    delta = rng.normal(size=(40_000, 12)) @ root.T
    turned = quat_mul(q[2, 0, 3:7], quat_exp(delta[:, 3:6]))
    samples_q, samples_v = base_of(np.concatenate([q[2, 0, :3] + delta[:, :3], turned], axis=1), v[2, 0] + delta[:, 6:])
    e_q = np.concatenate([samples_q[:, :3] - base_q[2, :3], quat_boxminus(samples_q[:, 3:], base_q[2, 3:7])], axis=1)
    e_v = samples_v - base_v[2]
    for mine, samples in ((q_cov[2], e_q), (v_cov[2], e_v)):
        found = np.cov(samples.T)
        size = np.sqrt(np.outer(np.diag(found), np.diag(found)))
        np.testing.assert_allclose(mine / size, found / size, atol=0.03)
