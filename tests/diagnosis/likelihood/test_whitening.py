"""First states are found from the windows' own frames, with derivatives and covariances that are right."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.engine_discrepancy import EngineDifference
from tossid.diagnosis.likelihood.whitening import first_frames, linearise, relinearise
from tossid.diagnosis.likelihood.windows import Windows, make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import Forces, RecordingErrors, World
from tossid.settings.diagnosis.likelihood import LikelihoodSettings, WindowSettings


@pytest.fixture(scope="module")
def windows(cube: ObjectModel) -> Windows:
    return make_windows(seen(World(cube), cube, 6, seed=1), cube)


def test_refined_first_states_fit_the_frames_better(cube: ObjectModel, windows: Windows) -> None:
    world, free = World(cube), np.flatnonzero(windows.free)
    kept, whitening, after = linearise(windows, world, steps=6)
    before = windows.residuals(windows.predicted(world))
    np.testing.assert_array_equal(after, kept.residuals(kept.predicted(world)))
    rms = [np.sqrt((r[free] ** 2).mean(axis=(0, 1))) for r in (before, after)]
    # recorded velocities are off by 3 cm/s, which moves a flight far beyond its noise
    assert (rms[1][:3] < 0.2 * rms[0][:3]).all()
    assert np.sqrt((whitening(after)[free] ** 2).mean()) < 1.2


def test_factors_whiten_the_covariance_of_the_model(cube: ObjectModel, windows: Windows) -> None:
    """In flight, with and without slow errors: W (R + S P S^T + c c^T) W^T = 1, and W is lower triangular in time."""
    windows = windows.rows(np.flatnonzero(windows.free))
    W, K, rows = windows.slow.shape[:3]
    L = rows - 1
    rng = np.random.default_rng(0)
    alike = np.exp(-(((np.arange(rows)[:, None] - np.arange(rows)) / 8.0) ** 2))
    exists = np.concatenate([np.ones((W, 1), bool), windows.inside], axis=1)
    alike = alike * exists[:, None, :, None] * exists[:, None, None, :]
    size = np.repeat([2e-4, 4e-3], 3)[:, None, None]
    noise = np.concatenate([windows.prior[:, None, :K], windows.noise], axis=1).transpose(0, 2, 1)
    for slow in (0 * windows.slow, size**2 * alike):
        own = slow + noise[..., None] ** 2 * np.eye(rows)
        known = replace(windows, slow=slow, root=np.linalg.inv(np.linalg.cholesky(own)))
        other = 1e-3 * rng.normal(size=(W, L, K)) * known.inside[..., None]
        engine = EngineDifference(other, 0.0)
        kept, whitening, _ = linearise(known, World(cube), steps=0, difference=engine)
        basis = np.eye(K * L).reshape(K * L, 1, L, K) + whitening.mean.reshape(W, L, K)
        factor = np.stack([whitening(each).reshape(W, K * L) for each in basis], axis=2)
        # residuals are rows' own errors, less what the first pose's and velocity's errors move, and the other engine's
        S = whitening.by_state
        into = np.concatenate([-S[..., :K], S[..., K:] * kept.prior[:, None, K:], other.reshape(W, -1, 1)], axis=2)
        cov = np.zeros((W, K * L, K * L))
        for c in range(K):
            cov[:, c::K, c::K] += own[:, c, 1:, 1:]
            shared = np.zeros_like(cov)
            shared[:, :, c::K] = into[:, :, None, c] * own[:, c, None, 0, 1:]
            cov += shared + shared.mT + own[:, c, 0, 0, None, None] * into[:, :, None, c] * into[:, None, :, c]
        cov += into[..., K:] @ into[..., K:].mT
        white = factor @ cov @ factor.mT
        np.testing.assert_allclose(white, np.broadcast_to(np.eye(white.shape[1]), white.shape), atol=1e-6)
        np.testing.assert_allclose(whitening.log_det, -0.5 * np.linalg.slogdet(cov)[1], rtol=1e-9)
        assert not np.triu(factor, 1).any()


def test_what_has_not_changed_is_not_computed_again(cube: ObjectModel, windows: Windows) -> None:
    kept, whitening, residuals = linearise(windows, World(cube), steps=6)
    again, same, _ = relinearise(kept, World(cube), whitening, steps=0, residuals=residuals)
    np.testing.assert_array_equal(again.at_v, kept.at_v)
    moved = (same.taken_at != whitening.taken_at).any(axis=1)
    assert moved.mean() < 0.2
    np.testing.assert_array_equal(same.gain[~moved], whitening.gain[~moved])


def test_poses_with_zero_covariance_are_whitened(cube: ObjectModel) -> None:
    """Simulated tosses without noise have no covariance."""
    tosses = [replace(toss, q_cov=np.zeros_like(toss.q_cov)) for toss in seen(World(cube), cube, 6, seed=1)]
    for length in (5, 40):
        settings = LikelihoodSettings(windows=WindowSettings(length=length))
        _, whitening, residuals = linearise(make_windows(tosses, cube, settings=settings), World(cube))
        assert np.isfinite(whitening(residuals)).all()


WORLDS: dict[str, dict[str, Any]] = {
    "plain": {},
    "scaled": {"recording": RecordingErrors(length_scale=1.1, clock_rate=0.9, frame_offset=(0.004, -0.003, 0.002))},
    "wind": {"forces": Forces(quadratic=0.05, wind_x=2.0, magnus=1e-3, turning=0.4)},
    "spring": {"forces": Forces(spring=0.6, center_x=0.3)},
    "vortex": {"forces": Forces(vortex=0.6)},
    "tilt": {"ground_tilt": (0.05, -0.1)},
    "tilted frame": {"recording": RecordingErrors(world_tilt=(0.05, -0.1))},
}


@pytest.mark.parametrize("name", WORLDS)
def test_derivatives_by_the_first_position_are_those_of_a_shifted_motion(cube: ObjectModel, name: str) -> None:
    world, step = World(cube, **WORLDS[name]), 2e-4
    windows = make_windows(seen(world, cube, 8, seed=1))
    _, whitening, _ = linearise(windows, world, steps=0)
    for k in range(2):
        moved = windows.q + step * np.eye(7)[k]
        change = windows.residuals(windows.predicted(world)) - windows.residuals(
            windows.predicted(world, moved, windows.v)
        )
        error = np.abs(whitening.by_state[..., k] - change.reshape(len(change), -1) / step).max(axis=1)
        # where a contact has more than one solution to its tolerance, differences have that error
        assert np.median(error) < 1e-9
        assert np.quantile(error, 0.9) < 1e-3


class _NearlyDerived(World):
    """A world whose derivatives are said to be nearly those of one without gravity or friction, which they are not."""

    @property
    def by_first_states(self) -> World:
        return World(self.object.with_changes(friction=0.0), gravity=0.0)


def test_restarts_use_the_derivatives_of_the_world_itself(cube: ObjectModel) -> None:
    """First states that impacts have thrown far off are not found again by nearly right derivatives."""
    windows = make_windows(seen(World(cube), cube, 8, seed=1), cube)
    lost = replace(windows, at_v=windows.at_v + np.array([0.5, -0.5, 0.5, 4.0, -4.0, 4.0]))

    def found(world: World, restarts: int) -> float:
        """Share of windows that fit as a right model does."""
        kept, whitening, residuals = linearise(lost, world, steps=0, restarts=restarts)
        n = 6 * kept.inside.sum(1)
        return float(((whitening(residuals) ** 2).sum((1, 2)) < n + 3 * np.sqrt(2 * n)).mean())

    assert found(_NearlyDerived(cube), 0) < 0.1
    assert found(_NearlyDerived(cube), 1) > 0.9
    assert found(_NearlyDerived(cube), 1) == found(World(cube), 1)


def with_contact(cube: ObjectModel, count: int, seed: int) -> Windows:
    windows = make_windows(seen(World(cube), cube, count, seed=seed, frames=70), cube)
    return windows.rows(np.flatnonzero(~windows.steady))


def test_only_first_frames_are_left(cube: ObjectModel) -> None:
    windows = with_contact(cube, 6, 2)
    part = first_frames(windows, 0.4)
    before = windows.inside.sum(1)
    np.testing.assert_array_equal(part.inside.sum(1), np.ceil(0.4 * before))
    np.testing.assert_array_equal(part.steps, part.inside.sum(1))
    residuals = part.residuals(part.predicted(World(cube)))
    assert (residuals[~part.inside] == 0.0).all()
    whole = windows.residuals(windows.predicted(World(cube)))
    np.testing.assert_allclose(residuals[part.inside], whole[part.inside], atol=1e-12)


def test_a_restart_follows_first_states_from_first_frames(cube: ObjectModel) -> None:
    """Recorded velocities are far off; over all frames at once, most fits end in other impacts than those seen."""
    world, noise = World(cube), np.random.default_rng(0)
    count, poor = 0, np.zeros(2, dtype=int)
    for seed in (3, 4, 5):
        windows = with_contact(cube, 12, seed)
        off = noise.normal(size=windows.v.shape) * np.array([0.15] * 3 + [2.0] * 3)
        lost = replace(windows, v=windows.v + off, at_v=windows.v + off)
        count += len(windows.q)
        for restarts in (0, 1):
            kept, whitening, residuals = linearise(lost, world, steps=6, restarts=restarts)
            n = 6 * kept.inside.sum(1)
            poor[restarts] += ((whitening(residuals) ** 2).sum((1, 2)) > n + 3 * np.sqrt(2 * n)).sum()
    at_once, followed = poor
    assert at_once > 0.07 * count
    assert followed < 0.4 * at_once
