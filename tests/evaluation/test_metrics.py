"""Errors, short rollouts and the parts of an acceleration, against what they are by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.models.made import DT, toss_of
from tests.models.made import flights as made_flights
from tossid.evaluation.accelerations import accelerations_over_toss
from tossid.evaluation.metrics import score_tosses, score_windows, wrapped
from tossid.models.implicit import LossWeights
from tossid.models.predictor import Simulator
from tossid.objects import ObjectModel
from tossid.physics import System, make_system, no_learned_acceleration, simulate
from tossid.rotations import quat_normalize
from tossid.types import Phase, Toss


@pytest.fixture(scope="module")
def flights(elbow: ObjectModel) -> list[Toss]:
    return made_flights(elbow, 3)


def test_the_truth_has_no_error_whichever_turns_and_frames_are_recorded(
    elbow: ObjectModel, flights: list[Toss]
) -> None:
    predictor, there = (
        Simulator(make_system(elbow), substeps=16, impact_parts=1),
        np.setdiff1d(np.arange(31), [3, 10, 29]),
    )
    turned = [replace(toss, q=toss.q + 2 * np.pi * np.eye(8)[7]) for toss in flights]
    for tosses in (flights, turned, [toss.frames(there) for toss in flights]):
        scores = score_tosses(predictor, elbow, tosses)
        for value in (scores.joint_error_deg, scores.position_error_pct, scores.link_error_deg, scores.flight_miss_pct):
            np.testing.assert_allclose(value, 0, atol=1e-4)


def test_the_error_in_flight_is_that_of_gravity(elbow: ObjectModel, flights: list[Toss]) -> None:
    still = replace(flights[0], v=0 * flights[0].v)
    scores = score_tosses(Simulator(make_system(elbow, gravity=0.9 * 9.81)), elbow, [still])
    assert scores.flight_miss_pct[0] == pytest.approx(10.0)


def test_recorded_poses_have_a_penetration_of_their_own(cube: ObjectModel) -> None:
    """A cube that is recorded 2 mm too low at rest: its rollout, lifted onto the ground, does not sink."""
    q = np.tile([0.0, 0.0, 0.5 * cube.width - 0.002, 1.0, 0.0, 0.0, 0.0], (20, 1))
    scores = score_tosses(Simulator(make_system(cube)), cube, [toss_of("low", q, cov=1e-9)])
    assert scores.recorded_penetration_mm[0] == pytest.approx(2.0)
    assert scores.penetration_mm[0] < 0.1


def test_short_rollouts_start_anew(elbow: ObjectModel, flights: list[Toss]) -> None:
    """With gravity off by d, the k-th frame is off by d (k dt)² / 2: over 16 steps from each start."""
    predictor = Simulator(make_system(elbow, gravity=9.31))
    short = score_windows(predictor, elbow, flights)
    frames = np.arange(17) * DT
    expected = 100 * (0.25 * frames**2).mean() / elbow.width
    np.testing.assert_allclose(short.position_error_pct, expected, rtol=0.02)
    assert (score_tosses(predictor, elbow, flights).position_error_pct > 3 * expected).all()
    assert np.isnan(score_windows(predictor, elbow, [*flights, flights[0].frames(slice(0, 9))]).position_error_pct[3])


def test_a_rotation_error_is_at_most_half_a_turn() -> None:
    np.testing.assert_allclose(wrapped(np.array([0.1, 2 * np.pi - 0.1, -3 * np.pi + 0.2])), [0.1, -0.1, -np.pi + 0.2])


# ---------------------------------------------------------------- parts of a model's acceleration


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
    run = simulate(system, q0, v0, n_steps=frames, dt=DT)
    pushes = run.lam_n[0].sum(axis=1)
    phase = np.where(np.concatenate([[0.0], pushes]) > 0, Phase.SLIDE, Phase.FLIGHT).astype(np.uint8)
    toss = toss_of("own", run.q[0], run.v[0], cov=1e-6, phase=phase)
    return toss, pushes / (model.mass.sum() * DT)


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
    tracked = replace(toss, q=toss.q + 1e-3 * np.outer(np.where(np.arange(111) % 2, 1, -1), np.eye(7)[2]))
    parts = accelerations_over_toss(system, cube, tracked)
    np.testing.assert_allclose(parts.contact[-10:], 9.81, atol=0.2)
    assert parts.contact[:5].max() == 0, "in the air nothing carries"
