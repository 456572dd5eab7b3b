"""Sessions: changes over an order, tilted worlds, tosses that were turned or copied: found and undone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.motion.bouncing import bounce, tracked
from tossid.motion.sessions import as_recorded, find_sessions, levelled_tracks, session_words
from tossid.motion.sessions.change_points import Sequence, find_changes, robust_mean
from tossid.motion.sessions.copies import copy_words, find_copies
from tossid.motion.sessions.levelling import recordings_apart, turned_track, upright
from tossid.motion.sessions.search import recording_order
from tossid.motion.sessions.turns import find_turns, throw_direction
from tossid.motion.sessions.witnesses import toss_witnesses
from tossid.motion.tosses import tosses_from_tracks
from tossid.objects import ObjectModel, corner_positions, load_object
from tossid.rotations import quat_conj, quat_exp, quat_mul, quat_rotate, quat_to_matrix
from tossid.store import drawn_splits
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
    for seed in range(12):
        rng = np.random.default_rng(seed)
        values = rng.normal(size=(60, 2))
        at = int(rng.integers(12, 48))
        values[at:] += [2.0, 1.0]  # two standard deviations
        changes = find_changes({"tilt": items(values), "noise": items(rng.normal(size=(60, 1)))})
        near += [abs(change.at - at) <= 3 for change in changes] == [True]
    assert near >= 11
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
    made = tosses_from_tracks(levelled[:6], cube)[3]
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


# ---------------------------------------------------------------- turned and copied


# turned about the vertical

LEAN = np.deg2rad([0.3, -0.8])
"""Of the table's normal in the tracker's world, along the throw and to its left."""
TILTED = quat_exp(np.array([-LEAN[1], LEAN[0], 0.0]))
IN_A_ROW = 3


def yawed(track: PoseTrack, angle: float) -> PoseTrack:
    """In a world turned about the vertical."""
    return turned_track(track, quat_exp(np.array([0.0, 0.0, angle])), 0.0)


@pytest.fixture(scope="module")
def published(cube: ObjectModel) -> list[PoseTrack]:
    """Tosses along x to within a few degrees until they rest, tracked in a tilted world, and then turned."""
    rng, along_x = np.random.default_rng(12), []
    for i, truth in enumerate(bounce(cube, rng, tosses=40, frames=200)):
        track = tracked(truth, rng, name=str(i))
        angle = throw_direction(track, cube)
        if angle is not None:
            along_x.append(yawed(track, np.deg2rad(rng.normal(0, 3)) - angle))
    yaws = turns_of(len(along_x))
    return [yawed(turned_track(track, TILTED, 0.0), yaw) for track, yaw in zip(along_x, yaws, strict=True)]


def turns_of(tosses: int) -> np.ndarray:
    """By how much the recording of each toss is turned; neighbours differ."""
    turned = np.cumsum(np.random.default_rng(3).uniform(0.6, 2 * np.pi - 0.6, -(-tosses // IN_A_ROW)))
    return np.repeat(turned, IN_A_ROW)[:tosses]


def test_tracks_that_were_turned_back_are_level_tosses_and_come_back_as_recorded(
    published: list[PoseTrack], cube: ObjectModel
) -> None:
    turns = find_turns(published, cube)
    off = np.angle(np.exp(1j * (turns_of(len(published)) - [2 * np.arctan2(-q[3], q[0]) for q in turns.back.values()])))
    assert np.rad2deg(np.abs(off - np.median(off)).max()) < 15  # throws differ by 3 degrees
    back = turns.undone(published)
    assert np.abs([throw_direction(track, cube) for track in back]).max() < 1e-9
    found = turns.with_order(find_sessions(back, cube, level="session"))
    (session,) = found.sessions
    assert session.levelled
    assert np.rad2deg(session.level) == pytest.approx(np.rad2deg(LEAN), abs=0.2)
    levelled = levelled_tracks(published, found)
    recorded, _ = as_recorded(tosses_from_tracks(levelled[8:14], cube)[2], found).measured
    np.testing.assert_allclose(recorded[:, :3], published[10].q[:, :3], atol=1e-12)


def test_a_toss_without_a_direction_is_turned_as_the_one_before(published: list[PoseTrack], cube: ObjectModel) -> None:
    dropped = replace(published[1], q=published[1].q * [0, 0, 1, 1, 1, 1, 1])
    turns = find_turns([published[0], dropped, *published[2:4]], cube)
    assert turns.unknown == (dropped.name,)
    np.testing.assert_array_equal(turns.back[dropped.name], turns.back[published[0].name])


def test_the_published_cube_was_turned(shared_data: Path, cube: ObjectModel) -> None:
    """Only where all throws go along x do the faces that it rests on lean as the tracker's world did."""
    tracks = read_contactnets(shared_data / "contactnets_cube")
    for some, lean in ((tracks, [0.0, 0.0]), (find_turns(tracks, cube).undone(tracks), [-0.15, -0.50])):
        seen = toss_witnesses(some, cube)
        mean = robust_mean(seen.values["normal"], seen.info["normal"]).value
        assert np.rad2deg(mean) == pytest.approx(lean, abs=0.06)


# copies


def copied(track: PoseTrack, name: str, yaw: float, *, lift: float = 0.0) -> PoseTrack:
    return replace(turned_track(track, quat_exp(np.array([0.0, 0.0, yaw])), lift), name=name)


def test_copies_are_found_with_their_angles(cube_tracks: list[PoseTrack]) -> None:
    once, twice = copied(cube_tracks[3], "a", 1.2), copied(cube_tracks[9], "b", -2.0, lift=0.01)
    renamed = replace(twice, name="d", q=twice.q.copy())  # the body's axes, named otherwise
    renamed.q[:, 3:7] = quat_mul(renamed.q[:, 3:7], quat_exp(np.array([0.5 * np.pi, 0.0, 0.0])))
    found = find_copies([*cube_tracks, once, twice, copied(once, "c", 0.5), renamed])
    assert [(copy.name, copy.of) for copy in found] == [("a", "3"), ("b", "9"), ("c", "3"), ("d", "9")]
    assert [copy.yaw for copy in found] == pytest.approx([1.2, -2.0, 1.7, -2.0], abs=1e-9)
    assert "4 tosses are copies of earlier ones" in (copy_words(found) or "")
    assert "a of 3 (68.8°), b of 9 (-114.6°)" in (copy_words(found) or "")


def test_tosses_that_only_resemble_each_other_are_none(cube_tracks: list[PoseTrack]) -> None:
    assert find_copies(cube_tracks) == ()
    assert copy_words(()) is None
    measured, spun = copied(cube_tracks[3], "again", 1.2), copied(cube_tracks[3], "spun", 1.2)
    measured.q[:, :3] += np.random.default_rng(0).normal(0, 2e-5, (len(measured.q), 3))
    spun.q[:, 3:7] = quat_mul(spun.q[:, 3:7], quat_exp(np.linspace(0, 0.01, len(spun.q))[:, None] * [0, 0, 1.0]))
    cut = replace(cube_tracks[3].frames(slice(-1)), name="cut")
    assert find_copies([*cube_tracks, measured, spun, cut]) == ()


def test_the_published_cube_has_copies(shared_data: Path) -> None:
    tracks = read_contactnets(shared_data / "contactnets_cube")
    found = find_copies(tracks)
    assert len(found) == 22
    (pair,) = [copy for copy in found if copy.name == "140"]
    assert (pair.of, np.rad2deg(pair.yaw)) == ("56", pytest.approx(-169.03, abs=0.01))
    splits = drawn_splits([track.name for track in tracks], seed=0, copies={copy.name: copy.of for copy in found})
    assert all(splits[copy.name] == splits[copy.of] for copy in found)
