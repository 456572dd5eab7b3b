"""Frames that are missing in flight are counted, and the die's sides and floor are found where it rests."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.by_hand.die_recording import (
    TURNING,
    Drop,
    flights,
    floor_of,
    halves,
    heights_by_face,
    lost_in_flight,
    rest,
    turned,
    with_true_times,
)
from tests.experiments.by_hand.made_drops import DT, LAW, make_drop

HALF = np.array(LAW.half)


def without(drop: Drop, gone: list[int]) -> Drop:
    """The drop without some frames, as a recorder that lost them would give it."""
    kept = np.setdiff1d(np.arange(len(drop.t)), gone)
    return replace(drop, t=DT * np.arange(len(kept)), x=drop.x[kept], z=drop.z[kept], angle=drop.angle[kept])


def test_frames_lost_in_flight_are_counted_where_they_are_missing(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    for k in range(10):
        drop = make_drop(tmp_path / f"drop_{k}.txt", rng)
        assert not lost_in_flight(drop, HALF).any()
        after = flights(drop, HALF)[1]
        gone = [after.start + 5, after.start + 6, after.start + 11]
        lossy = without(drop, gone)
        lost = lost_in_flight(lossy, HALF)
        assert np.flatnonzero(lost).tolist() == [after.start + 4, after.start + 8]
        assert lost[lost > 0].tolist() == [2, 1]
        kept = np.setdiff1d(np.arange(len(drop.t)), gone)
        np.testing.assert_allclose(with_true_times(lossy, lost).t, drop.t[kept], atol=1e-9)


def test_flights_leave_out_the_impact_also_where_its_frames_are_lost(tmp_path: Path) -> None:
    rng, seen = np.random.default_rng(2), 0
    for k in range(30):
        drop = make_drop(tmp_path / f"drop_{k}.txt", rng, lost=2)
        lowest = int(np.argmin(drop.z[:20]))
        if drop.z[lowest + 1] - drop.z[lowest] > TURNING:
            seen += 1
            assert all(not flight.start <= lowest < flight.stop for flight in flights(drop, HALF))
    assert seen > 10


def test_sides_and_floor_are_those_on_which_the_die_rests(tmp_path: Path) -> None:
    rng, law = np.random.default_rng(3), replace(LAW, floor=5e-4)
    drops = [make_drop(tmp_path / f"drop_{k:02d}.txt", rng, law) for k in range(30)]
    faces = {face for face, _ in filter(None, map(rest, drops))}
    assert faces == {0, 1, 2, 3}
    half = halves(heights_by_face(drops), 0.03)
    np.testing.assert_allclose(half, HALF, atol=2e-5)
    assert [floor_of(drop, half) for drop in drops] == pytest.approx([5e-4] * 30, abs=3e-5)


def test_a_die_that_still_moves_has_no_floor(tmp_path: Path) -> None:
    drop = make_drop(tmp_path / "drop.txt", np.random.default_rng(4))
    moving = replace(drop, x=drop.x + 0.1 * drop.t)
    assert rest(moving) is None
    assert np.isnan(floor_of(moving, HALF))


def test_points_turn_about_y_as_the_quaternion_says() -> None:
    # about y, z turns toward x
    np.testing.assert_allclose(turned(np.pi / 2, np.array([0.0, 1.0])), [1.0, 0.0], atol=1e-12)
