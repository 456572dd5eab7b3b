"""Windows: how tosses are cut, what their rows hold, and that a tracker's slow errors are no residuals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.cuts import FrameClock, cut_flights
from tossid.diagnosis.likelihood.residuals import LARGEST
from tossid.diagnosis.likelihood.slow_errors import inverse_factors, slow_covariance
from tossid.diagnosis.likelihood.states import difference
from tossid.diagnosis.likelihood.whitening import linearise
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.motion.contact import lowest_corner
from tossid.objects import GRAVITY, ObjectModel, corner_positions
from tossid.physics.effects import RecordingErrors, World
from tossid.rotations import quat_exp, quat_mul
from tossid.settings.diagnosis.likelihood import WindowSettings
from tossid.types import Phase, Toss


@pytest.mark.parametrize("raised", [0.0, 0.02])
def test_flights_end_before_the_ground_wherever_it_is(cube: ObjectModel, raised: float) -> None:
    tosses = seen(World(cube, ground_height=raised), cube, 20, seed=0)
    windows = make_windows(tosses, cube)
    assert windows.free.sum() >= 8
    for i in np.flatnonzero(windows.free):
        last = windows.y[i, windows.steps[i] - 1]
        assert corner_positions(cube, last)[:, 2].min() > raised - 1e-3
        assert windows.first[i] == 0  # these do not bounce
    assert not windows.counted[windows.free].any()


def test_rest_is_in_long_windows_whatever_the_noise_of_recorded_velocities(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 6, seed=1, frames=200)
    windows = make_windows(tosses)
    resting = np.flatnonzero(windows.steady & (windows.phase[:, 0] != Phase.FLIGHT))
    assert len(resting) >= 6
    assert (windows.steps[resting] <= WindowSettings().long).all()
    assert (windows.steps[resting] > WindowSettings().length).all()
    for i in resting:
        moved = difference(windows.y[i, : windows.steps[i]], windows.q[i])
        assert (np.abs(moved) < WindowSettings().rest_tolerance * windows.y_noise[i, : windows.steps[i]]).all()
    for k in range(len(tosses)):
        own = windows.steps[windows.toss == k]
        assert 200 - WindowSettings().length // 2 < own.sum() <= 200


def with_slow_errors(tosses: list[Toss], size: tuple[float, float]) -> list[Toss]:
    """Tosses with errors that turn with the object."""
    rng, out = np.random.default_rng(3), []
    for toss in tosses:
        quat = toss.q[:, 3:7]
        alike = np.exp(-2 * (1 - (quat @ quat.T) ** 2) / WindowSettings().attitude_scale ** 2) + 1e-9 * np.eye(
            len(toss)
        )
        error = np.linalg.cholesky(alike) @ rng.normal(size=(len(toss), 6)) * np.repeat(size, 3)
        q = toss.q.copy()
        q[:, :3] += error[:, :3]
        q[:, 3:7] = quat_mul(quat, quat_exp(error[:, 3:]))
        out.append(replace(toss, q=q))
    return out


def test_slow_errors_are_estimated_at_rest_and_do_not_count_as_residuals(cube: ObjectModel) -> None:
    world = World(cube)
    tosses = with_slow_errors(seen(world, cube, 24, seed=1, frames=150), (5e-4, 1e-2))

    def rms(windows: object) -> float:
        kept, whitening, _ = linearise(windows, world, steps=6)  # type: ignore[arg-type]
        r = whitening(kept.residuals(kept.predicted(world)))[kept.inside]
        return float(np.sqrt(np.minimum(r**2, 900.0).mean()))

    known = make_windows(tosses, cube)
    assert known.slow.any()
    there = rms(known)
    unknown = replace(
        known, slow=0 * known.slow, root=make_windows(seen(world, cube, 24, seed=1, frames=150), cube).root
    )
    assert there < 1.6
    assert rms(unknown) > 1.5 * there


def with_missing(tosses: list[Toss], share: float, seed: int) -> list[Toss]:
    """The tosses without some of their frames, at most two in a row."""
    rng, out = np.random.default_rng(seed), []
    for toss in tosses:
        there = rng.uniform(size=len(toss)) > share
        there[::3] = True
        out.append(toss.frames(there))
    return out


def test_missing_frames_are_simulated_and_are_in_no_row(cube: ObjectModel) -> None:
    world = World(cube)
    complete = seen(world, cube, 16, seed=2, frames=120)
    tosses = with_missing(complete, 0.6, seed=0)
    windows = make_windows(tosses, cube)
    assert windows.dt == pytest.approx(float(np.median(np.diff(complete[0].t))))
    assert (windows.steps > windows.present.sum(axis=1)).mean() > 0.9
    for w in range(len(windows.q)):
        toss = tosses[windows.toss[w]]
        ticks = np.rint((toss.t - toss.t[0]) / windows.dt)
        at = np.searchsorted(ticks, windows.first[w] + 1 + np.flatnonzero(windows.present[w]))
        np.testing.assert_array_equal(windows.y[w, windows.present[w]], toss.q[at])
        np.testing.assert_array_equal(ticks[at], windows.first[w] + 1 + np.flatnonzero(windows.present[w]))
    kept, whitening, _ = linearise(windows, world, steps=6)
    r = whitening(kept.residuals(kept.predicted(world)))[kept.inside]
    assert np.sqrt(np.mean(np.minimum(r**2, 9))) == pytest.approx(0.99, abs=0.03)


@pytest.mark.parametrize(
    "far",
    [
        lambda cube: World(cube.resized(1.12)),
        lambda cube: World(cube, recording=RecordingErrors(frame_offset=(0.0, 0.0, -0.02))),
        lambda cube: World(cube, recording=RecordingErrors(length_scale=1.12)),
    ],
)
def test_what_lies_on_the_ground_feels_friction_however_wrong_the_stated_object_is(
    cube: ObjectModel, far: Callable[[ObjectModel], World]
) -> None:
    """At recorded poses the stated object stays millimetres above the ground on which the real one slides."""
    world = far(cube)
    windows = make_windows(seen(world, cube, 8, seed=3), cube)
    slippery = replace(world, object=world.object.with_changes(friction=0.05))
    with_contact = np.flatnonzero((windows.inside & (windows.phase != Phase.FLIGHT)).any(axis=1) & ~windows.free)
    assert len(with_contact) > 8
    change = np.abs(windows.predicted(world) - windows.predicted(slippery)).max(axis=(1, 2))
    assert windows.feels(slippery, world)[change > 1e-9].all()
    assert (change[with_contact] > 1e-3).mean() > 0.5


# ---------------------------------------------------------------- cuts


CUT = WindowSettings()


def test_windows_end_where_many_frames_are_missing_or_time_is_uneven(cube: ObjectModel) -> None:
    toss = seen(World(cube), cube, 1, seed=2, frames=100)[0]
    dt = float(np.median(np.diff(toss.t)))
    for late in (WindowSettings().most_missing + 1, 0.5):
        t = toss.t + np.where(np.arange(len(toss)) >= 50, late * dt, 0.0)
        windows = make_windows([replace(toss, t=t)])
        last = windows.first + windows.steps
        assert not ((windows.first < 49) & (last > 49)).any()
        assert windows.first.max() > 49


def test_flights_after_a_bounce_are_windows_that_hold_no_contact(cube: ObjectModel) -> None:
    bouncing = World(replace(cube, restitution=0.7))
    tosses = seen(bouncing, cube, 6, seed=4, frames=150)
    dt = float(np.median(np.diff(tosses[0].t)))
    later = 0
    for toss in tosses:
        clock = FrameClock.of(toss, dt, CUT.most_missing + 1, CUT.time_step_tolerance)
        for first, last in cut_flights(toss, clock, cube, CUT):
            # gravity alone: the mean of a flight's accelerations is the fall's
            fallen = np.polyfit(toss.t[first : last + 1] - toss.t[first], toss.q[first : last + 1, 2], 2)[0]
            assert fallen == pytest.approx(-0.5 * GRAVITY, abs=0.4)
            assert lowest_corner(cube, toss.q[first : last + 1]).min() > 0
            later += first > 0
            assert last - first >= (CUT.shortest_later_flight if first else 0) or last - first > CUT.long // 2
    assert later >= 4


# ---------------------------------------------------------------- residuals and slow errors


def test_residuals_are_means_of_differences_over_the_frames_of_a_row(cube: ObjectModel) -> None:
    windows = make_windows(seen(World(cube), cube, 6, seed=1, frames=200))
    run = windows.predicted(World(cube, gravity=9.0))
    run[3] = np.nan
    off = difference(windows.y[:, : run.shape[1]], run)
    expected = windows.mix[..., : run.shape[1]] @ np.clip(np.where(np.isfinite(off), off, LARGEST), -LARGEST, LARGEST)
    twice = windows.residuals(np.concatenate([run, run]))
    np.testing.assert_allclose(twice[: len(run)], expected, atol=1e-14)
    np.testing.assert_array_equal(twice[: len(run)], twice[len(run) :])


def test_errors_at_one_attitude_are_one_error_and_those_at_opposite_ones_are_not() -> None:
    turned = quat_exp(np.array([[0.0, 0, 0], [0, 0, 0], [0, 0, 3.0]]))
    mix = np.zeros((1, 3, 2))
    mix[0, 0, 0] = mix[0, 1, 1] = 1.0  # a third row does not exist
    std = np.array([1e-3] * 3 + [2e-2] * 3)
    slow = slow_covariance(turned[:1], turned[None, 1:], mix, std, 1.0)
    assert slow.shape == (1, 6, 4, 4)
    np.testing.assert_allclose(slow[0, :, 0, 1], std**2)
    # over the squared chord between rotations 3 rad apart, 2 sin²(3 / 2)
    np.testing.assert_allclose(slow[0, :, 0, 2], std**2 * np.exp(-2 * np.sin(1.5) ** 2))
    assert not slow[0, :, 3].any()


def test_factors_whiten_slow_errors_and_noise() -> None:
    rng = np.random.default_rng(0)
    half = rng.normal(size=(5, 6, 4, 4))
    slow, noise = half @ half.mT, rng.uniform(0.5, 2.0, (5, 4, 6))
    root = inverse_factors(slow, noise)
    cov = slow + noise.transpose(0, 2, 1)[..., None] ** 2 * np.eye(4)
    np.testing.assert_allclose(root @ cov @ root.mT, np.broadcast_to(np.eye(4), cov.shape), atol=1e-12)
    np.testing.assert_allclose(np.triu(root, 1), 0.0, atol=1e-14)
