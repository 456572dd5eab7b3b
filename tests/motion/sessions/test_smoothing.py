"""What a smoother made is told from what was measured, and nothing innocent is taken for it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from tests.motion.bouncing import bounce
from tossid.motion.sessions.smoothing import WHITE, Smoothing, look_for_smoothing
from tossid.objects import ObjectModel, load_object
from tossid.store.importers import read_contactnets, read_pll, read_tum
from tossid.types import PoseTrack


def over_time(tracks: list[PoseTrack], sigma: float) -> list[PoseTrack]:
    """Positions through a Gaussian filter of so many frames."""
    out = []
    for track in tracks:
        q = track.q.copy()
        q[:, :3] = gaussian_filter1d(q[:, :3], sigma, axis=0, mode="nearest")
        out.append(replace(track, q=q))
    return out


def thinned(tracks: list[PoseTrack], every: int) -> list[PoseTrack]:
    """Every so manieth frame."""
    return [PoseTrack(track.name, track.t[::every], track.q[::every]) for track in tracks]


def test_tosses_with_a_trackers_noise_fall_and_are_rough(tosses: list[PoseTrack], cube: ObjectModel) -> None:
    for every, n_falls in ((1, 40), (5, 40)):
        seen = look_for_smoothing(thinned(tosses, every), cube)
        assert seen.falls
        assert not seen.smoothed
        assert (seen.n_falls, seen.fall_error < 0.5) == (n_falls, True)
    assert look_for_smoothing(tosses, cube).roughness == pytest.approx(WHITE, abs=0.15)


def test_what_a_smoother_made_is_told_at_any_rate(tosses: list[PoseTrack], cube: ObjectModel) -> None:
    """A filter over 0.1 s bends flights, which last 0.25 s, into contact."""
    for every, sigma in ((1, 15.0), (5, 3.0)):
        seen = look_for_smoothing(over_time(thinned(tosses, every), sigma), cube)
        assert not seen.falls
        assert seen.smoothed
        assert seen.roughness < 0.8


def test_a_light_filter_that_leaves_flights_alone_is_no_reason(tosses: list[PoseTrack], cube: ObjectModel) -> None:
    seen = look_for_smoothing(over_time(tosses, 2.0), cube)
    assert seen.roughness < 1.0
    assert (seen.falls, seen.smoothed) == (True, False)


@pytest.mark.parametrize("gravity", [3.7, 9.81])
def test_simulated_tosses_without_noise_are_not_taken_for_smoothed(cube: ObjectModel, gravity: float) -> None:
    """Not under another gravity than is stated either: then they do not fall by that one, and that is all."""
    for rate in (30, 100, 500):
        times = np.round(np.arange(rate) / rate / 5e-4) * 5e-4
        truths = bounce(cube, np.random.default_rng(1), tosses=6, frames=rate, times=times, gravity=gravity)
        seen = look_for_smoothing([PoseTrack(str(i), one.t, one.q) for i, one in enumerate(truths)], cube)
        assert (seen.falls, seen.smoothed) == (gravity == 9.81, False)
        assert seen.fall_error == pytest.approx(9.81 - gravity, abs=1e-6)


def test_an_object_that_is_only_pushed_is_not_judged(cube: ObjectModel) -> None:
    """It comes down nowhere; with a filter on top it is still nothing that must fall."""
    t = np.arange(100) / 100
    q = np.zeros((100, 7))
    q[:, 3], q[:, 0] = 1.0, 0.3 * np.sin(3 * t)
    seen = look_for_smoothing([PoseTrack(str(i), t, q.copy()) for i in range(5)], cube)
    assert (seen.n_falls, seen.falls, seen.smoothed) == (0, True, False)
    assert np.isnan(seen.fall_error)


def test_a_single_toss_is_too_little(tosses: list[PoseTrack], cube: ObjectModel) -> None:
    assert look_for_smoothing(over_time(tosses[:1], 15.0), cube).falls
    assert not look_for_smoothing(over_time(tosses[:2], 15.0), cube).falls


def test_tosses_of_few_frames_are_no_failure(tosses: list[PoseTrack], cube: ObjectModel) -> None:
    short = [PoseTrack(track.name, track.t[:n], track.q[:n]) for track in tosses[:3] for n in (2, 3, 4)]
    seen = look_for_smoothing(short, cube)
    assert (seen.n_falls, seen.falls) == (0, True)


def test_published_recordings(shared_data: Path, cube: ObjectModel) -> None:
    """All that were measured pass; the milk carton and the egg do not, all of them or a few."""
    smoothed, die = shared_data / "smoothed_30hz", shared_data / "mit_die"
    measured: dict[str, Smoothing] = {
        "cube": look_for_smoothing(read_contactnets(shared_data / "contactnets_cube"), cube),
        "elbow": look_for_smoothing(read_pll(shared_data / "pll_elbow", n_joints=1), load_object("elbow")),
        "die": look_for_smoothing(read_tum(die / "measured", n_joints=0), load_object(die / "die.xml")),
        "basketball": look_for_smoothing(read_tum(shared_data / "basketball", n_joints=0), cube),
    }
    for seen in measured.values():
        assert seen.fall_error < 0.6
        assert seen.n_falls >= 12
        assert not seen.roughness < 1.5  # the basketball has too few frames in a row
        assert (seen.falls, seen.smoothed) == (True, False)
    for name in ("milk", "egg"):
        tracks = read_tum(smoothed / name, n_joints=0)
        for some in (tracks, [tracks[i] for i in range(1, 10, 2)]):
            seen = look_for_smoothing(some, cube)
            assert seen.fall_error > 1.5
            assert seen.roughness < 0.8
            assert seen.smoothed
