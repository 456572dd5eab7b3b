"""Turning tracks into a level world and back."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.motion.sessions.levelling import as_recorded, levelled_tracks, recordings_apart, turned_track
from tossid.motion.sessions.search import find_sessions
from tossid.motion.tosses import tosses_from_tracks
from tossid.objects import ObjectModel
from tossid.rotations import quat_conj, quat_exp, quat_rotate
from tossid.types import PoseTrack, RecordingOrder, Session

TURN = quat_exp(np.deg2rad([0.8, 1.2, 0.0]))
"""Of a recorded world."""


def test_turning_back_gives_the_track_and_keeps_distances(tosses: list[PoseTrack]) -> None:
    track = tosses[0]
    turned = turned_track(track, TURN, 0.0)
    back = turned_track(turned, quat_conj(TURN), 0.0)
    np.testing.assert_allclose(back.q, track.q, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(turned.q[:, :3], axis=1), np.linalg.norm(track.q[:, :3], axis=1))
    np.testing.assert_allclose(turned.q[0, :3], quat_rotate(TURN, track.q[0, :3]), atol=1e-12)
    assert turned_track(track, TURN, 0.25).q[:, 2] == pytest.approx(turned.q[:, 2] + 0.25)
    if track.q_cov is not None:
        assert turned.q_cov is not None
        np.testing.assert_allclose(np.linalg.eigvalsh(turned.q_cov), np.linalg.eigvalsh(track.q_cov), atol=1e-15)


def test_what_was_levelled_can_be_had_as_recorded(tosses: list[PoseTrack], cube: ObjectModel) -> None:
    recorded = [turned_track(t, TURN, 0.003) if i >= 20 else t for i, t in enumerate(tosses)]
    found = find_sessions(recorded, cube)
    made = tosses_from_tracks(levelled_tracks(recorded, found), cube)
    back = as_recorded(made[30], found)
    assert back.q_measured is not None
    assert made[30].q_measured is not None
    assert np.abs(made[30].q_measured - recorded[30].q).max() > 1e-3
    np.testing.assert_allclose(back.q_measured[:, :3], recorded[30].q[:, :3], atol=1e-12)
    same = np.abs(np.sum(back.q_measured[:, 3:7] * recorded[30].q[:, 3:7], axis=1))
    np.testing.assert_allclose(same, 1, atol=1e-12)


def order_of(*sessions: Session) -> RecordingOrder:
    """An order of recording of one toss a session, whose tosses say nothing."""
    n = len(sessions)
    names, turn = tuple(session.first for session in sessions), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    return RecordingOrder(
        sessions, "names", names, (), np.zeros((n, 0)), np.zeros((n, 2)), turn, np.zeros(n), np.arange(n)
    )


def test_sessions_in_worlds_that_are_tilted_against_each_other_are_said() -> None:
    tilted = Session("0", "9", 10, (0.03, -0.03), (0.001, 0.001))
    level = Session("10", "29", 20, (0.001, 0.0), (0.0005, 0.0005))
    said = "Two recordings: tosses 0 to 9 stand in a world tilted by 2.39° ± 0.06° against that of tosses 10 to 29."
    assert recordings_apart(order_of(tilted, level)) == said
    assert recordings_apart(order_of(level, tilted)) == said
    third = Session("30", "39", 10, (0.0, 0.05), (0.001, 0.001))
    assert (recordings_apart(order_of(tilted, level, third)) or "").startswith("Three recordings: tosses 0 to 9")


@pytest.mark.parametrize(
    "first",
    [
        Session("0", "9", 10, (0.03, -0.03), (0.001, 0.001), levelled=True),
        Session("0", "9", 10, (0.03, -0.03), (0.02, 0.02)),
        Session("0", "9", 10, (0.003, 0.0), (0.0001, 0.0001)),
        Session("0", "9", 10, None, None),
    ],
    ids=["levelled", "uncertain", "too little to matter", "undecided"],
)
def test_no_recordings_apart_are_made_up(first: Session) -> None:
    assert recordings_apart(order_of(first, Session("10", "29", 20, (0.001, 0.0), (0.0005, 0.0005)))) is None
