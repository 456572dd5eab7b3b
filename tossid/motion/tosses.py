"""From tracked poses to tosses: velocities, covariances and phases, one path for every source."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.motion.noise import pose_noise, velocity_noise
from tossid.motion.phases import label_phases
from tossid.motion.smoother import Smoothed, gyration, smooth_in_turn, smooth_tracks
from tossid.objects import GRAVITY, ObjectModel, corner_positions
from tossid.types import OnDemand, Phase, PoseTrack, Toss

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
    return tuple(tosses_in_turn(tracks, model, gravity=gravity, velocities=velocities, end_at_rest=end_at_rest))


def tosses_in_turn(
    tracks: Sequence[PoseTrack],
    model: ObjectModel,
    *,
    gravity: float = GRAVITY,
    velocities: str = "recorded",
    end_at_rest: bool = False,
) -> Iterator[Toss]:
    """`tosses_from_tracks` one by one, of more tracks (`OnDemand`) than fit into memory."""
    _check(tracks, model)
    if velocities not in ("recorded", "smoothed"):
        raise InputError(f"velocities is {velocities!r}, expected 'recorded' or 'smoothed'")
    recorded = [track.v is not None for track in tracks]
    if velocities == "recorded" and any(recorded) and not all(recorded):
        missing = tracks[recorded.index(False)].name
        raise InputError(f"track {missing} carries no velocities, others do; expected all or none")
    q_cov = _measurement_covariances(tracks, model)
    kept = velocities == "recorded" and all(recorded)
    made = (_as_recorded if kept else _as_smoothed)(tracks, model, q_cov, gravity)
    return (_until_rest(toss) for toss in made) if end_at_rest else made


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


def _measurement_covariances(tracks: Sequence[PoseTrack], model: ObjectModel) -> Sequence[Array]:
    """(n, nv, nv) of each track: its own, or what flight shows of them all."""
    given = all(track.q_cov is not None for track in tracks)
    cov = np.zeros((model.nv, model.nv)) if given else pose_noise(tracks, model).q_cov

    def of(i: int) -> Array:
        own = tracks[i].q_cov
        return np.broadcast_to(cov, (len(tracks[i].t), *cov.shape)).copy() if own is None else own

    return OnDemand(of, len(tracks), kept=0)


def _as_smoothed(
    tracks: Sequence[PoseTrack], model: ObjectModel, q_cov: Sequence[Array], gravity: float
) -> Iterator[Toss]:
    smoothed = smooth_in_turn(tracks, model, q_cov, gravity=gravity)
    for track, s, cov in zip(tracks, smoothed, q_cov, strict=True):
        phase = _label(model, track.t, s, gravity)
        yield Toss(track.name, track.t, s.q, s.v, s.q_cov, s.v_cov, phase, q_measured=track.q, q_measured_cov=cov)


def _as_recorded(
    tracks: Sequence[PoseTrack], model: ObjectModel, q_cov: Sequence[Array], gravity: float
) -> Iterator[Toss]:
    def labelled(track: PoseTrack) -> tuple[Array, NDArray[np.uint8]]:
        assert track.v is not None
        return track.v, label_phases(model, track.t, track.q, track.v, gravity=gravity)

    chosen = np.unique(np.linspace(0, len(tracks) - 1, min(SAMPLE, len(tracks))).astype(int))
    sample = [tracks[i] for i in chosen]
    smoothed = smooth_tracks(sample, model, [q_cov[i] for i in chosen], gravity=gravity)
    v, phase = zip(*(labelled(track) for track in sample), strict=True)
    v_cov = velocity_noise(np.concatenate(v), np.concatenate([s.v for s in smoothed]), np.concatenate(phase))
    for track, cov in zip(tracks, q_cov, strict=True):
        own, phases = labelled(track)
        yield Toss(track.name, track.t, track.q, own, cov, v_cov[phases], phases)


def _label(model: ObjectModel, t: Array, s: Smoothed, gravity: float) -> NDArray[np.uint8]:
    var = np.diagonal(s.v_cov, axis1=1, axis2=2)
    size = np.sqrt(var[:, :3].sum(axis=1) + gyration(model) ** 2 * var[:, 3:6].sum(axis=1))
    return label_phases(model, t, s.q, s.v, gravity=gravity, v_sigma=float(np.median(size)))


def _until_rest(toss: Toss) -> Toss:
    moving = np.flatnonzero(toss.phase != Phase.REST)
    last = int(moving[-1]) + 1 if len(moving) else 0
    stop = max(2, int(np.searchsorted(toss.t, toss.t[min(last, len(toss) - 1)] + REST_KEPT, side="right")))
    return toss.frames(slice(stop))
