"""The smoother is least squares, recovers known velocities, says honestly how well, and spares impacts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.motion.bouncing import Truth, away_from_jumps, bounce, tracked
from tossid.motion import may_touch
from tossid.motion.smoothing.rts import LinearSystem, smooth
from tossid.motion.smoothing.smoother import Smoothed, smooth_in_turn
from tossid.motion.smoothing.system import differences, linearise, pad, retract
from tossid.objects import ObjectModel
from tossid.rotations import quat_boxminus
from tossid.types import PoseTrack

Case = tuple[list[Truth], list[PoseTrack], list[Smoothed]]
HALF_FALL = 0.5 * 9.81 / 148
"""[m/s] jumps beyond this count as impacts: half of what gravity does in a frame."""


def test_the_smoother_is_least_squares() -> None:
    """Means and covariances of a random system are those of the one large normal equation."""
    rng = np.random.default_rng(2)
    n, N, m = 6, 4, 2
    F, d = rng.normal(size=(n - 1, 1, N, N)), rng.normal(size=(n - 1, 1, N))
    roots = rng.normal(size=(n - 1, 1, N, N))
    Q, R = roots @ roots.mT, np.tile(np.diag([0.3, 0.1]), (n, 1, 1, 1))
    y, P0 = rng.normal(size=(n, 1, m)), np.diag([4.0, 3.0, 2.0, 1.0])
    seen = np.array([True, True, False, True, True, True])[:, None]
    mean, cov, lag = smooth(LinearSystem(F, d, Q, y, R, seen, P0))

    A, b = np.zeros((n * N, n * N)), np.zeros(n * N)
    A[:N, :N] += np.linalg.inv(P0)
    for k in np.flatnonzero(seen[:, 0]):
        W = np.linalg.inv(R[k, 0])
        A[k * N : k * N + m, k * N : k * N + m] += W
        b[k * N : k * N + m] += W @ y[k, 0]
    for k in range(n - 1):
        J = np.zeros((N, n * N))
        J[:, k * N : (k + 1) * N], J[:, (k + 1) * N : (k + 2) * N] = -F[k, 0], np.eye(N)
        W = np.linalg.inv(Q[k, 0])
        A += J.T @ W @ J
        b += J.T @ W @ d[k, 0]
    whole = np.linalg.inv(A)
    np.testing.assert_allclose(mean[:, 0].ravel(), whole @ b, atol=1e-8)
    for k in range(n):
        own = slice(k * N, (k + 1) * N)
        np.testing.assert_allclose(cov[k, 0], whole[own, own], atol=1e-8)
        if k:
            np.testing.assert_allclose(lag[k - 1, 0], whole[(k - 1) * N : k * N, own], atol=1e-8)


def test_transitions_are_derivatives(odd: ObjectModel) -> None:
    """F by central differences of the defect: d(x ⊞ δ) = d(x) + F δ."""
    rng = np.random.default_rng(0)
    track = tracked(bounce(odd, rng, tosses=1, frames=6)[0], rng)
    batch = pad([track], odd, [track.q_cov])
    q, v = batch.q.copy(), differences(batch.q, batch.h)
    S, fall = np.ones((5, 1, 6)), np.full((5, 1), 9.81)
    for k in range(5):  # a reference that moves as the model does, so that the defect is zero
        step = np.zeros((6, 1, 12))
        step[k + 1] = linearise(odd, q, v, batch, S, fall).d[k]
        q, v = retract(q, v, step)
    system = linearise(odd, q, v, batch, S, fall)
    np.testing.assert_allclose(system.d, 0, atol=1e-9)
    for k in range(5):
        for column in range(12):
            step = np.zeros((6, 1, 12))
            step[k, :, column] = 1e-5
            ahead, back = (linearise(odd, *retract(q, v, sign * step), batch, S, fall).d[k, 0] for sign in (1, -1))
            np.testing.assert_allclose((ahead - back) / 2e-5, system.F[k, 0, :, column], atol=2e-5)


def smoothed(model: ObjectModel, truths: list[Truth], *, seed: int = 1, **noise: float) -> Case:
    rng = np.random.default_rng(seed)
    tracks = [tracked(truth, rng, name=str(i), **noise) for i, truth in enumerate(truths)]
    cov = [track.q_cov for track in tracks if track.q_cov is not None]
    return truths, tracks, list(smooth_in_turn(tracks, model, cov))


def v_error(truth: Truth, result: Smoothed) -> np.ndarray:
    return result.v - truth.v


def q_error(truth: Truth, result: Smoothed) -> np.ndarray:
    turn = quat_boxminus(result.q[:, 3:7], truth.q[:, 3:7])
    return np.column_stack([result.q[:, :3] - truth.q[:, :3], turn, result.q[:, 7:] - truth.q[:, 7:]])


def nees(error: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Normalised squared error (n,), 1 on average where the covariance is honest."""
    return np.einsum("ki,ki->k", error, np.linalg.solve(cov, error[..., None])[..., 0]) / error.shape[1]


def clear_frames(result: Smoothed) -> np.ndarray:
    """Frames with flight on both sides."""
    clear = ~result.contact
    return np.concatenate([[True], clear]) & np.concatenate([clear, [True]])


def in_flight(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Errors of velocities in flight (n, nv), and their normalised squares (n,)."""
    error, honest = [], []
    for truth, _, result in zip(*case, strict=True):
        at = clear_frames(result)
        error.append(v_error(truth, result)[at])
        honest.append(nees(error[-1], result.v_cov[at]))
    return np.concatenate(error), np.concatenate(honest)


@pytest.fixture(scope="module")
def case(cube: ObjectModel) -> Case:
    return smoothed(cube, bounce(cube, np.random.default_rng(0), tosses=30, frames=120))


def test_velocities_are_recovered_and_in_flight_much_better(case: Case) -> None:
    error = np.concatenate([v_error(x, s)[away_from_jumps(x, HALF_FALL)] for x, _, s in zip(*case, strict=True)])
    assert len(error) > 1000
    for some, v, w in ((error, 0.02, 0.15), (in_flight(case)[0], 0.002, 0.03)):
        assert np.sqrt((some[:, :3] ** 2).mean()) < v
        assert np.sqrt((some[:, 3:] ** 2).mean()) < w


def test_covariances_are_honest_in_flight_and_not_too_small_in_contact(case: Case) -> None:
    of_q = [nees(q_error(x, s), s.q_cov)[clear_frames(s)] for x, _, s in zip(*case, strict=True)]
    assert 0.7 < np.concatenate(of_q).mean() < 1.5
    assert 0.7 < in_flight(case)[1].mean() < 1.5
    everywhere = np.concatenate([nees(v_error(x, s), s.v_cov) for x, _, s in zip(*case, strict=True)])
    assert 0.3 < everywhere.mean() < 1.5
    # 95 % quantile of χ² with 6 degrees of freedom is 12.6
    assert (6 * everywhere > 12.6).mean() < 0.08


def test_poses_are_better_than_measured_and_no_contact_is_taken_for_flight(case: Case) -> None:
    for truth, track, result in zip(*case, strict=True):
        before, after = ((q[:, :3] - truth.q[:, :3]) ** 2 for q in (track.q, result.q))
        assert after.mean() < before.mean()
    touched = np.concatenate([truth.contact for truth in case[0]])
    found = np.concatenate([result.contact for result in case[2]])
    assert touched.sum() > 500
    assert not (touched & ~found).any()


def test_velocity_after_an_impact_does_not_depend_on_that_before(cube: ObjectModel) -> None:
    """Two flights with the same end and different beginnings: what follows the impact must not tell them apart."""
    truth = bounce(cube, np.random.default_rng(4), tosses=1, frames=60)[0]
    impact = int(np.argmax(truth.contact))
    other = truth.q.copy()
    # the same poses from the impact on; before it, one metre a second faster sideways
    other[: impact + 1, 0] += (truth.t[: impact + 1] - truth.t[impact]) * 1.0
    _, _, (a,) = smoothed(cube, [truth], seed=2)
    _, _, (b,) = smoothed(cube, [Truth(truth.t, other, truth.v, truth.contact)], seed=2)
    assert np.abs((a.v - b.v)[: impact - 2, 0]).min() > 0.9
    assert np.abs((a.v - b.v)[impact + 3 :, 0]).max() < 0.01


def test_an_impact_in_mid_air_is_not_smoothed(cube: ObjectModel) -> None:
    """A jump of 1 m/s half a metre above the ground, where the geometry knows of no contact."""
    n, hit = 50, 25
    t, q, v = np.arange(n) / 148, np.zeros((n, 7)), np.zeros((n, 6))
    q[:, 2], q[:, 3] = 1.0 - 4.905 * t**2, 1.0
    v[:, 2], v[hit:, 0] = -9.81 * t, 1.0
    q[hit:, 0] = t[hit:] - t[hit] + 0.5 / 148
    _, _, (result,) = smoothed(cube, [Truth(t, q, v, np.zeros(n - 1, dtype=bool))])
    assert not may_touch(cube, t, q).any()
    assert result.contact[hit - 1]
    error = np.abs(result.v - v)[:, 0]
    assert max(error[: hit - 1].max(), error[hit + 2 :].max()) < 0.02
    assert 2 < result.contact.sum() < 10 or result.contact.sum() == 1


def test_wrong_geometry_is_noticed_in_the_motion(cube: ObjectModel) -> None:
    """Corners stated 15 mm too short: the ground is met where the geometry says it cannot be."""
    truths = bounce(cube, np.random.default_rng(0), tosses=10, frames=100)
    small = cube.with_changes(corner_pos=0.7 * cube.corner_pos)
    _, tracks, results = smoothed(small, truths)
    touched = np.concatenate([truth.contact for truth in truths])
    gate = np.concatenate([may_touch(small, track.t, track.q) for track in tracks])
    found = np.concatenate([result.contact for result in results])
    assert (touched & ~gate).sum() > 20
    assert (touched & ~found).sum() < 0.1 * touched.sum()


UNEVEN = np.concatenate([[0.0], np.cumsum(np.random.default_rng(8).integers(6, 26, size=39) * 5e-4)])


@pytest.mark.parametrize(
    ("body", "made", "v", "least", "most"),
    [
        ("cube", {"tosses": 30, "frames": 40, "times": UNEVEN}, 0.003, 0.6, 1.5),  # missing frames
        ("odd", {"tosses": 12, "frames": 50}, 0.003, 0.6, 1.5),  # its origin's velocity is asked for
        ("cube", {"tosses": 15, "frames": 50, "gravity": 8.5}, 0.2, 0.0, 1.5),  # an unmodelled force widens
    ],
    ids=["uneven times", "offset mass", "another gravity"],
)
def test_flights_are_recovered_with_honest_covariances(
    body: str, made: dict[str, Any], v: float, least: float, most: float, request: pytest.FixtureRequest
) -> None:
    model = request.getfixturevalue(body)
    error, honest = in_flight(smoothed(model, bounce(model, np.random.default_rng(5), **made)))
    assert np.sqrt((error[:, :3] ** 2).mean()) < v
    assert least < honest.mean() < most


def test_the_density_in_contact_is_estimated_from_precise_poses(cube: ObjectModel) -> None:
    """Covariances of velocities away from impacts are neither too small nor, as with a fixed density, too large."""
    truths = bounce(cube, np.random.default_rng(5), tosses=12, frames=120)
    _, _, results = smoothed(cube, truths, seed=6, position=6e-6, rotation=1e-4)
    away = [away_from_jumps(truth, 3 * HALF_FALL) for truth in truths]
    of_v = [nees(v_error(x, s)[at], s.v_cov[at]) for x, s, at in zip(truths, results, away, strict=True)]
    assert 0.7 < np.concatenate(of_v).mean() < 1.5


def test_a_track_comes_out_the_same_beside_longer_ones(cube: ObjectModel) -> None:
    truths = bounce(cube, np.random.default_rng(6), tosses=2, frames=60)
    short = Truth(truths[0].t[:35], truths[0].q[:35], truths[0].v[:35], truths[0].contact[:34])
    rng = np.random.default_rng(0)
    track, longer = tracked(short, rng, name="a"), tracked(truths[1], rng, name="b")
    cov = [each.q_cov for each in (track, longer) if each.q_cov is not None]
    (alone,) = smooth_in_turn([track], cube, cov[:1])
    _, beside = smooth_in_turn([longer, track], cube, cov[::-1])
    np.testing.assert_allclose(alone.q[:, :3], beside.q[:, :3], atol=2e-5)
    assert (len(beside.q), beside.v_cov.shape) == (35, (35, 6, 6))


def test_an_articulated_object(elbow: ObjectModel) -> None:
    truths, _, results = smoothed(elbow, bounce(elbow, np.random.default_rng(2), tosses=10, frames=100))
    error, honest = [], []
    for truth, result in zip(truths, results, strict=True):
        at = away_from_jumps(truth, 0.1)
        error.append(v_error(truth, result)[at])
        honest.append(nees(error[-1], result.v_cov[at]))
    rms = np.sqrt((np.concatenate(error) ** 2).mean(axis=0))
    assert (rms[:3] < 0.025).all()
    assert (rms[3:6] < 0.3).all()
    assert 0.2 < np.concatenate(honest).mean() < 1.5
