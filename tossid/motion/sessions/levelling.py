"""Tracks and tosses turned and raised into the level world of their session, and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import quat_conj, quat_mul, quat_rotate, quat_to_matrix
from tossid.settings.sessions import SessionSettings
from tossid.types import OnDemand, PoseTrack, RecordingOrder, Toss

Array = NDArray[np.float64]

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
"""The quaternion (wxyz) of no turn."""

SETTINGS = SessionSettings()
_KEPT = 256
"""Levelled tracks that stay in memory."""


def levelled_tracks(tracks: Sequence[PoseTrack], found: RecordingOrder) -> Sequence[PoseTrack]:
    """The tracks, turned and raised as `find_sessions` found; the same ones where nothing is to be done.

    Args:
        tracks: As recorded.
        found: What was found of them.
    """
    if not (found.shift.any() or (found.turn != IDENTITY).any()):
        return tracks
    at = {name: i for i, name in enumerate(found.names)}

    def levelled(i: int) -> PoseTrack:
        k = at[tracks[i].name]
        return turned_track(tracks[i], found.turn[k], float(found.shift[k]))

    return OnDemand(levelled, len(tracks), kept=_KEPT)


def turned_track(track: PoseTrack, turn: Array, shift: float) -> PoseTrack:
    """A track in a world that is turned and then raised.

    Args:
        track: In the recorded world.
        turn: Quaternion wxyz, (4,).
        shift: Added to heights after the turn [m].
    """
    q, v, cov = _turned(track.q, turn), track.v, track.q_cov
    q[:, 2] += shift
    if v is not None:
        v = _turned_velocity(v, turn)
    return PoseTrack(track.name, track.t, q, None if cov is None else _turned_cov(cov, turn), v)


def as_recorded(toss: Toss, found: RecordingOrder | None) -> Toss:
    """A toss as it was recorded, before its session was levelled.

    Args:
        toss: Of a dataset.
        found: The dataset's order of recording; None where it was not looked at, and nothing was levelled.
    """
    if found is None:
        return toss
    k = found.names.index(toss.name)
    if not found.shift[k] and (found.turn[k] == IDENTITY).all():
        return toss
    back = quat_conj(found.turn[k])

    def pose(q: Array) -> Array:
        lowered = q.copy()
        lowered[:, 2] -= found.shift[k]
        return _turned(lowered, back)

    measured, measured_cov = toss.q_measured, toss.q_measured_cov
    return replace(
        toss,
        q=pose(toss.q),
        v=_turned_velocity(toss.v, back),
        q_cov=_turned_cov(toss.q_cov, back),
        v_cov=_turned_cov(toss.v_cov, back),
        q_measured=None if measured is None else pose(measured),
        q_measured_cov=None if measured_cov is None else _turned_cov(measured_cov, back),
    )


def _turned(q: Array, turn: Array) -> Array:
    """Configurations (n, nq) in a turned world."""
    out, turns = q.copy(), np.broadcast_to(turn, (len(q), 4))
    out[:, :3] = quat_rotate(turns, q[:, :3])
    out[:, 3:7] = quat_mul(turns, q[:, 3:7])
    return out


def _turned_velocity(v: Array, turn: Array) -> Array:
    out = v.copy()
    out[:, :3] = quat_rotate(np.broadcast_to(turn, (len(v), 4)), v[:, :3])
    return out


def _turned_cov(cov: Array, turn: Array) -> Array:
    """Covariances (n, nv, nv), whose first three coordinates are of the world."""
    T = np.eye(cov.shape[-1])
    T[:3, :3] = quat_to_matrix(turn)
    return np.asarray(T @ cov @ T.T)


def recordings_apart(found: RecordingOrder, settings: SessionSettings = SETTINGS) -> str | None:
    """Which sessions stand in worlds that are tilted against each other, as the tosses are in the dataset.

    Args:
        found: The order of recording; sessions that were levelled are level.
        settings: From which tilt on, and how clear it must be.

    Returns:
        A sentence; None where all stand in one world, or their tilts are not decided.
    """
    known = [
        (session, np.zeros(2) if session.levelled else np.array(session.level), np.array(session.level_sigma))
        for session in found.sessions
        if session.level is not None and session.level_sigma is not None
    ]
    if len(known) < 2:
        return None
    base, base_level, base_sigma = min(known, key=lambda each: float(np.linalg.norm(each[1])))
    apart = []
    for session, level, sigma in known:
        tilt, error = level - base_level, np.hypot(sigma, base_sigma)
        size = float(np.linalg.norm(tilt))
        if size > settings.smallest_level and float(np.linalg.norm(tilt / error)) > settings.level_sigmas:
            about = f"{np.rad2deg(size):.2f}° ± {np.rad2deg(error.max()):.2f}°"
            apart.append(f"tosses {session.first} to {session.last} stand in a world tilted by {about}")
    if not apart:
        return None
    count = {1: "Two", 2: "Three"}.get(len(apart), str(len(apart) + 1))
    return f"{count} recordings: {', '.join(apart)} against that of tosses {base.first} to {base.last}."
