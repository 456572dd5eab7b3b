"""Recordings that were turned about the vertical are found by what turns with them, and turned back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.motion.turned import IN_A_ROW, TILT, TILTED, as_published, thrown_along_x, turns_of, yawed
from tossid.motion.sessions.levelling import as_recorded, levelled_tracks, turned_track
from tossid.motion.sessions.search import find_sessions
from tossid.motion.sessions.turns import Turns, find_turns, in_throw, throw_direction, turn_words
from tossid.motion.tosses import tosses_from_tracks
from tossid.objects import ObjectModel, load_object
from tossid.rotations import quat_exp
from tossid.store.importers import read_contactnets, read_pll
from tossid.types import PoseTrack


@pytest.fixture(scope="module")
def thrown(cube: ObjectModel) -> list[PoseTrack]:
    return thrown_along_x(cube, 60)


@pytest.fixture(scope="module")
def yaws(thrown: list[PoseTrack]) -> np.ndarray:
    return turns_of(len(thrown))


@pytest.fixture(scope="module")
def published(thrown: list[PoseTrack]) -> list[PoseTrack]:
    return as_published(thrown)


@pytest.fixture(scope="module")
def turns(published: list[PoseTrack], cube: ObjectModel) -> Turns:
    return find_turns(published, cube)


def test_turns_are_found_with_the_tilt_that_turns(turns: Turns, yaws: np.ndarray) -> None:
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
    said = turn_words(turns) or ""
    assert f"{len(np.unique(yaws))} recordings were turned about the vertical" in said
    assert f"{np.rad2deg(turns.lean.throw[1]):.2f}° to its left" in said


def test_tracks_that_were_turned_back_are_level_tosses_and_come_back_as_recorded(
    published: list[PoseTrack], turns: Turns, cube: ObjectModel
) -> None:
    back = turns.undone(published)
    directions = np.array([throw_direction(track, cube) for track in back])
    assert np.rad2deg(np.abs(directions).max()) < 15
    found = turns.with_order(find_sessions(back, cube, level="session"))
    (session,) = found.sessions
    assert session.levelled
    assert session.level is not None
    assert np.rad2deg(session.level) == pytest.approx(np.rad2deg(TILT), abs=0.2)
    levelled = levelled_tracks(published, found)
    again = find_turns(levelled, cube)
    assert not again.were_turned
    made = tosses_from_tracks(levelled, cube)
    recorded = as_recorded(made[10], found)
    assert recorded.q_measured is not None
    np.testing.assert_allclose(recorded.q_measured[:, :3], published[10].q[:, :3], atol=1e-12)


def test_a_tilted_or_a_bent_world_that_was_not_turned_is_not_taken_for_one(
    thrown: list[PoseTrack], yaws: np.ndarray, cube: ObjectModel
) -> None:
    around = [yawed(track, yaw) for track, yaw in zip(thrown, yaws, strict=True)]
    tilted = find_turns([turned_track(track, TILTED, 0.0) for track in around], cube)
    assert tilted.lean is not None
    assert not tilted.were_turned
    assert turn_words(tilted) is None
    assert np.rad2deg(tilted.lean.world) == pytest.approx(np.rad2deg(TILT), abs=0.3)
    slope, bent = 0.1, []
    for track in around:  # resting faces lean with the place, to the left of it
        q, (x, y) = track.q.copy(), track.q[-1, :2]
        lean = slope * np.array([-y, x])
        q[:, 3:7] = turned_track(track, quat_exp(np.array([-lean[1], lean[0], 0.0])), 0.0).q[:, 3:7]
        bent.append(PoseTrack(track.name, track.t, q))
    seen = find_turns(bent, cube)
    assert seen.lean is not None
    assert not seen.were_turned
    assert seen.lean.slope == pytest.approx([0.0, slope], abs=0.025)


def test_throws_of_one_direction_or_few_recordings_decide_nothing(
    thrown: list[PoseTrack], published: list[PoseTrack], cube: ObjectModel
) -> None:
    one_way = find_turns([turned_track(track, TILTED, 0.0) for track in thrown], cube)
    assert one_way.recording_of.max() == 0
    assert one_way.lean is None
    assert not one_way.were_turned
    few = find_turns(published[: 5 * IN_A_ROW], cube)
    assert few.lean is None
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
    found = in_throw(np.array([0.5, -0.1]) + throw + bent + noise, p, yaw, recording, sigma=np.full(200, 0.01))
    assert found is not None
    assert (found.n, found.n_recordings) == (200, 50)
    np.testing.assert_allclose(found.world, [0.5, -0.1], atol=0.01)
    np.testing.assert_allclose(found.throw, [0.3, 0.7], atol=0.01)
    np.testing.assert_allclose(found.slope, [0.2, -0.4], atol=0.01)
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
