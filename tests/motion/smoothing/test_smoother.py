"""The smoother recovers known velocities, says honestly how well, and does not smooth across impacts."""

from __future__ import annotations

import numpy as np
import pytest

from tests.motion.bouncing import Truth, away_from_jumps, bounce, tracked
from tossid.motion import Smoothed, may_touch, smooth_in_turn
from tossid.objects import ObjectModel
from tossid.rotations import quat_boxminus
from tossid.settings.motion import SmootherSettings
from tossid.types import PoseTrack

Case = tuple[list[Truth], list[PoseTrack], list[Smoothed]]
HALF_FALL = 0.5 * 9.81 / 148
"""[m/s] jumps beyond this count as impacts: half of what gravity does in a frame."""


def smoothed(model: ObjectModel, truths: list[Truth], *, gravity: float = 9.81, seed: int = 1) -> Case:
    rng = np.random.default_rng(seed)
    tracks = [tracked(truth, rng, name=str(i)) for i, truth in enumerate(truths)]
    cov = [track.q_cov for track in tracks if track.q_cov is not None]
    return truths, tracks, list(smooth_in_turn(tracks, model, cov, gravity=gravity))


def errors(truth: Truth, result: Smoothed) -> tuple[np.ndarray, np.ndarray]:
    q = np.concatenate(
        [
            result.q[:, :3] - truth.q[:, :3],
            quat_boxminus(result.q[:, 3:7], truth.q[:, 3:7]),
            result.q[:, 7:] - truth.q[:, 7:],
        ],
        axis=1,
    )
    return q, result.v - truth.v


def nees(error: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Normalised squared error (n,), 1 on average where the covariance is honest."""
    return np.einsum("ki,ki->k", error, np.linalg.solve(cov, error[..., None])[..., 0]) / error.shape[1]


def clear_frames(truth: Truth, track: PoseTrack, model: ObjectModel, result: Smoothed) -> np.ndarray:
    """Frames with flight on both sides."""
    clear = ~result.contact
    return np.concatenate([[True], clear]) & np.concatenate([clear, [True]])


@pytest.fixture(scope="module")
def case(cube: ObjectModel) -> Case:
    return smoothed(cube, bounce(cube, np.random.default_rng(0), tosses=30, frames=120))


def test_velocities_are_recovered(case: Case) -> None:
    error = np.concatenate([errors(x, s)[1][away_from_jumps(x, HALF_FALL)] for x, _, s in zip(*case, strict=True)])
    assert len(error) > 1000
    assert np.sqrt((error[:, :3] ** 2).mean()) < 0.02
    assert np.sqrt((error[:, 3:] ** 2).mean()) < 0.15


def test_flight_is_recovered_much_better(case: Case, cube: ObjectModel) -> None:
    error = np.concatenate([errors(x, s)[1][clear_frames(x, t, cube, s)] for x, t, s in zip(*case, strict=True)])
    assert np.sqrt((error[:, :3] ** 2).mean()) < 0.002
    assert np.sqrt((error[:, 3:] ** 2).mean()) < 0.03


def test_covariances_in_flight_are_honest(case: Case, cube: ObjectModel) -> None:
    of_q, of_v = [], []
    for truth, track, result in zip(*case, strict=True):
        at = clear_frames(truth, track, cube, result)
        q, v = errors(truth, result)
        of_q.append(nees(q[at], result.q_cov[at]))
        of_v.append(nees(v[at], result.v_cov[at]))
    assert 0.7 < np.concatenate(of_q).mean() < 1.5
    assert 0.7 < np.concatenate(of_v).mean() < 1.5


def test_covariances_in_contact_are_not_too_small(case: Case) -> None:
    everywhere = np.concatenate([nees(errors(x, s)[1], s.v_cov) for x, _, s in zip(*case, strict=True)])
    assert 0.3 < everywhere.mean() < 1.5
    # 95 % quantile of χ² with 6 degrees of freedom is 12.6
    assert (6 * everywhere > 12.6).mean() < 0.08


@pytest.mark.parametrize("density_passes", [0, 8])
def test_the_density_in_contact_is_estimated_from_precise_poses(cube: ObjectModel, density_passes: int) -> None:
    """Covariances of velocities away from impacts are neither too small nor, as with a fixed density, too large."""
    settings = SmootherSettings(density_passes=density_passes)
    truths = bounce(cube, np.random.default_rng(5), tosses=12, frames=120)
    tracks = [tracked(truth, np.random.default_rng(6), position=6e-6, rotation=1e-4) for truth in truths]
    covs = [track.q_cov for track in tracks if track.q_cov is not None]
    results = list(smooth_in_turn(tracks, cube, covs, settings=settings))
    away = [away_from_jumps(truth, 3 * HALF_FALL) for truth in truths]
    of_v = [nees(errors(x, s)[1][at], s.v_cov[at]) for x, s, at in zip(truths, results, away, strict=True)]
    mean = np.concatenate(of_v).mean()
    assert 0.7 < mean < 1.5 if density_passes else mean < 0.75


def test_poses_are_better_than_measured(case: Case) -> None:
    for truth, track, result in zip(*case, strict=True):
        before = np.linalg.norm(track.q[:, :3] - truth.q[:, :3], axis=1)
        after = np.linalg.norm(result.q[:, :3] - truth.q[:, :3], axis=1)
        assert np.sqrt((after**2).mean()) < np.sqrt((before**2).mean())


def test_no_contact_is_taken_for_flight(case: Case) -> None:
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
    twin = Truth(truth.t, other, truth.v, truth.contact)
    _, _, (a,) = smoothed(cube, [truth], seed=2)
    _, _, (b,) = smoothed(cube, [twin], seed=2)
    assert np.abs((a.v - b.v)[: impact - 2, 0]).min() > 0.9
    assert np.abs((a.v - b.v)[impact + 3 :, 0]).max() < 0.01


def test_an_impact_in_mid_air_is_not_smoothed(cube: ObjectModel) -> None:
    """A jump of 1 m/s half a metre above the ground, where the geometry knows of no contact."""
    n, hit = 50, 25
    t = np.arange(n) / 148
    q = np.zeros((n, 7))
    q[:, 2], q[:, 3] = 1.0 - 4.905 * t**2, 1.0
    v = np.zeros((n, 6))
    v[:, 2], v[hit:, 0] = -9.81 * t, 1.0
    q[hit:, 0] = t[hit:] - t[hit] + 0.5 / 148
    truth = Truth(t, q, v, np.zeros(n - 1, dtype=bool))
    _, _, (result,) = smoothed(cube, [truth])
    assert not may_touch(cube, t, q).any()
    assert result.contact[hit - 1]
    error = np.abs(result.v - v)[:, 0]
    assert error[: hit - 1].max() < 0.02
    assert error[hit + 2 :].max() < 0.02
    assert 2 < result.contact.sum() < 10 or result.contact.sum() == 1


def test_an_unmodelled_force_widens_the_covariance(cube: ObjectModel) -> None:
    truths = bounce(cube, np.random.default_rng(3), tosses=15, frames=50, gravity=8.5)
    of_v = []
    for truth, track, result in zip(*smoothed(cube, truths), strict=True):
        at = clear_frames(truth, track, cube, result)
        of_v.append(nees(errors(truth, result)[1][at], result.v_cov[at]))
    assert np.concatenate(of_v).mean() < 1.5


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


def test_uneven_times_and_missing_frames(cube: ObjectModel) -> None:
    rng = np.random.default_rng(8)
    times = np.concatenate([[0.0], np.cumsum(rng.integers(6, 26, size=39) * 5e-4)])
    truths = bounce(cube, rng, tosses=30, frames=40, times=times)
    truths, tracks, results = smoothed(cube, truths)
    errs, honest = [], []
    for truth, track, result in zip(truths, tracks, results, strict=True):
        at = clear_frames(truth, track, cube, result)
        errs.append(errors(truth, result)[1][at])
        honest.append(nees(errs[-1], result.v_cov[at]))
    assert np.sqrt((np.concatenate(errs)[:, :3] ** 2).mean()) < 0.003
    assert 0.6 < np.concatenate(honest).mean() < 1.5


def test_a_track_comes_out_the_same_beside_longer_ones(cube: ObjectModel) -> None:
    truths = bounce(cube, np.random.default_rng(6), tosses=2, frames=60)
    short = Truth(truths[0].t[:35], truths[0].q[:35], truths[0].v[:35], truths[0].contact[:34])
    rng = np.random.default_rng(0)
    track, longer = tracked(short, rng, name="a"), tracked(truths[1], rng, name="b")
    cov = [track.q_cov, longer.q_cov]
    (alone,) = smooth_in_turn([track], cube, cov[:1])
    _, beside = smooth_in_turn([longer, track], cube, cov[::-1])
    np.testing.assert_allclose(alone.q[:, :3], beside.q[:, :3], atol=2e-5)
    assert len(beside.q) == 35
    assert beside.v_cov.shape == (35, 6, 6)


def test_an_offset_mass_and_uneven_inertia(cube: ObjectModel) -> None:
    """The base frame's origin is not the centre of mass: its velocity, not the centre's, is asked for."""
    odd = cube.with_changes(com=np.array([[0.01, -0.005, 0.008]]), inertia=np.diag([6e-4, 9e-4, 1.2e-3])[None])
    of_v, error = [], []
    for truth, track, result in zip(
        *smoothed(odd, bounce(odd, np.random.default_rng(5), tosses=12, frames=50)), strict=True
    ):
        at = clear_frames(truth, track, odd, result)
        error.append(errors(truth, result)[1][at])
        of_v.append(nees(error[-1], result.v_cov[at]))
    assert np.sqrt((np.concatenate(error)[:, :3] ** 2).mean()) < 0.003
    assert 0.6 < np.concatenate(of_v).mean() < 1.5


def test_an_articulated_object(elbow: ObjectModel) -> None:
    truths, _, results = smoothed(elbow, bounce(elbow, np.random.default_rng(2), tosses=10, frames=100))
    error, honest = [], []
    for truth, result in zip(truths, results, strict=True):
        at = away_from_jumps(truth, 0.1)
        error.append(errors(truth, result)[1][at])
        honest.append(nees(error[-1], result.v_cov[at]))
    rms = np.sqrt((np.concatenate(error) ** 2).mean(axis=0))
    assert (rms[:3] < 0.025).all()
    assert (rms[3:6] < 0.3).all()
    assert 0.2 < np.concatenate(honest).mean() < 1.5
