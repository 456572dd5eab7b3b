"""The parts of a model's acceleration are those of the motion that it explains."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.evaluation.accelerations import accelerations_over_toss
from tossid.models.implicit import LossWeights
from tossid.objects import ObjectModel
from tossid.physics import System, make_system, no_learned_acceleration, simulate
from tossid.rotations import quat_normalize
from tossid.types import Phase, Toss


def missing_half(model: ObjectModel) -> System:
    """Half of gravity is given, the other half is the residual's."""
    zero = no_learned_acceleration(model.n_joints)
    nv, nf = 6 + model.n_joints, zero.linear.shape[1]
    linear = np.zeros((nv, nf))
    linear[:3, :3] = -4.905 * np.eye(3)  # along the vertical that the base sees
    net = zero._replace(
        linear=linear, W0=np.zeros((1, nf)), b0=np.zeros(1), W1=np.zeros((1, 1)), b1=np.zeros(1), W2=np.zeros((nv, 1))
    )
    return make_system(model, gravity=4.905, k_res=net)


def own_toss(system: System, model: ObjectModel, *, frames: int) -> tuple[Toss, np.ndarray]:
    """A rollout of the system as a toss, and the contact impulse over each interval divided by (m dt) [m/s²]."""
    q0, v0 = np.zeros((1, model.nq)), np.zeros((1, model.nv))
    q0[0, 2:7] = 0.2, *quat_normalize([0.9, 0.1, 0.3, 0.3])
    v0[0, :6] = 0.8, 0.1, 0.3, 2.0, -3.0, 1.0
    dt = 1 / 148
    run = simulate(system, q0, v0, n_steps=frames, dt=dt)
    pushes = run.lam_n[0].sum(axis=1)
    phase = np.where(np.concatenate([[0.0], pushes]) > 0, Phase.SLIDE, Phase.FLIGHT).astype(np.uint8)
    cov = np.tile(1e-6 * np.eye(model.nv), (frames + 1, 1, 1))
    toss = Toss("own", dt * np.arange(frames + 1), run.q[0], run.v[0], cov, cov, phase)
    return toss, pushes / (model.mass.sum() * dt)


@pytest.mark.parametrize("name", ["cube", "elbow"])
def test_impulses_and_the_missing_gravity_of_own_rollouts_are_recovered(
    name: str, request: pytest.FixtureRequest
) -> None:
    model = request.getfixturevalue(name)
    system = missing_half(model)
    toss, pushed = own_toss(system, model, frames=110)
    parts = accelerations_over_toss(system, model, toss, weights=LossWeights(complementarity=1e-4, dissipation=1e-4))
    np.testing.assert_allclose(parts.given, -4.905)
    np.testing.assert_allclose(parts.residual, -4.905, atol=1e-9)
    np.testing.assert_allclose(parts.contact, pushed, atol=0.05)
    if not model.n_joints:  # links' centre of mass changes its place within an interval of an impact
        np.testing.assert_allclose(parts.given + parts.residual + parts.contact, parts.measured, atol=0.05)
        assert parts.contact[-1] == pytest.approx(9.81, abs=0.05), "and the ground carries it"
    assert parts.contact.max() > 50, "it lands"
    touched = toss.phase == Phase.SLIDE
    np.testing.assert_array_equal(parts.separable, ~(touched[1:] | touched[:-1]))


def test_noise_of_heights_does_not_become_contact(cube: ObjectModel) -> None:
    """A tracked cube lies a millimetre in or over the ground: that is no blow, and it is carried all the same."""
    system = make_system(cube)
    toss, _ = own_toss(system, cube, frames=110)
    q = toss.q.copy()
    q[:, 2] += 1e-3 * np.where(np.arange(111) % 2, 1, -1)
    tracked = Toss("tracked", toss.t, q, toss.v, toss.q_cov, toss.v_cov, toss.phase)
    parts = accelerations_over_toss(system, cube, tracked)
    np.testing.assert_allclose(parts.contact[-10:], 9.81, atol=0.2)
    assert parts.contact[:5].max() == 0, "in the air nothing carries"
