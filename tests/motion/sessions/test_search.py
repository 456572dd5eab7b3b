"""Sessions of recordings whose world was tilted at a known toss, and of published ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tossid.motion.sessions.change_points import find_changes
from tossid.motion.sessions.levelling import levelled_tracks, turned_track
from tossid.motion.sessions.search import find_sessions, recording_order, session_words, with_covariates
from tossid.motion.sessions.witnesses import toss_witnesses
from tossid.objects import ObjectModel, corner_positions, load_object
from tossid.rotations import quat_exp
from tossid.store.importers import read_contactnets, read_pll, read_tum
from tossid.types import PoseTrack

TILT = np.deg2rad([1.2, -0.8])
"""Of the table's normal, x and y."""


def tilted(tracks: list[PoseTrack], first: int, stop: int, *, height: float = 0.0) -> list[PoseTrack]:
    """With tosses first to stop in a recorded world whose vertical leans by TILT."""
    turn = quat_exp(np.array([-TILT[1], TILT[0], 0.0]))  # takes z to (TILT, 1)
    return [turned_track(t, turn, height) if first <= i < stop else t for i, t in enumerate(tracks)]


def test_a_tilt_that_begins_at_a_toss_is_found_and_undone(tosses: list[PoseTrack], cube: ObjectModel) -> None:
    recorded = tilted(tosses, 0, 17, height=0.004)
    found = find_sessions(recorded, cube)
    first, second = found.sessions
    assert abs(first.n_tosses - 17) <= 3
    assert set(second.changed) & {"fall", "normal", "slope"}
    assert first.level is not None
    assert second.level is not None
    assert np.rad2deg(first.level) == pytest.approx(np.rad2deg(TILT), abs=0.2)
    assert np.rad2deg(second.level) == pytest.approx([0, 0], abs=0.2)
    assert (first.levelled, second.levelled) == (True, False)
    levelled = levelled_tracks(recorded, found)
    ends = [corner_positions(cube, track.q[-1])[:, 2].min() for track in levelled]
    assert np.median(ends[:14]) == pytest.approx(np.median(ends[20:]), abs=0.001)
    after = find_sessions(levelled, cube)
    assert len(after.sessions) == 1
    assert all("levelled" in session_words(s) or "left" in session_words(s) for s in found.sessions)


def test_level_never_only_looks_and_level_session_levels_one_session_too(
    tosses: list[PoseTrack], cube: ObjectModel
) -> None:
    half = tilted(tosses, 0, 20)
    looked = find_sessions(half, cube, level="never")
    assert len(looked.sessions) == 2
    assert levelled_tracks(half, looked) is half
    whole = tilted(tosses, 0, 40)
    kept = find_sessions(whole, cube)
    assert len(kept.sessions) == 1
    assert levelled_tracks(whole, kept) is whole
    (session,) = find_sessions(whole, cube, level="session").sessions
    assert session.levelled
    assert session.level is not None
    assert np.rad2deg(session.level) == pytest.approx(np.rad2deg(TILT), abs=0.2)


def test_no_sessions_in_tosses_that_do_not_change(tosses: list[PoseTrack], cube: ObjectModel) -> None:
    found = find_sessions(tosses, cube, level="session")
    assert len(found.sessions) == 1
    assert not found.sessions[0].levelled
    assert levelled_tracks(tosses, found) is tosses


def test_heights_shifted_toss_by_toss_are_recognised(tosses: list[PoseTrack], cube: ObjectModel) -> None:
    recorded = tilted(tosses, 0, 20)
    shifted = [lowered(track, corner_positions(cube, track.q[-1])[:, 2].min()) for track in recorded]
    found = find_sessions(shifted, cube)
    assert any("lowest corner is at 0; raised" in note for note in found.notes)
    levelled = levelled_tracks(shifted, found)
    truth = [corner_positions(cube, track.q[-1])[:, 2].mean() for track in tosses]
    ends = [corner_positions(cube, track.q[-1])[:, 2].mean() for track in levelled]
    assert np.median(np.abs(np.array(ends) - truth)) < 0.001
    assert any("left so" in note for note in find_sessions(shifted, cube, level="never").notes)
    assert not find_sessions(recorded, cube).notes


def lowered(track: PoseTrack, by: float) -> PoseTrack:
    q = track.q.copy()
    q[:, 2] -= by
    return replace(track, q=q)


def test_too_few_tosses_say_how_many_it_takes(tosses: list[PoseTrack], cube: ObjectModel) -> None:
    found = find_sessions(tilted(tosses[:8], 0, 4), cube)
    assert len(found.sessions) == 1
    assert "8 tosses are too few" in found.notes[0]
    assert "it takes 1" in found.notes[0]


def test_a_session_with_neither_rest_nor_contact_is_not_levelled(tosses: list[PoseTrack], cube: ObjectModel) -> None:
    flights = [track.frames(slice(24)) for track in tilted(tosses, 0, 40)]
    (session,) = find_sessions(flights, cube, level="session").sessions
    assert session.level is None
    assert not session.levelled
    assert "rest on a face" in session_words(session)
    assert "not decided" in session_words(session)


def test_the_order_is_that_of_times_and_contradictions_are_said(tosses: list[PoseTrack]) -> None:
    def at(track: PoseTrack, start: float) -> PoseTrack:
        return replace(track, t=track.t + start)

    assert recording_order(tosses[:3])[1:] == ("names", ())
    order, by, notes = recording_order([at(tosses[0], 20), at(tosses[1], 10), at(tosses[2], 30)])
    assert (order.tolist(), by) == ([1, 0, 2], "times")
    assert "contradict" in notes[0]
    assert "toss 1 comes before 0" in notes[0]
    overlapping = recording_order([at(tosses[0], 0), at(tosses[1], 0.3), at(tosses[2], 5)])
    assert overlapping[1] == "names"
    assert "overlap" in overlapping[2][0]


def test_the_published_elbow_was_recorded_in_two_sessions(shared_data: Path, elbow: ObjectModel) -> None:
    tracks = list(read_pll(shared_data / "pll_elbow", n_joints=1))
    found = find_sessions(tracks, elbow)
    first, second = found.sessions
    assert int(first.last) >= 320 - 3
    assert int(second.first) <= 323 + 3
    assert first.level is not None
    assert np.rad2deg(np.hypot(*first.level)) == pytest.approx(2.35, abs=0.2)
    assert first.levelled
    assert not second.levelled
    seen = with_covariates(toss_witnesses(tracks, elbow))
    rng, false = np.random.default_rng(0), 0
    for _ in range(12):
        shuffled = rng.permutation(len(tracks))
        false += bool(find_changes({name: (y[shuffled], A[shuffled], x[shuffled]) for name, (y, A, x) in seen.items()}))
    assert false == 0


def test_the_published_cube_was_recorded_in_one_session(shared_data: Path, cube: ObjectModel) -> None:
    tracks = list(read_contactnets(shared_data / "contactnets_cube"))
    found = find_sessions(tracks, cube, level="session")
    assert len(found.sessions) == 1
    assert not found.sessions[0].levelled
    assert levelled_tracks(tracks, found) is tracks


def test_witnesses_that_contradict_each_other_decide_nothing(shared_data: Path) -> None:
    # the die's body frame is turned by 1.9 degrees: its faces say what the floor and the fall do not
    die = load_object(shared_data / "mit_die" / "die.xml")
    found = find_sessions(list(read_tum(shared_data / "mit_die" / "measured", n_joints=0)), die, level="session")
    assert not any(session.levelled for session in found.sessions)
