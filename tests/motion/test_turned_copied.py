"""Tosses that publishers turned about the vertical, or copied: found, undone, and not seen where there are none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.motion.bouncing import bounce, tracked
from tossid.motion.sessions import as_recorded, find_sessions, levelled_tracks
from tossid.motion.sessions.change_points import robust_mean
from tossid.motion.sessions.copies import copy_words, find_copies
from tossid.motion.sessions.levelling import turned_track
from tossid.motion.sessions.turns import find_turns, throw_direction
from tossid.motion.sessions.witnesses import toss_witnesses
from tossid.motion.tosses import tosses_from_tracks
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, quat_mul
from tossid.store import drawn_splits
from tossid.store.importers import read_contactnets
from tossid.types import PoseTrack

# turned about the vertical

TILT = np.deg2rad([0.3, -0.8])
"""Of the table's normal in the tracker's world, along the throw and to its left."""
TILTED = quat_exp(np.array([-TILT[1], TILT[0], 0.0]))
IN_A_ROW = 3


def yawed(track: PoseTrack, angle: float) -> PoseTrack:
    """In a world turned about the vertical."""
    return turned_track(track, quat_exp(np.array([0.0, 0.0, angle])), 0.0)


@pytest.fixture(scope="module")
def published(cube: ObjectModel) -> list[PoseTrack]:
    """Tosses along x to within a few degrees until they rest, tracked in a tilted world, and then turned."""
    rng, along_x = np.random.default_rng(12), []
    for i, truth in enumerate(bounce(cube, rng, tosses=60, frames=220)):
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
    assert np.rad2deg(session.level) == pytest.approx(np.rad2deg(TILT), abs=0.2)
    levelled = levelled_tracks(published, found)
    recorded, _ = as_recorded(tosses_from_tracks(levelled, cube)[10], found).measured
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
