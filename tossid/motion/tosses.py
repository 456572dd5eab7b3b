"""From tracked poses to tosses: velocities, covariances and phases, one path for every source."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.motion.noise import pose_noise, velocity_noise
from tossid.motion.phases import label_phases
from tossid.motion.smoother import Smoothed, gyration, smooth_in_turn
from tossid.objects import GRAVITY, ObjectModel, corner_positions
from tossid.settings.motion import MotionSettings, NoiseSettings, PhaseSettings
from tossid.types import OnDemand, Phase, PoseTrack, Toss

Array = NDArray[np.float64]

DEFAULT = MotionSettings()


def tosses_from_tracks(
    tracks: Sequence[PoseTrack],
    model: ObjectModel,
    *,
    gravity: float = GRAVITY,
    end_at_rest: bool = False,
    settings: MotionSettings = DEFAULT,
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
        settings: Of noise, smoothing and phases.

    Raises:
        InputError: The tracks do not fit the object, or lie in the ground.
    """
    return tuple(tosses_in_turn(tracks, model, gravity=gravity, end_at_rest=end_at_rest, settings=settings))


def tosses_in_turn(
    tracks: Sequence[PoseTrack],
    model: ObjectModel,
    *,
    gravity: float = GRAVITY,
    end_at_rest: bool = False,
    settings: MotionSettings = DEFAULT,
) -> Iterator[Toss]:
    """`tosses_from_tracks` one by one, of more tracks (`OnDemand`) than fit into memory.

    Args:
        tracks: As there.
        model: As there.
        gravity: As there.
        end_at_rest: As there.
        settings: As there.

    Yields:
        A toss of each track, in order.

    Raises:
        InputError: As there; before the first toss.
    """
    _check(tracks, model, settings.deepest)
    recorded = [track.v is not None for track in tracks]
    if any(recorded) and not all(recorded):
        missing = tracks[recorded.index(False)].name
        raise InputError(f"track {missing} carries no velocities, others do; expected all or none")
    q_cov = _measurement_covariances(tracks, model, settings.noise)
    made = (_as_recorded if all(recorded) else _as_smoothed)(tracks, model, q_cov, gravity, settings)
    return (_until_rest(toss, settings.rest_kept) for toss in made) if end_at_rest else made


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


def _check(tracks: Sequence[PoseTrack], model: ObjectModel, deepest: float) -> None:
    if not tracks:
        raise InputError("there are no tracks")
    for track in tracks:
        if track.q.shape[1] != model.nq:
            raise InputError(
                f"track {track.name} has {track.q.shape[1] - 7} joints, object '{model.name}' has {model.n_joints}"
            )
    lowest = float(np.median([corner_positions(model, track.q)[..., 2].min() for track in tracks]))
    if lowest < -deepest * model.width:
        raise InputError(
            f"the tracks go {-lowest:.3g} m below the ground (median); expected metres, the ground at z = 0, "
            f"and object '{model.name}'"
        )


def _measurement_covariances(
    tracks: Sequence[PoseTrack], model: ObjectModel, settings: NoiseSettings
) -> Sequence[Array]:
    """(n, nv, nv) of each track: its own, or one for all, estimated from flight."""
    given = all(track.q_cov is not None for track in tracks)
    cov = np.zeros((model.nv, model.nv)) if given else pose_noise(tracks, model, settings=settings).q_cov

    def of(i: int) -> Array:
        own = tracks[i].q_cov
        return np.broadcast_to(cov, (len(tracks[i].t), *cov.shape)).copy() if own is None else own

    return OnDemand(of, len(tracks), kept=0)


def _as_smoothed(
    tracks: Sequence[PoseTrack], model: ObjectModel, q_cov: Sequence[Array], gravity: float, settings: MotionSettings
) -> Iterator[Toss]:
    smoothed = smooth_in_turn(tracks, model, q_cov, gravity=gravity, settings=settings.smoother)
    for track, s, cov in zip(tracks, smoothed, q_cov, strict=True):
        phase = _label(model, track.t, s, gravity, settings.phases)
        yield Toss(track.name, track.t, s.q, s.v, s.q_cov, s.v_cov, phase, q_measured=track.q, q_measured_cov=cov)


def _as_recorded(
    tracks: Sequence[PoseTrack], model: ObjectModel, q_cov: Sequence[Array], gravity: float, settings: MotionSettings
) -> Iterator[Toss]:
    def labelled(track: PoseTrack) -> tuple[Array, NDArray[np.uint8]]:
        assert track.v is not None
        return track.v, label_phases(model, track.t, track.q, track.v, gravity=gravity, settings=settings.phases)

    chosen = np.unique(np.linspace(0, len(tracks) - 1, min(settings.judged_tracks, len(tracks))).astype(int))
    sample = [tracks[i] for i in chosen]
    some = [q_cov[i] for i in chosen]
    smoothed = list(smooth_in_turn(sample, model, some, gravity=gravity, settings=settings.smoother))
    v, phase = zip(*(labelled(track) for track in sample), strict=True)
    v_cov = velocity_noise(
        np.concatenate(v), np.concatenate([s.v for s in smoothed]), np.concatenate(phase), settings=settings.noise
    )
    for track, cov in zip(tracks, q_cov, strict=True):
        own, phases = labelled(track)
        yield Toss(track.name, track.t, track.q, own, cov, v_cov[phases], phases)


def _label(model: ObjectModel, t: Array, s: Smoothed, gravity: float, settings: PhaseSettings) -> NDArray[np.uint8]:
    var = np.diagonal(s.v_cov, axis1=1, axis2=2)
    size = np.sqrt(var[:, :3].sum(axis=1) + gyration(model) ** 2 * var[:, 3:6].sum(axis=1))
    return label_phases(model, t, s.q, s.v, gravity=gravity, v_sigma=float(np.median(size)), settings=settings)


def _until_rest(toss: Toss, kept: float) -> Toss:
    moving = np.flatnonzero(toss.phase != Phase.REST)
    last = int(moving[-1]) + 1 if len(moving) else 0
    stop = max(2, int(np.searchsorted(toss.t, toss.t[min(last, len(toss) - 1)] + kept, side="right")))
    return toss.frames(slice(stop))
