"""From tracked poses to tosses: velocities, covariances and phases, one path for every source."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.motion.noise import pose_noise, velocity_noise
from tossid.motion.phases import label_phases
from tossid.motion.smoother import Smoothed, gyration, smooth_tracks
from tossid.objects import GRAVITY, ObjectModel, corner_positions
from tossid.types import Phase, PoseTrack, Toss

Array = NDArray[np.float64]

SAMPLE = 64
"""Tracks that serve to judge recorded velocities."""
REST_KEPT = 0.1
"""[s] of rest that an ended toss keeps."""
DEEPEST_REL = 0.5
"""Of the width: tosses whose lowest corner lies deeper in the ground than this (median over tosses) are in other
units, of another object, or over another ground."""


def tosses_from_tracks(
    tracks: Sequence[PoseTrack],
    model: ObjectModel,
    *,
    gravity: float = GRAVITY,
    velocities: str = "recorded",
    end_at_rest: bool = False,
) -> tuple[Toss, ...]:
    """Give tracks velocities, covariances and phases.

    Where tracks carry velocities, poses and velocities stay as recorded; the
    noise of the poses is found from flight, that of the velocities, for each
    phase, from their distance to the smoother's. Where they carry none, the
    smoother gives poses, velocities and covariances, and the track's own poses stay beside them.

    Args:
        tracks: of one object; all or none with velocities.
        model: the object.
        gravity: of free flight [m/s²].
        velocities: "recorded" keeps what is there; "smoothed" makes nothing of it.
        end_at_rest: cut what follows 0.1 s of final rest.

    Raises:
        InputError: the tracks do not fit the object, or lie in the ground.
    """
    _check(tracks, model)
    if velocities not in ("recorded", "smoothed"):
        raise InputError(f"velocities is {velocities!r}, expected 'recorded' or 'smoothed'")
    recorded = [track.v is not None for track in tracks]
    if velocities == "recorded" and any(recorded) and not all(recorded):
        missing = tracks[recorded.index(False)].name
        raise InputError(f"track {missing} carries no velocities, others do; expected all or none")
    q_cov = _measurement_covariances(tracks, model)
    if velocities == "recorded" and all(recorded):
        tosses = _keep_recorded(tracks, model, q_cov, gravity=gravity)
    else:
        smoothed = smooth_tracks(tracks, model, q_cov, gravity=gravity)
        tosses = [
            Toss(
                track.name,
                track.t,
                s.q,
                s.v,
                s.q_cov,
                s.v_cov,
                _label(model, track.t, s, gravity),
                q_measured=track.q,
                q_measured_cov=cov,
            )
            for track, s, cov in zip(tracks, smoothed, q_cov, strict=True)
        ]
    return tuple(_until_rest(toss) if end_at_rest else toss for toss in tosses)


def covariance_source(tracks: Sequence[PoseTrack], *, velocities: str = "recorded") -> str:
    """In words, where the covariances of `tosses_from_tracks` come from (for a dataset's provenance)."""
    poses = "given with the track" if all(track.q_cov is not None for track in tracks) else "residuals in flight"
    if velocities == "recorded" and all(track.v is not None for track in tracks):
        return f"q: {poses}; v: distance to smoothed velocities, by phase"
    return f"q, v: smoother (measurement: {poses})"


def median_rate(tracks: Sequence[PoseTrack | Toss]) -> float:
    """Frames a second [Hz]: the inverse of the median time step of all tracks."""
    return float(1.0 / np.median(np.concatenate([np.diff(track.t) for track in tracks])))


def _check(tracks: Sequence[PoseTrack], model: ObjectModel) -> None:
    if not tracks:
        raise InputError("there are no tracks")
    for track in tracks:
        if track.q.shape[1] != model.nq:
            raise InputError(
                f"track {track.name} has {track.q.shape[1] - 7} joints, object '{model.name}' has {model.n_joints}"
            )
    lowest = float(np.median([corner_positions(model, track.q)[..., 2].min() for track in tracks]))
    if lowest < -DEEPEST_REL * model.width:
        raise InputError(
            f"the tracks go {-lowest:.3g} m below the ground (median); expected metres, the ground at z = 0, "
            f"and object '{model.name}'"
        )


def _measurement_covariances(tracks: Sequence[PoseTrack], model: ObjectModel) -> list[Array]:
    if all(track.q_cov is not None for track in tracks):
        return [track.q_cov for track in tracks if track.q_cov is not None]
    cov = pose_noise(tracks, model).q_cov
    return [
        np.broadcast_to(cov, (len(track.t), *cov.shape)).copy() if track.q_cov is None else track.q_cov
        for track in tracks
    ]


def _keep_recorded(
    tracks: Sequence[PoseTrack], model: ObjectModel, q_cov: Sequence[Array], *, gravity: float
) -> list[Toss]:
    kept = [(track, track.v) for track in tracks if track.v is not None]
    phases = [label_phases(model, track.t, track.q, v, gravity=gravity) for track, v in kept]
    sample = np.unique(np.linspace(0, len(tracks) - 1, min(SAMPLE, len(tracks))).astype(int))
    smoothed = smooth_tracks([tracks[i] for i in sample], model, [q_cov[i] for i in sample], gravity=gravity)
    v_cov = velocity_noise(
        np.concatenate([kept[i][1] for i in sample]),
        np.concatenate([s.v for s in smoothed]),
        np.concatenate([phases[i] for i in sample]),
    )
    return [
        Toss(track.name, track.t, track.q, v, cov, v_cov[phase], phase)
        for (track, v), cov, phase in zip(kept, q_cov, phases, strict=True)
    ]


def _label(model: ObjectModel, t: Array, s: Smoothed, gravity: float) -> NDArray[np.uint8]:
    var = np.diagonal(s.v_cov, axis1=1, axis2=2)
    size = np.sqrt(var[:, :3].sum(axis=1) + gyration(model) ** 2 * var[:, 3:6].sum(axis=1))
    return label_phases(model, t, s.q, s.v, gravity=gravity, v_sigma=float(np.median(size)))


def _until_rest(toss: Toss) -> Toss:
    moving = np.flatnonzero(toss.phase != Phase.REST)
    last = int(moving[-1]) + 1 if len(moving) else 0
    stop = max(2, int(np.searchsorted(toss.t, toss.t[min(last, len(toss) - 1)] + REST_KEPT, side="right")))
    return toss.frames(slice(stop))
