"""Windows: first flights end before anything is hit, and slow errors of a tracker are no misses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tests.models.conftest import cube
from tossid.diagnosis.misses import LOST
from tossid.diagnosis.whitening import linearise
from tossid.diagnosis.windows import LENGTH, LONG, STILL, TURN, difference, make_windows
from tossid.objects import ObjectModel, corner_positions
from tossid.physics.effects import Forces, Recording, World
from tossid.rotations import quat_exp, quat_mul
from tossid.types import Phase, Toss

__all__ = ["cube"]


@pytest.mark.parametrize("raised", [0.0, 0.02])
def test_first_flights_end_before_the_ground_wherever_it_is(cube: ObjectModel, raised: float) -> None:
    tosses = seen(World(cube, ground_height=raised), cube, 20, seed=0)
    windows = make_windows(tosses, cube)
    assert windows.free.sum() >= 8
    for i in np.flatnonzero(windows.free):
        last = windows.y[i, windows.steps[i] - 1]
        assert corner_positions(cube, last)[:, 2].min() > raised - 1e-3
        assert windows.frame[i, 0] == 1
    assert not windows.counted[windows.free].any()


def test_rest_is_in_long_windows_whatever_the_noise_of_recorded_velocities(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 6, seed=1, frames=200)
    windows = make_windows(tosses)
    resting = np.flatnonzero(windows.steady & (windows.phase[:, 0] != Phase.FLIGHT))
    assert len(resting) >= 6
    assert (windows.steps[resting] <= LONG).all()
    assert (windows.steps[resting] > LENGTH).all()
    for i in resting:
        moved = difference(windows.y[i, : windows.steps[i]], windows.q[i])
        assert (np.abs(moved) < STILL * windows.y_noise[i, : windows.steps[i]]).all()
    for k in range(len(tosses)):
        own = windows.steps[windows.toss == k]
        assert 200 - LENGTH // 2 < own.sum() <= 200


def with_slow_errors(tosses: list[Toss], size: tuple[float, float]) -> list[Toss]:
    """Tosses with errors that turn with the object."""
    rng, out = np.random.default_rng(3), []
    for toss in tosses:
        quat = toss.q[:, 3:7]
        alike = np.exp(-2 * (1 - (quat @ quat.T) ** 2) / TURN**2) + 1e-9 * np.eye(len(toss))
        error = np.linalg.cholesky(alike) @ rng.normal(size=(len(toss), 6)) * np.repeat(size, 3)
        q = toss.q.copy()
        q[:, :3] += error[:, :3]
        q[:, 3:7] = quat_mul(quat, quat_exp(error[:, 3:]))
        out.append(replace(toss, q=q))
    return out


def test_slow_errors_are_known_from_rest_and_are_no_misses(cube: ObjectModel) -> None:
    world = World(cube)
    tosses = with_slow_errors(seen(world, cube, 24, seed=1, frames=150), (5e-4, 1e-2))

    def rms(windows: object) -> float:
        kept, whitening = linearise(windows, world, refine=6)  # type: ignore[arg-type]
        r = whitening(kept.misses(kept.predicted(world)))[kept.inside]
        return float(np.sqrt(np.minimum(r**2, 900.0).mean()))

    known = make_windows(tosses, cube)
    assert known.slow.any()
    there = rms(known)
    unknown = replace(
        known, slow=0 * known.slow, root=make_windows(seen(world, cube, 24, seed=1, frames=150), cube).root
    )
    assert there < 1.6
    assert rms(unknown) > 1.5 * there


def test_poses_said_to_be_exact_are_whitened(cube: ObjectModel) -> None:
    """Simulated tosses without noise have no covariance."""
    tosses = [replace(toss, q_cov=np.zeros_like(toss.q_cov)) for toss in seen(World(cube), cube, 6, seed=1)]
    for length in (5, 40):
        windows, whitening = linearise(make_windows(tosses, cube, length=length), World(cube))
        assert np.isfinite(whitening(windows.misses(windows.predicted(World(cube))))).all()


def test_misses_are_means_of_differences_over_the_frames_of_a_row(cube: ObjectModel) -> None:
    windows = make_windows(seen(World(cube), cube, 6, seed=1, frames=200))
    run = windows.predicted(World(cube, gravity=9.0))
    run[3] = np.nan
    off = difference(windows.y[:, : run.shape[1]], run)
    expected = windows.mix[..., : run.shape[1]] @ np.clip(np.where(np.isfinite(off), off, LOST), -LOST, LOST)
    twice = windows.misses(np.concatenate([run, run]))
    np.testing.assert_allclose(twice[: len(run)], expected, atol=1e-14)
    np.testing.assert_array_equal(twice[: len(run)], twice[len(run) :])


WORLDS: dict[str, dict[str, Any]] = {
    "plain": {},
    "scaled": {"recording": Recording(length_scale=1.1, clock_rate=0.9, frame_offset=(0.004, -0.003, 0.002))},
    "wind": {"forces": Forces(quadratic=0.05, wind_x=2.0, magnus=1e-3, turning=0.4)},
    "spring": {"forces": Forces(spring=0.6, center_x=0.3)},
    "vortex": {"forces": Forces(vortex=0.6)},
    "tilt": {"ground_tilt": (0.05, -0.1)},
    "tilted frame": {"recording": Recording(world_tilt=(0.05, -0.1))},
}


@pytest.mark.parametrize("name", WORLDS)
def test_derivatives_by_the_first_place_are_those_of_a_motion_moved_along(cube: ObjectModel, name: str) -> None:
    world, step = World(cube, **WORLDS[name]), 2e-4
    windows = make_windows(seen(world, cube, 8, seed=1))
    _, whitening = linearise(windows, world, refine=0)
    for k in range(2):
        moved = windows.q + step * np.eye(7)[k]
        change = windows.misses(windows.predicted(world)) - windows.misses(windows.predicted(world, moved, windows.v))
        error = np.abs(whitening.by_state[..., k] - change.reshape(len(change), -1) / step).max(axis=1)
        # where a contact has more than one solution to its tolerance, differences have that error
        assert np.median(error) < 1e-9
        assert np.quantile(error, 0.9) < 1e-3
