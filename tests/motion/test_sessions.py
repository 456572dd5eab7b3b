"""Sessions: changes over an order, the tilt of worlds, and turning tracks into the level world and back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tossid.motion.sessions import as_recorded, find_sessions, levelled_tracks, session_words
from tossid.motion.sessions.change_points import Sequence, find_changes
from tossid.motion.sessions.levelling import recordings_apart, turned_track, upright
from tossid.motion.sessions.search import recording_order
from tossid.motion.tosses import tosses_from_tracks
from tossid.objects import ObjectModel, corner_positions, load_object
from tossid.rotations import quat_conj, quat_exp, quat_rotate, quat_to_matrix
from tossid.store.importers import read_contactnets, read_pll, read_tum
from tossid.types import PoseTrack, RecordingOrder, Session

TILT = np.deg2rad([1.2, -0.8])
"""Of the table's normal, x and y."""
TURN = quat_exp(np.array([-TILT[1], TILT[0], 0.0]))
"""Takes z to (TILT, 1)."""

# changes over an order


def items(values: np.ndarray, *, places: np.ndarray | None = None) -> Sequence:
    n = len(values)
    return Sequence(values, np.ones(n), np.zeros((n, 2)) if places is None else places)


def test_shifts_are_found_where_they_are() -> None:
    near = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        values = rng.normal(size=(60, 2))
        at = int(rng.integers(12, 48))
        values[at:] += [2.0, 1.0]  # two standard deviations
        changes = find_changes({"tilt": items(values), "noise": items(rng.normal(size=(60, 1)))})
        near += [abs(change.at - at) <= 3 for change in changes] == [True]
    assert near >= 19
    values = np.random.default_rng(3).normal(size=(90, 1))
    values[30:60] += 3
    assert [change.at for change in find_changes({"height": items(values)})] == pytest.approx([30, 60], abs=2)


@pytest.mark.parametrize("draw", ["normal", "heavy tails", "few values"])
def test_no_change_is_found_in_an_order_that_means_nothing(draw: str) -> None:
    found = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        values = {
            "normal": rng.normal(size=(50, 2)),
            "heavy tails": rng.standard_t(1.2, size=(50, 2)),
            "few values": (rng.random(size=(50, 1)) < 0.1).astype(float),
        }[draw]
        found += bool(find_changes({"a": items(values), "b": items(rng.normal(size=(50, 1)))}))
    assert found <= 1


def test_what_place_explains_is_no_change() -> None:
    rng = np.random.default_rng(5)
    places = rng.normal(size=(80, 2))
    places[:20, 0] += 3  # the first tosses land elsewhere
    values = places @ np.array([[1.0, 0.2], [0.3, -1.0]]) + 0.1 * rng.normal(size=(80, 2))
    assert not find_changes({"normal": items(values, places=places)})
    assert find_changes({"normal": items(values)})


def test_items_that_say_nothing_are_passed_over_and_unsure_ones_are_not_outweighed() -> None:
    some = items(np.random.default_rng(7).normal(size=(60, 1)))
    some.values[30:] += 4
    some.values[::3], some.info[::3] = np.nan, 0
    (change,) = find_changes({"fall": some})
    assert abs(change.at - 30) <= 3
    rng = np.random.default_rng(11)
    some = items(rng.normal(size=(40, 1)))
    some.values[32:] = -100 + 10 * rng.normal(size=(8, 1))
    some.info[32:] /= 10**2
    assert [change.at for change in find_changes({"height": some})] == [32]


# levelling


def test_turning_back_gives_the_track_and_keeps_distances(cube_tracks: list[PoseTrack]) -> None:
    track = cube_tracks[0]
    turned = turned_track(track, TURN, 0.0)
    np.testing.assert_allclose(turned_track(turned, quat_conj(TURN), 0.0).q, track.q, atol=1e-12)
    np.testing.assert_allclose(turned.q[0, :3], quat_rotate(TURN, track.q[0, :3]), atol=1e-12)
    assert turned_track(track, TURN, 0.25).q[:, 2] == pytest.approx(turned.q[:, 2] + 0.25)
    np.testing.assert_allclose(np.linalg.eigvalsh(turned.q_cov), np.linalg.eigvalsh(track.q_cov), atol=1e-15)


@pytest.mark.parametrize("up", [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, 0.8], [0.0, 1.0, 0.0]])
def test_upright_is_the_shortest_turn_to_z(up: list[float]) -> None:
    turn = upright(np.array(up))
    np.testing.assert_allclose(quat_to_matrix(turn) @ up, [0, 0, 1], atol=1e-12)
    assert 2 * np.arccos(np.clip(turn[0], -1, 1)) == pytest.approx(np.arccos(up[2]), abs=1e-7)


def order_of(*sessions: Session) -> RecordingOrder:
    """An order of recording of one toss a session, whose tosses say nothing."""
    n = len(sessions)
    names, turn = tuple(session.first for session in sessions), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    return RecordingOrder(
        sessions, "names", names, (), np.zeros((n, 0)), np.zeros((n, 2)), turn, np.zeros(n), np.arange(n)
    )


LEVEL = Session("10", "29", 20, (0.001, 0.0), (0.0005, 0.0005))


def test_sessions_in_worlds_that_are_tilted_against_each_other_are_said() -> None:
    tilted = Session("0", "9", 10, (0.03, -0.03), (0.001, 0.001))
    words = "Two recordings: tosses 0 to 9 stand in a world tilted by 2.39° ± 0.06° against that of tosses 10 to 29."
    assert recordings_apart(order_of(tilted, LEVEL)) == recordings_apart(order_of(LEVEL, tilted)) == words
    third = Session("30", "39", 10, (0.0, 0.05), (0.001, 0.001))
    assert (recordings_apart(order_of(tilted, LEVEL, third)) or "").startswith("Three recordings: tosses 0 to 9")
    for level, sigma, levelled in (
        ((0.03, -0.03), (0.001, 0.001), True),
        ((0.03, -0.03), (0.02, 0.02), False),
        ((0.003, 0.0), (0.0001, 0.0001), False),
        (None, None, False),
    ):
        assert recordings_apart(order_of(Session("0", "9", 10, level, sigma, levelled=levelled), LEVEL)) is None


# sessions


def tilted(tracks: list[PoseTrack], stop: int, *, height: float = 0.0) -> list[PoseTrack]:
    """With the first tosses in a recorded world whose vertical leans by TILT."""
    return [turned_track(track, TURN, height) if i < stop else track for i, track in enumerate(tracks)]


def ends(tracks, cube: ObjectModel) -> np.ndarray:
    return np.array([corner_positions(cube, track.q[-1])[:, 2].min() for track in tracks])


def test_a_tilt_that_ends_at_a_toss_is_found_and_undone_and_can_be_had_as_recorded(
    cube_tracks: list[PoseTrack], cube: ObjectModel
) -> None:
    recorded = tilted(cube_tracks, 17, height=0.004)
    found = find_sessions(recorded, cube)
    first, second = found.sessions
    assert abs(first.n_tosses - 17) <= 3
    assert set(second.changed) & {"fall", "normal"}
    assert np.rad2deg(first.level) == pytest.approx(np.rad2deg(TILT), abs=0.2)
    assert np.rad2deg(second.level) == pytest.approx([0, 0], abs=0.2)
    assert (first.levelled, second.levelled) == (True, False)
    assert all("levelled" in session_words(s) or "left" in session_words(s) for s in found.sessions)
    levelled = levelled_tracks(recorded, found)
    low = ends(levelled, cube)
    assert np.median(low[:14]) == pytest.approx(np.median(low[20:]), abs=0.001)
    assert len(find_sessions(levelled, cube).sessions) == 1
    made = tosses_from_tracks(levelled, cube)[3]
    assert np.abs(made.measured[0] - recorded[3].q).max() > 1e-3
    back, _ = as_recorded(made, found).measured
    np.testing.assert_allclose(back[:, :3], recorded[3].q[:, :3], atol=1e-12)
    np.testing.assert_allclose(np.abs(np.sum(back[:, 3:7] * recorded[3].q[:, 3:7], axis=1)), 1, atol=1e-12)


def test_level_never_only_looks_and_level_session_levels_one_session_too(
    cube_tracks: list[PoseTrack], cube: ObjectModel
) -> None:
    half, whole = tilted(cube_tracks, 20), tilted(cube_tracks, 40)
    looked = find_sessions(half, cube, level="never")
    assert len(looked.sessions) == 2
    assert levelled_tracks(half, looked) is half
    kept = find_sessions(whole, cube)
    assert len(kept.sessions) == 1
    assert levelled_tracks(whole, kept) is whole
    (session,) = find_sessions(whole, cube, level="session").sessions
    assert session.levelled
    assert np.rad2deg(session.level) == pytest.approx(np.rad2deg(TILT), abs=0.2)
    (session,) = find_sessions(cube_tracks, cube, level="session").sessions
    assert not session.levelled


def test_heights_shifted_toss_by_toss_are_recognised(cube_tracks: list[PoseTrack], cube: ObjectModel) -> None:
    recorded = tilted(cube_tracks, 20)
    low = ends(recorded, cube)
    shifted = [turned_track(track, np.array([1.0, 0, 0, 0]), -z) for track, z in zip(recorded, low, strict=True)]
    found = find_sessions(shifted, cube)
    assert any("lowest corner is at 0; raised" in note for note in found.notes)
    levelled = levelled_tracks(shifted, found)
    truth, raised = (
        np.array([corner_positions(cube, track.q[-1])[:, 2].mean() for track in tracks])
        for tracks in (cube_tracks, levelled)
    )
    assert np.median(np.abs(raised - truth)) < 0.001
    assert any("left so" in note for note in find_sessions(shifted, cube, level="never").notes)
    assert not find_sessions(recorded, cube).notes


def test_too_few_tosses_or_flights_alone_decide_nothing(cube_tracks: list[PoseTrack], cube: ObjectModel) -> None:
    found = find_sessions(tilted(cube_tracks[:8], 4), cube)
    assert len(found.sessions) == 1
    assert "8 tosses are too few" in found.notes[0]
    flights = [track.frames(slice(24)) for track in tilted(cube_tracks, 40)]
    (session,) = find_sessions(flights, cube, level="session").sessions
    assert (session.level, session.levelled) == (None, False)
    assert "rest on a face" in session_words(session)
    assert "not decided" in session_words(session)


def test_the_order_is_that_of_times_and_contradictions_are_said(cube_tracks: list[PoseTrack]) -> None:
    def at(*starts: float) -> list[PoseTrack]:
        return [replace(track, t=track.t + start) for track, start in zip(cube_tracks, starts, strict=False)]

    assert recording_order(cube_tracks[:3])[1:] == ("names", ())
    order, by, notes = recording_order(at(20, 10, 30))
    assert (order.tolist(), by) == ([1, 0, 2], "times")
    assert "toss 1 comes before 0" in notes[0]
    _, by, notes = recording_order(at(0, 0.3, 5))
    assert by == "names"
    assert "overlap" in notes[0]


def test_the_published_elbow_was_recorded_in_two_sessions(shared_data: Path, elbow: ObjectModel) -> None:
    first, second = find_sessions(list(read_pll(shared_data / "pll_elbow", n_joints=1)), elbow).sessions
    assert int(first.last) >= 320 - 3
    assert int(second.first) <= 323 + 3
    assert np.rad2deg(np.hypot(*first.level)) == pytest.approx(2.35, abs=0.2)
    assert (first.levelled, second.levelled) == (True, False)


@pytest.mark.parametrize("which", ["cube", "die"])
def test_published_recordings_that_are_level_or_contradict_themselves_are_left(shared_data: Path, which: str) -> None:
    if which == "cube":
        tracks, model = read_contactnets(shared_data / "contactnets_cube"), load_object("cube")
    else:  # its body frame is turned by 1.9 degrees: its faces say what the floor and the fall do not
        tracks = read_tum(shared_data / "mit_die" / "measured", n_joints=0)
        model = load_object(shared_data / "mit_die" / "die.xml")
    found = find_sessions(list(tracks), model, level="session")
    assert not any(session.levelled for session in found.sessions)
    assert len(found.sessions) == 1 or which == "die"
