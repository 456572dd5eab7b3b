"""Tosses that publishers turned about the vertical, or copied: found, undone, and not seen where there are none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.motion.turned import IN_A_ROW, TILT, TILTED, as_published, thrown_along_x, turns_of, yawed
from tossid.motion.sessions import as_recorded, find_sessions, levelled_tracks
from tossid.motion.sessions.copies import copy_words, find_copies, leak_words
from tossid.motion.sessions.levelling import turned_track
from tossid.motion.sessions.turns import Turns, find_lean, find_turns, throw_direction, turn_words
from tossid.motion.tosses import tosses_from_tracks
from tossid.objects import ObjectModel, load_object
from tossid.rotations import quat_exp, quat_mul
from tossid.store import drawn_splits
from tossid.store.importers import read_contactnets, read_pll
from tossid.types import PoseTrack, Toss

# turned about the vertical


@pytest.fixture(scope="module")
def thrown(cube: ObjectModel) -> list[PoseTrack]:
    return thrown_along_x(cube, 60)


@pytest.fixture(scope="module")
def published(thrown: list[PoseTrack]) -> list[PoseTrack]:
    return as_published(thrown)


@pytest.fixture(scope="module")
def turns(published: list[PoseTrack], cube: ObjectModel) -> Turns:
    return find_turns(published, cube)


def test_turns_are_found_with_the_tilt_that_turns(turns: Turns, published: list[PoseTrack]) -> None:
    yaws = turns_of(len(published))
    assert turns.were_turned
    assert turns.lean is not None
    assert turns.lean.p < 1e-6
    sigma = np.sqrt(np.diag(turns.lean.throw_cov))
    assert np.rad2deg(sigma.max()) < 0.15
    assert (np.abs(turns.lean.throw - TILT) < 4 * sigma).all()
    assert np.rad2deg(np.abs(turns.lean.world)) == pytest.approx([0, 0], abs=0.3)
    assert turns.recording_of.max() + 1 == len(np.unique(yaws))
    off = np.angle(np.exp(1j * (turns.yaw - yaws)))
    assert np.rad2deg(np.abs(off - np.median(off)).max()) < 8  # throws differ by 3 degrees
    assert f"{len(np.unique(yaws))} recordings were turned about the vertical" in (turn_words(turns) or "")


def test_tracks_that_were_turned_back_are_level_tosses_and_come_back_as_recorded(
    published: list[PoseTrack], turns: Turns, cube: ObjectModel
) -> None:
    back = turns.undone(published)
    assert np.rad2deg(np.abs([throw_direction(track, cube) for track in back]).max()) < 15
    found = turns.with_order(find_sessions(back, cube, level="session"))
    (session,) = found.sessions
    assert session.levelled
    assert session.level is not None
    assert np.rad2deg(session.level) == pytest.approx(np.rad2deg(TILT), abs=0.2)
    levelled = levelled_tracks(published, found)
    assert not find_turns(levelled, cube).were_turned
    recorded, _ = as_recorded(tosses_from_tracks(levelled, cube)[10], found).measured
    np.testing.assert_allclose(recorded[:, :3], published[10].q[:, :3], atol=1e-12)


def test_a_tilted_or_a_bent_world_that_was_not_turned_is_not_taken_for_one(
    thrown: list[PoseTrack], published: list[PoseTrack], cube: ObjectModel
) -> None:
    around = [yawed(track, yaw) for track, yaw in zip(thrown, turns_of(len(thrown)), strict=True)]
    tilted = find_turns([turned_track(track, TILTED, 0.0) for track in around], cube)
    assert tilted.lean is not None
    assert not tilted.were_turned
    assert np.rad2deg(tilted.lean.world) == pytest.approx(np.rad2deg(TILT), abs=0.3)
    slope, bent = 0.1, []
    for track in around:  # resting faces lean with the place, to the left of it
        q, (x, y) = track.q.copy(), track.q[-1, :2]
        q[:, 3:7] = turned_track(track, quat_exp(slope * np.array([-x, -y, 0.0])), 0.0).q[:, 3:7]
        bent.append(PoseTrack(track.name, track.t, q))
    seen = find_turns(bent, cube)
    assert seen.lean is not None
    assert not seen.were_turned
    # throws of one direction, or few recordings, decide nothing
    one_way = find_turns([turned_track(track, TILTED, 0.0) for track in thrown], cube)
    assert (one_way.recording_of.max(), one_way.lean, turn_words(one_way)) == (0, None, None)
    assert find_turns(published[: 5 * IN_A_ROW], cube).lean is None
    assert find_turns([], cube).lean is None


def test_parts_of_a_quantity_come_back() -> None:
    rng = np.random.default_rng(1)
    recording = np.repeat(np.arange(50), 4)
    yaw = rng.uniform(-np.pi, np.pi, 50)[recording]
    p = rng.normal(size=(200, 2))
    c, s = np.cos(yaw), np.sin(yaw)
    throw = np.stack([0.3 * c - 0.7 * s, 0.3 * s + 0.7 * c], axis=1)
    bent = 0.2 * p - 0.4 * np.stack([-p[:, 1], p[:, 0]], axis=1)
    noise = rng.normal(0, 0.01, (200, 2))
    noise[::20] *= 50
    found = find_lean(np.array([0.5, -0.1]) + throw + bent + noise, p, yaw, recording)
    assert found is not None
    np.testing.assert_allclose([*found.world, *found.throw], [0.5, -0.1, 0.3, 0.7], atol=0.01)
    assert np.sqrt(np.diag(found.throw_cov)) == pytest.approx([0.001, 0.001], rel=0.5)
    assert found.p < 1e-6


def test_the_published_cube_was_turned_and_the_elbow_was_not(shared_data: Path, cube: ObjectModel) -> None:
    found = find_turns(read_contactnets(shared_data / "contactnets_cube"), cube)
    assert found.were_turned
    assert found.lean is not None
    assert np.rad2deg(found.lean.throw) == pytest.approx([-0.15, -0.50], abs=0.06)
    assert np.rad2deg(found.lean.world) == pytest.approx([0, 0], abs=0.06)
    elbow = find_turns(read_pll(shared_data / "pll_elbow", n_joints=1), load_object("elbow"))
    assert elbow.lean is not None
    assert not elbow.were_turned


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


def in_split(track: PoseTrack, split: str) -> Toss:
    n, nv = len(track.t), track.q.shape[1] - 1
    zero = np.zeros((n, nv, nv))
    return Toss(track.name, track.t, track.q, np.zeros((n, nv)), zero, zero, np.zeros(n, dtype=np.uint8), split)


def test_copies_in_other_splits_are_leaks(cube_tracks: list[PoseTrack]) -> None:
    drawn = {"3": "train", "9": "test", "1": "validation", "2": "test", "4": "train", "5": ""}
    some = [in_split(track, drawn[track.name]) for track in cube_tracks if track.name in drawn]
    assert leak_words(some) is None
    of = {
        "a": (3, "validation"),
        "b": (3, "test"),
        "c": (9, "test"),  # both in one split
        "d": (1, "train"),  # the first leaks, not the copy
        "e": (2, "validation"),
        "f": (4, ""),  # out of the splits
        "g": (5, "test"),
    }
    more = [in_split(copied(cube_tracks[first], name, 0.2), split) for name, (first, split) in of.items()]
    words = leak_words([*some, *more]) or ""
    assert "2 of 5 test tosses equal one of train or validation, and 2 of 3 validation tosses one of train" in words


def test_the_published_cube_has_copies(shared_data: Path) -> None:
    tracks = read_contactnets(shared_data / "contactnets_cube")
    found = find_copies(tracks)
    assert len(found) == 22
    (pair,) = [copy for copy in found if copy.name == "140"]
    assert (pair.of, np.rad2deg(pair.yaw)) == ("56", pytest.approx(-169.03, abs=0.01))
    # of the splits that ingest draws, none leaks; those drawn without regard to copies do
    for copies, words in (({copy.name: copy.of for copy in found}, None), ({}, "8 of 100 test")):
        splits = drawn_splits([track.name for track in tracks], seed=0, copies=copies)
        leaks = leak_words([in_split(track, splits[track.name]) for track in tracks])
        assert leaks is None if words is None else words in (leaks or "")
