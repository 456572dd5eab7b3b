"""Flight: polynomials and free turns are fitted as they are, and first states come back with an honest covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.models.made import DT, toss_of, tosses
from tests.motion.bouncing import Truth, bounce, tracked
from tossid.errors import ObjectError
from tossid.motion import (
    FlightState,
    MeasurementModel,
    estimate_measurement,
    find_defects,
    flight_states,
    frames_in_flight,
    may_touch,
)
from tossid.motion.flight import fit_polynomial, free_turn, local_parabolas, without_line
from tossid.objects import OBJECT_FILES, ObjectModel, load_object
from tossid.physics import make_system, simulate
from tossid.rotations import quat_boxminus, quat_exp, quat_mul
from tossid.types import Toss

T = np.arange(60) / 148
PARABOLA = np.stack([0.5 * T, -0.2 * T, 1.0 + 2.0 * T - 0.5 * 9.81 * T**2], axis=1)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_polynomials_come_back_with_their_covariance(degree: int) -> None:
    rng, t = np.random.default_rng(0), np.arange(12) / 148 - 0.03
    true = rng.normal(size=(degree + 1, 2)) * 20.0 ** np.arange(degree + 1)[:, None]
    exact = sum(true[k] * t[:, None] ** k / [1, 1, 2, 6][k] for k in range(degree + 1))
    np.testing.assert_allclose(fit_polynomial(t, exact, degree).coefficients, true, rtol=1e-9)
    many = fit_polynomial(np.tile(t, (4000, 1)), exact + 1e-3 * rng.normal(size=(4000, 12, 2)), degree)
    assert np.sqrt(np.mean(many.noise**2)) == pytest.approx(1e-3, rel=0.02)
    scatter = np.mean((many.coefficients - true)[..., :, None, 0] * (many.coefficients - true)[..., None, :, 0], axis=0)
    size = np.sqrt(np.outer(np.diag(scatter), np.diag(scatter)))
    np.testing.assert_allclose(1e-6 * many.unit_cov[0] / size, scatter / size, atol=0.06)
    np.testing.assert_allclose(without_line(t) @ (3.0 - 2.0 * t), 0.0, atol=1e-12)


def test_a_symmetric_top_is_followed_as_euler_s_equations_have_it() -> None:
    """Euler's closed solution: R = exp(t L/I_1) exp(-Ω t e_3) with Ω = ω_3 (I_3 - I_1)/I_1."""
    I1, I3, spin = 6e-4, 1.1e-3, np.array([6.0, -4.0, 9.0])
    inertia, rate = np.diag([I1, I1, I3]), spin[2] * (I3 - I1) / I1
    expected = quat_mul(quat_exp(inertia @ spin / I1 * T[:, None]), quat_exp(np.array([0, 0, -rate]) * T[:, None]))
    turns, by_spin = free_turn(spin[None], T[None], inertia)
    np.testing.assert_allclose(quat_boxminus(turns[0], expected), 0.0, atol=1e-6)
    for axis in range(3):
        step = 1e-4 * np.eye(3)[axis]
        up, down = (free_turn((spin + sign * step)[None], T[None], inertia)[0][0] for sign in (1, -1))
        np.testing.assert_allclose(by_spin[0, :, :, axis], quat_boxminus(up, down) / 2e-4, atol=1e-5)


def test_one_wrong_frame_is_left_out_of_local_parabolas() -> None:
    x = PARABOLA.copy()
    x[30] += [0.0, 0.01, 0.0]
    for positions, wrong in ((PARABOLA, []), (x, [30])):
        v, a, outlier = local_parabolas(T, positions, 4, np.full(60, 1e-4))
        np.testing.assert_array_equal(np.flatnonzero(outlier), wrong)
        np.testing.assert_allclose(a, np.tile([0.0, 0.0, -9.81], (60, 1)), atol=1e-6)
        np.testing.assert_allclose(v[:, 2], 2.0 - 9.81 * T, atol=1e-6)


# first states


def as_toss(truth: Truth, rng: np.random.Generator, *, v_error: float = 0.0) -> Toss:
    track = tracked(truth, rng)
    made = toss_of("x", track.q, truth.v + v_error, cov=max(v_error, 1e-3) ** 2)
    return replace(made, t=track.t, q_cov=track.q_cov)


def first_state(toss: Toss, model: ObjectModel, **keys: float) -> FlightState:
    return flight_states([toss], model, **keys)[0]


def error_of(state: FlightState, truth: Truth) -> np.ndarray:
    turn = quat_boxminus(state.q[3:7], truth.q[0, 3:7])
    return np.concatenate([state.q[:3] - truth.q[0, :3], turn, state.v - truth.v[0]])


@pytest.mark.parametrize("body", ["cube", "odd"])
def test_the_first_state_is_recovered(body: str, request: pytest.FixtureRequest) -> None:
    model, rng = request.getfixturevalue(body), np.random.default_rng(1)
    truths = bounce(model, rng, tosses=12, frames=45)
    states = [first_state(as_toss(truth, rng, v_error=0.3), model) for truth in truths]
    errors = np.array([error_of(s, x) for s, x in zip(states, truths, strict=True)])
    assert all(12 < state.n_frames <= int(np.argmax(x.contact)) + 1 for state, x in zip(states, truths, strict=True))
    assert np.sqrt((errors[:, 6:9] ** 2).mean()) < 1.5e-3
    assert np.sqrt((errors[:, 9:] ** 2).mean()) < 1.5e-2
    honest = np.array([e @ np.linalg.solve(s.cov, e) / 12 for e, s in zip(errors, states, strict=True)])
    assert 0.6 < honest.mean() < 1.5
    assert 0.8 < np.mean([state.chi2 for state in states]) < 1.2
    exact = replace(as_toss(truths[0], rng), q=truths[0].q)
    np.testing.assert_allclose(error_of(first_state(exact, model), truths[0]), 0, atol=1e-4)


def test_wrong_gravity_shows_in_chi2_and_widens_the_covariance(cube: ObjectModel) -> None:
    rng = np.random.default_rng(3)
    toss = as_toss(bounce(cube, rng, tosses=1, frames=45)[0], rng)
    right, wrong = first_state(toss, cube), first_state(toss, cube, gravity=5.0)
    assert right.chi2 < 1.6
    assert wrong.chi2 > 20
    assert wrong.cov[8, 8] > 10 * right.cov[8, 8]


def test_with_few_frames_or_none_the_recorded_state_helps(cube: ObjectModel, elbow: ObjectModel) -> None:
    rng = np.random.default_rng(5)
    truth = bounce(cube, rng, tosses=1, frames=60)[0]
    first = int(np.argmax(truth.contact))
    late = Truth(truth.t[first - 3 :], truth.q[first - 3 :], truth.v[first - 3 :], truth.contact[first - 3 :])
    state = first_state(as_toss(late, rng), cube)
    assert 1 <= state.n_frames < 4
    assert np.abs(error_of(state, late)[6:9]).max() < 5e-3
    lying = np.tile([0, 0, 0.0524, 1.0, 0, 0, 0], (20, 1))
    toss = toss_of("x", lying, cov=1e-6)
    state = first_state(replace(toss, v_cov=4 * toss.v_cov), cube)
    assert state.n_frames == 0
    np.testing.assert_array_equal(state.q, lying[0])
    np.testing.assert_allclose(np.diag(state.cov), [1e-6] * 6 + [4e-6] * 6)
    with pytest.raises(ObjectError, match="joints"):
        first_state(as_toss(bounce(elbow, rng, tosses=1, frames=20)[0], rng), elbow)


def test_flight_ends_before_the_first_interval_that_may_touch(cube: ObjectModel) -> None:
    rng = np.random.default_rng(3)
    made = [as_toss(truth, rng) for truth in bounce(cube, rng, tosses=4, frames=90)]
    made += [made[0].frames(slice(0, 3)), made[1].frames(slice(0, 2)), made[3]]
    made.append(made[2].frames(slice(frames_in_flight([made[2]], cube)[0], None)))
    expected = []
    for toss in made:
        touches = np.flatnonzero(may_touch(cube, toss.t, toss.q))
        expected.append(len(toss) if not len(touches) else 0 if touches[0] == 0 else touches[0] + 1)
    assert {0, 2, 3} < set(expected)
    np.testing.assert_array_equal(frames_in_flight(made, cube), expected)
    assert len(frames_in_flight([], cube)) == 0


# the measurement model


def recorded(model: ObjectModel, *, scale: float, lag: float, count: int = 40) -> list[Toss]:
    """Tosses as a tracker with that scale and lag would record them, with 0.2 mm and 5 mm/s of noise."""
    rng = np.random.default_rng(5)
    out = []
    for toss in tosses(model, count, seed=2, frames=150):
        q, v = toss.q.copy(), toss.v.copy()
        v[1:, :3] -= lag * np.diff(toss.v[:, :3], axis=0) / DT
        v[0, 2] += lag * 9.81
        q[:, :3] = scale * q[:, :3] + 2e-4 * rng.normal(size=(len(q), 3))
        v[:, :3] = scale * v[:, :3] + 5e-3 * rng.normal(size=(len(v), 3))
        out.append(replace(toss, q=q, v=v))
    return out


@pytest.mark.parametrize("scale", [0.978, 1.03])
def test_scale_and_lag_are_found(cube: ObjectModel, scale: float) -> None:
    estimate = estimate_measurement(recorded(cube, scale=scale, lag=0.5 * DT), cube)
    assert estimate.n_at_rest > 20
    assert estimate.length_scale == pytest.approx(scale, abs=1.5e-3)
    assert estimate.velocity_lag == pytest.approx(0.5 * DT, rel=0.1)
    assert estimate.measurement == MeasurementModel(estimate.length_scale, estimate.velocity_lag)
    assert estimate.length_scale_ci95[0] < estimate.length_scale < estimate.length_scale_ci95[1]


@pytest.mark.parametrize(("scale", "count"), [(1.0, 40), (0.9, 5)], ids=["exact", "few"])
def test_exact_or_few_recordings_are_left_alone(cube: ObjectModel, scale: float, count: int) -> None:
    estimate = estimate_measurement(recorded(cube, scale=scale, lag=0.0, count=count), cube)
    assert estimate.measurement == MeasurementModel()
    assert np.isnan(estimate.length_scale_ci95).all() == (count < 8)


def test_true_lengths_are_recorded_lengths_over_the_scale(cube: ObjectModel) -> None:
    toss = tosses(cube, 1, seed=0)[0]
    toss = replace(toss, q_cov=toss.q_cov + np.eye(6), q_measured=toss.q, q_measured_cov=toss.q_cov + np.eye(6))
    measurement = MeasurementModel(length_scale=0.8)
    true = measurement.true_toss(toss)
    for poses in (true.q, true.measured[0]):
        np.testing.assert_allclose(measurement.recorded_q(poses), toss.q, atol=1e-12)
    np.testing.assert_allclose(0.8 * true.v[:, :3], toss.v[:, :3], atol=1e-12)
    np.testing.assert_array_equal(true.v[:, 3:], toss.v[:, 3:])
    for cov in (true.q_cov, true.measured[1]):
        np.testing.assert_allclose(np.diagonal(cov[0]), [0.8**-2] * 3 + [1.0] * 3)


# defects


@pytest.fixture(scope="module", params=["cube", "elbow"])
def model(request: pytest.FixtureRequest) -> ObjectModel:
    return load_object(OBJECT_FILES / f"{request.param}.xml")


@pytest.fixture(scope="module")
def sound(model: ObjectModel) -> list[Toss]:
    rng = np.random.default_rng(0)
    q = np.column_stack([np.tile([0, 0, 0.35], (12, 1)), rng.normal(size=(12, 4)), np.zeros((12, model.n_joints))])
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    v = rng.normal(size=(12, model.nv)) * np.r_[1, 1, 0.3, np.full(model.nv - 3, 5)]
    run = simulate(make_system(model), q, v, n_steps=90, dt=DT, substeps=8)
    return [toss_of(str(i), run.q[i], run.v[i], cov=1e-6) for i in range(12)]


def spun(toss: Toss, frame: int, by: float) -> Toss:
    """With another speed of the last coordinate in one frame; the pose does not follow."""
    return replace(
        toss, v=toss.v + by * np.outer(np.arange(91) == frame, np.arange(toss.v.shape[1]) == toss.v.shape[1] - 1)
    )


def turned(toss: Toss) -> Toss:
    q = toss.q.copy()
    q[60:, 3:7] = quat_mul(q[60:, 3:7], quat_exp(np.array([0, 0, 0.5 * np.pi])))
    return replace(toss, q=q)


@pytest.mark.parametrize(
    ("spoil", "which", "rule"),
    [
        (turned, 3, "flip"),
        (lambda toss: spun(toss, 5, 20.0), 5, "jolt"),  # in the air
        (lambda toss: spun(toss, 70, 90.0), 5, "speed"),
        (lambda toss: replace(toss, q=toss.q + np.outer(2.5 * toss.t**2, np.eye(toss.q.shape[1])[0])), 7, "flight"),
    ],
)
def test_each_defect_is_found_where_it_is_put_in(sound: list[Toss], model: ObjectModel, spoil, which, rule) -> None:
    found = find_defects([sound[2], spoil(sound[which])], model)
    assert {defect.toss for defect in found} == {str(which)}
    assert rule in {defect.rule for defect in found}
    assert len(found) == 1 or rule == "speed"


def test_sound_tosses_have_none_but_under_another_gravity(sound: list[Toss], model: ObjectModel) -> None:
    assert find_defects(sound, model) == ()
    found = find_defects(sound, model, gravity=4.0)
    assert {defect.rule for defect in found} == {"flight"}
    assert len(found) > 8
    np.testing.assert_allclose([defect.value for defect in found], 5.81, atol=0.05)
