"""From tracked poses to tosses: velocities, covariances and phases, one path for every source."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.motion.contact import Touch, lowest_corner
from tossid.motion.free_fall import Parabola, find_parabola
from tossid.motion.kinematics import gyration
from tossid.motion.noise import pose_noise, velocity_noise
from tossid.motion.phases import label_phases, phases_of_motion
from tossid.motion.resting import bounce_heights, rest_heights
from tossid.motion.smoothing.smoother import Smoothed, smooth_in_turn
from tossid.objects import GRAVITY, ObjectModel
from tossid.types import OnDemand, Phase, PoseTrack, Toss

Array = NDArray[np.float64]

JUDGED_TRACKS = 64
"""Tracks that the noise of recorded velocities is estimated from."""
REST_KEPT = 0.1
"""Rest that a toss keeps where its end is cut [s]."""
DEEPEST_REL = 0.5
"""Tracks whose lowest corner is deeper in the ground than so many widths (median), or which rest or bounce so high
above it, are refused: they are in other units, of another object, or over another ground."""


def tosses_from_tracks(
    tracks: Sequence[PoseTrack], model: ObjectModel, *, gravity: float = GRAVITY, end_at_rest: bool = False
) -> tuple[Toss, ...]:
    """Tosses of tracks: with velocities, covariances and phases.

    Where tracks carry velocities, poses and velocities stay as recorded. The noise of the poses is then estimated from
    flight, and that of the velocities, phase by phase, from their distance to smoothed ones. Where they carry none, the
    smoother gives poses, velocities and covariances, and a toss keeps the track's own poses beside them.

    Args:
        tracks: Of one object; all or none with velocities.
        model: The object.
        gravity: Of free flight [m/s²].
        end_at_rest: Whether to cut what follows 0.1 s of final rest.

    Raises:
        InputError: The tracks do not fit the object, lie in the ground, or touch nothing but air above it.
    """
    return tuple(tosses_in_turn(tracks, model, gravity=gravity, end_at_rest=end_at_rest))


def tosses_in_turn(
    tracks: Sequence[PoseTrack], model: ObjectModel, *, gravity: float = GRAVITY, end_at_rest: bool = False
) -> Iterator[Toss]:
    """`tosses_from_tracks` one by one, of more tracks (`OnDemand`) than fit into memory.

    Args:
        tracks: As there.
        model: As there; one of which nothing is stated (`unstated_object`) has its flight found in its motion.
        gravity: As there.
        end_at_rest: As there.

    Yields:
        A toss of each track, in order.

    Raises:
        InputError: As there; before the first toss.
    """
    _check(tracks, model)
    parabola = None if model.is_stated else find_parabola(tracks, model, gravity=gravity)
    recorded = [track.v is not None for track in tracks]
    if any(recorded) and not all(recorded):
        missing = tracks[recorded.index(False)].name
        raise InputError(f"track {missing} carries no velocities, others do; expected all or none")
    flight = _Flight(model if parabola is None else parabola.body(), gravity, parabola)
    q_cov = _measurement_covariances(tracks, flight)
    made = (_as_recorded if all(recorded) else _as_smoothed)(tracks, q_cov, flight)
    return (_until_rest(toss) for toss in made) if end_at_rest else made


def covariance_source(tracks: Sequence[PoseTrack]) -> str:
    """Where the covariances of `tosses_from_tracks` come from, in words, for a dataset's provenance.

    Args:
        tracks: As there.
    """
    poses = "given with the track" if all(track.q_cov is not None for track in tracks) else "residuals in flight"
    if all(track.v is not None for track in tracks):
        return f"q: {poses}; v: distance to smoothed velocities, by phase"
    return f"q, v: smoother (measurement: {poses})"


def median_rate(tracks: Sequence[PoseTrack | Toss]) -> float:
    """Frames a second [Hz]: the inverse of the median time step of all tracks.

    Args:
        tracks: Tracks or tosses.
    """
    return float(1.0 / np.median(np.concatenate([np.diff(track.t) for track in tracks])))


@dataclass(frozen=True)
class _Flight:
    """How an object flies; parabola: of one without corners."""

    model: ObjectModel
    gravity: float
    parabola: Parabola | None

    @property
    def touch(self) -> Touch | None:
        return None if self.parabola is None else self.parabola.may_touch

    def phases(self, t: Array, q: Array, v: Array, v_sigma: float = 0.0) -> NDArray[np.uint8]:
        if self.parabola is not None:
            return phases_of_motion(self.parabola, t, q, v, v_sigma=v_sigma)
        return label_phases(self.model, t, q, v, gravity=self.gravity, v_sigma=v_sigma)

    def smoothed(self, tracks: Sequence[PoseTrack], q_cov: Sequence[Array]) -> Iterator[Smoothed]:
        return smooth_in_turn(tracks, self.model, q_cov, gravity=self.gravity, touch=self.touch)


def _check(tracks: Sequence[PoseTrack], model: ObjectModel) -> None:
    if not tracks:
        raise InputError("there are no tracks")
    for track in tracks:
        if track.q.shape[1] != model.nq:
            raise InputError(
                f"track {track.name} has {track.q.shape[1] - 7} joints, object '{model.name}' has {model.n_joints}"
            )
    if not model.is_stated:
        return
    expected = f"expected metres, the ground at z = 0, and object '{model.name}'"
    lowest = float(np.median([lowest_corner(model, track.q).min() for track in tracks]))
    if lowest < -DEEPEST_REL * model.width:
        raise InputError(f"the tracks go {-lowest:.3g} m below the ground (median); {expected}")
    if lowest > DEEPEST_REL * model.width:
        touched = np.append(rest_heights(tracks, model), bounce_heights(tracks, model))
        if len(touched):  # (else they may be nothing but flight)
            high = float(np.median(touched))
            raise InputError(f"tosses bounce or rest {high:.3g} m above the ground (median); {expected}")


def _measurement_covariances(tracks: Sequence[PoseTrack], flight: _Flight) -> Sequence[Array]:
    """(n, nv, nv) of each track: its own, or one for all, estimated from flight."""
    cov = np.zeros((flight.model.nv, flight.model.nv))
    if any(track.q_cov is None for track in tracks):
        cov = pose_noise(tracks, flight.model, touch=flight.touch)

    def of(i: int) -> Array:
        own = tracks[i].q_cov
        return np.broadcast_to(cov, (len(tracks[i].t), *cov.shape)).copy() if own is None else own

    return OnDemand(of, len(tracks), kept=0)


def _as_smoothed(tracks: Sequence[PoseTrack], q_cov: Sequence[Array], flight: _Flight) -> Iterator[Toss]:
    gyration2 = gyration(flight.model) ** 2
    for track, s, cov in zip(tracks, flight.smoothed(tracks, q_cov), q_cov, strict=True):
        var = np.diagonal(s.v_cov, axis1=1, axis2=2)
        v_sigma = float(np.median(np.sqrt(var[:, :3].sum(axis=1) + gyration2 * var[:, 3:6].sum(axis=1))))
        phase = flight.phases(track.t, s.q, s.v, v_sigma)
        yield Toss(
            track.name, track.t, s.q, s.v, s.q_cov, s.v_cov, phase, q_measured=track.q, q_measured_cov=cov
        )  # fmt: skip


def _as_recorded(tracks: Sequence[PoseTrack], q_cov: Sequence[Array], flight: _Flight) -> Iterator[Toss]:
    def labelled(track: PoseTrack) -> tuple[Array, NDArray[np.uint8]]:
        assert track.v is not None
        return track.v, flight.phases(track.t, track.q, track.v)

    chosen = np.unique(np.linspace(0, len(tracks) - 1, min(JUDGED_TRACKS, len(tracks))).astype(int))
    sample = [tracks[i] for i in chosen]
    smoothed = np.concatenate([s.v for s in flight.smoothed(sample, [q_cov[i] for i in chosen])])
    v, phase = (np.concatenate(parts) for parts in zip(*map(labelled, sample), strict=True))
    v_cov = velocity_noise(v, smoothed, phase)
    for track, cov in zip(tracks, q_cov, strict=True):
        own, phases = labelled(track)
        yield Toss(track.name, track.t, track.q, own, cov, v_cov[phases], phases)


def _until_rest(toss: Toss) -> Toss:
    moving = np.flatnonzero(toss.phase != Phase.REST)
    last = int(moving[-1]) + 1 if len(moving) else 0
    stop = max(2, int(np.searchsorted(toss.t, toss.t[min(last, len(toss) - 1)] + REST_KEPT, side="right")))
    return toss.frames(slice(stop))
