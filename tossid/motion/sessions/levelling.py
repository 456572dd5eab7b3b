"""Tracks and tosses turned and raised into the level world of their session, and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import quat_conj, quat_exp, quat_mul, quat_rotate, quat_to_matrix
from tossid.types import OnDemand, PoseTrack, RecordingOrder, Toss

Array = NDArray[np.float64]

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
"""The quaternion (wxyz) of no turn."""
LEVEL_SIGMAS = 4.0
"""A world is tilted where its tilt exceeds so many standard errors,"""
SMALLEST_LEVEL = np.deg2rad(0.2)
"""and where it exceeds this [rad]."""
KEPT = 256
"""Levelled tracks that stay in memory."""


def upright(up: Array) -> Array:
    """The shortest rotation that takes a direction to the z axis, as a quaternion wxyz (4,).

    Args:
        up: A unit vector, (3,).
    """
    axis = np.cross(up, [0.0, 0.0, 1.0])
    length = float(np.linalg.norm(axis))
    if length < 1e-12:
        return IDENTITY.copy() if up[2] > 0 else np.array([0.0, 1.0, 0.0, 0.0])
    return quat_exp(axis / length * float(np.arccos(np.clip(up[2], -1, 1))))


def turned_track(track: PoseTrack, turn: Array, shift: float) -> PoseTrack:
    """A track in a world that is turned and then raised.

    Args:
        track: In the recorded world.
        turn: Quaternion wxyz, (4,).
        shift: Added to heights after the turn [m].
    """
    v, cov = track.v, track.q_cov
    return PoseTrack(
        track.name,
        track.t,
        _turned(track.q, turn, shift),
        None if cov is None else _turned_cov(cov, turn),
        None if v is None else _turned_velocity(v, turn),
    )


def levelled_tracks(tracks: Sequence[PoseTrack], found: RecordingOrder) -> Sequence[PoseTrack]:
    """The tracks, turned and raised as `find_sessions` found; the same ones where nothing is to be done.

    Args:
        tracks: As recorded.
        found: What was found of them.
    """
    if not (found.shift.any() or (found.turn != IDENTITY).any()):
        return tracks
    at = [found.names.index(track.name) for track in tracks]
    return OnDemand(lambda i: turned_track(tracks[i], found.turn[at[i]], found.shift[at[i]]), len(tracks), kept=KEPT)


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
    down = -quat_rotate(back, np.array([0.0, 0.0, found.shift[k]]))
    measured, measured_cov = toss.q_measured, toss.q_measured_cov
    return replace(
        toss,
        q=_turned(toss.q, back, down),
        v=_turned_velocity(toss.v, back),
        q_cov=_turned_cov(toss.q_cov, back),
        v_cov=_turned_cov(toss.v_cov, back),
        q_measured=None if measured is None else _turned(measured, back, down),
        q_measured_cov=None if measured_cov is None else _turned_cov(measured_cov, back),
    )


def _turned(q: Array, turn: Array, shift: Array | float) -> Array:
    """Configurations (n, nq) in a world that is turned and then shifted: by a vector (3,), or up [m]."""
    out = q.copy()
    out[:, :3] = quat_rotate(turn, q[:, :3]) + (shift if np.ndim(shift) else np.array([0.0, 0.0, shift]))
    out[:, 3:7] = quat_mul(turn, q[:, 3:7])
    return out


def _turned_velocity(v: Array, turn: Array) -> Array:
    return np.concatenate([quat_rotate(turn, v[:, :3]), v[:, 3:]], axis=1)


def _turned_cov(cov: Array, turn: Array) -> Array:
    """Covariances (n, nv, nv), whose first three coordinates are of the world."""
    T = np.eye(cov.shape[-1])
    T[:3, :3] = quat_to_matrix(turn)
    return np.asarray(T @ cov @ T.T)


def recordings_apart(found: RecordingOrder) -> str | None:
    """Which sessions stand in worlds that are tilted against each other, as the tosses are in the dataset.

    Args:
        found: The order of recording; sessions that were levelled are level.

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
        if size > SMALLEST_LEVEL and float(np.linalg.norm(tilt / error)) > LEVEL_SIGMAS:
            about = f"{np.rad2deg(size):.2f}° ± {np.rad2deg(error.max()):.2f}°"
            apart.append(f"tosses {session.first} to {session.last} stand in a world tilted by {about}")
    if not apart:
        return None
    count = {1: "Two", 2: "Three"}.get(len(apart), str(len(apart) + 1))
    return f"{count} recordings: {', '.join(apart)} against that of tosses {base.first} to {base.last}."
