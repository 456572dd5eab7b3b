"""Cuts: windows bear missing frames, and end where there are many or time is uneven."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.cuts import FrameClock, cut_consecutively, cut_flights
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.motion.contact import lowest_corner
from tossid.objects import GRAVITY, ObjectModel
from tossid.physics.effects import World
from tossid.settings.diagnosis.likelihood import WindowSettings
from tossid.types import Toss

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


@pytest.mark.parametrize("missing", [(), (5, 6, 7)])
def test_cuts_follow_each_other_to_the_end(cube: ObjectModel, missing: tuple[int, ...]) -> None:
    toss = seen(World(cube), cube, 1, seed=2, frames=100)[0]
    dt = float(np.median(np.diff(toss.t)))
    there = np.setdiff1d(np.arange(len(toss)), missing)
    toss = Toss(toss.name, *(each[there] for each in (toss.t, toss.q, toss.v, toss.q_cov, toss.v_cov, toss.phase)))
    clock = FrameClock.of(toss, dt, CUT.most_missing + 1, CUT.time_step_tolerance)
    assert (clock.tick[-1], len(clock.breaks)) == (100, 0)
    cuts = cut_consecutively(toss, clock, 0, CUT)
    assert [first for first, _ in cuts[1:]] == [last for _, last in cuts[:-1]]
    assert cuts[0][0] == 0
    assert clock.tick[-1] - clock.tick[cuts[-1][1]] < CUT.length // 2
    flight = cut_flights(toss, clock, cube, CUT)
    assert flight[0][0] == 0
    assert max(clock.tick[last] - clock.tick[first] for first, last in flight) <= CUT.long


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


def test_a_flight_ends_where_the_velocity_jumps(cube: ObjectModel) -> None:
    toss = seen(World(cube), cube, 1, seed=2, frames=20)[0]
    dt = float(np.median(np.diff(toss.t)))
    kicked = toss.q.copy()
    kicked[10:, 0] += 3.0 * (toss.t[10:] - toss.t[9])
    toss = replace(toss, q=kicked)
    clock = FrameClock.of(toss, dt, CUT.most_missing + 1, CUT.time_step_tolerance)
    assert cut_flights(toss, clock, cube, CUT)[0][1] <= 10
