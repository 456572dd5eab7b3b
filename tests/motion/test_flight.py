"""The first state is recovered from free flight, with an honest covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.motion.bouncing import Truth, bounce, tracked
from tossid.errors import ObjectError
from tossid.motion import FlightState, flight_frames, flight_state, flight_states, frames_in_flight, may_touch
from tossid.objects import ObjectModel
from tossid.rotations import quat_boxminus, quat_exp, quat_mul
from tossid.types import Toss


def toss_of(truth: Truth, rng: np.random.Generator, *, v_error: float = 0.0) -> Toss:
    track = tracked(truth, rng)
    assert track.q_cov is not None
    n, nv = truth.v.shape
    v = truth.v + v_error
    v_cov = np.tile(np.eye(nv) * max(v_error, 1e-3) ** 2, (n, 1, 1))
    return Toss("x", track.t, track.q, v, track.q_cov, v_cov, np.zeros(n, dtype=np.uint8))


def error_of(state: FlightState, truth: Truth) -> np.ndarray:
    return np.concatenate(
        [state.q[:3] - truth.q[0, :3], quat_boxminus(state.q[3:7], truth.q[0, 3:7]), state.v - truth.v[0]]
    )


@pytest.mark.parametrize("odd", [False, True], ids=["cube", "offset mass, uneven inertia"])
def test_the_first_state_is_recovered(cube: ObjectModel, odd: bool) -> None:
    model = cube
    if odd:
        model = cube.with_changes(com=np.array([[0.01, -0.005, 0.008]]), inertia=np.diag([6e-4, 9e-4, 1.2e-3])[None])
    rng = np.random.default_rng(1)
    truths = bounce(model, rng, tosses=12, frames=45)
    states = [flight_state(toss_of(truth, rng, v_error=0.3), model) for truth in truths]
    errors = np.array([error_of(s, x) for s, x in zip(states, truths, strict=True)])
    assert all(12 < state.n_frames <= int(np.argmax(x.contact)) + 1 for state, x in zip(states, truths, strict=True))
    assert np.sqrt((errors[:, 6:9] ** 2).mean()) < 1.5e-3
    assert np.sqrt((errors[:, 9:] ** 2).mean()) < 1.5e-2
    honest = np.array([e @ np.linalg.solve(s.cov, e) / 12 for e, s in zip(errors, states, strict=True)])
    assert 0.6 < honest.mean() < 1.5
    assert 0.8 < np.mean([state.chi2 for state in states]) < 1.2


def test_exact_poses_give_the_exact_state(cube: ObjectModel) -> None:
    model = cube.with_changes(com=np.array([[0.01, -0.005, 0.008]]), inertia=np.diag([6e-4, 9e-4, 1.2e-3])[None])
    rng = np.random.default_rng(2)
    truth = bounce(model, rng, tosses=1, frames=40)[0]
    toss = replace(toss_of(truth, rng), q=truth.q)
    np.testing.assert_allclose(error_of(flight_state(toss, model), truth), 0, atol=1e-4)


def test_wrong_gravity_shows_in_chi2_and_widens_the_covariance(cube: ObjectModel) -> None:
    rng = np.random.default_rng(3)
    toss = toss_of(bounce(cube, rng, tosses=1, frames=45)[0], rng)
    right, wrong = flight_state(toss, cube), flight_state(toss, cube, gravity=5.0)
    assert right.chi2 < 1.6
    assert wrong.chi2 > 20
    assert wrong.cov[8, 8] > 10 * right.cov[8, 8]


def test_a_toss_that_starts_in_contact_keeps_its_state(cube: ObjectModel) -> None:
    n = 20
    q = np.tile([0, 0, 0.0524, 1.0, 0, 0, 0], (n, 1))
    cov = np.tile(np.eye(6) * 1e-6, (n, 1, 1))
    toss = Toss("x", np.arange(n) / 148, q, np.zeros((n, 6)), cov, 4 * cov, np.zeros(n, dtype=np.uint8))
    state = flight_state(toss, cube)
    assert state.n_frames == 0
    np.testing.assert_array_equal(state.q, q[0])
    np.testing.assert_allclose(np.diag(state.cov), [1e-6] * 6 + [4e-6] * 6)


def test_with_few_frames_the_recorded_velocity_helps(cube: ObjectModel) -> None:
    rng = np.random.default_rng(5)
    truth = bounce(cube, rng, tosses=1, frames=60)[0]
    first = int(np.argmax(truth.contact))
    late = Truth(truth.t[first - 3 :], truth.q[first - 3 :], truth.v[first - 3 :], truth.contact[first - 3 :])
    state = flight_state(toss_of(late, rng), cube)
    assert 1 <= state.n_frames < 4
    assert np.abs(error_of(state, late)[6:9]).max() < 5e-3


def test_articulated_flight_is_refused(cube: ObjectModel, elbow: ObjectModel) -> None:
    rng = np.random.default_rng(0)
    truth = bounce(elbow, rng, tosses=1, frames=20)[0]
    with pytest.raises(ObjectError, match="joints"):
        flight_state(toss_of(truth, rng), elbow)


def test_a_symmetric_top_is_followed_as_euler_s_equations_have_it(cube: ObjectModel) -> None:
    """Euler's closed solution: R = exp(t L/I_1) exp(-Ω t e_3) with Ω = ω_3 (I_3 - I_1)/I_1."""
    I1, I3, sigma = 6e-4, 1.1e-3, 2e-8
    top = cube.with_changes(inertia=np.diag([I1, I1, I3])[None])
    spin, t = np.array([6.0, -4.0, 9.0]), np.linspace(0, 0.4, 60)
    rate = spin[2] * (I3 - I1) / I1
    momentum = np.diag([I1, I1, I3]) @ spin
    q = np.zeros((60, 7))
    q[:, 0], q[:, 2] = 0.3 * t, 2.0 - 0.5 * 9.81 * t**2
    q[:, 3:] = quat_mul(quat_exp(momentum / I1 * t[:, None]), quat_exp(np.array([0, 0, -rate]) * t[:, None]))
    v = np.tile([0.3, 0.0, 0.0, *(1.2 * spin)], (60, 1))
    cov = np.tile(np.eye(6), (60, 1, 1))
    toss = Toss("top", t, q, v, sigma**2 * cov, cov, np.zeros(60, dtype=np.uint8))
    state = flight_state(toss, top, gravity=9.81)
    assert state.n_frames == 60
    assert state.chi2 < 1.0
    assert np.abs(state.v - [0.3, 0.0, 0.0, *spin]).max() < 1e-6


def test_threads_share_flights_out_and_change_no_digit(cube: ObjectModel) -> None:
    rng = np.random.default_rng(4)
    tosses = [toss_of(truth, rng) for truth in bounce(cube, rng, tosses=6, frames=30)]
    for one, other in zip(flight_states(tosses, cube), flight_states(tosses, cube, n_threads=2), strict=True):
        assert (one.v == other.v).all()
        assert (one.cov == other.cov).all()


def test_flight_ends_before_the_first_interval_that_may_touch(cube: ObjectModel) -> None:
    rng = np.random.default_rng(3)
    tosses = [toss_of(truth, rng) for truth in bounce(cube, rng, tosses=4, frames=90)]
    tosses += [tosses[0].frames(slice(0, 3)), tosses[1].frames(slice(0, 2)), tosses[3]]
    tosses.append(tosses[2].frames(slice(flight_frames(tosses[2], cube), None)))
    expected = []
    for toss in tosses:
        touches = np.flatnonzero(may_touch(cube, toss.t, toss.q))
        expected.append(len(toss) if not len(touches) else 0 if touches[0] == 0 else touches[0] + 1)
    assert {0, 2, 3} < set(expected)
    np.testing.assert_array_equal(frames_in_flight(tosses, cube), expected)
    assert [flight_frames(toss, cube) for toss in tosses] == expected
    assert len(frames_in_flight([], cube)) == 0
