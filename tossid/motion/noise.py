"""How noisy recorded poses and velocities are, from stretches of free flight.

In flight every coordinate is a smooth function of time, whatever the inertia and gravity: a cubic over a short window.
The residuals of a cubic are noise. In contact they would hold the contact too, and resting frames are less noisy than
moving ones (less motion blur, filters at rest), so windows of flight are used. Where a recording has too few, the
quieter half of all windows is used.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from tossid.errors import InputError
from tossid.motion.contact import Touch, may_touch
from tossid.objects import ObjectModel
from tossid.rotations import quat_boxminus
from tossid.settings.motion import NoiseSettings
from tossid.types import Phase, PoseTrack

Array = NDArray[np.float64]

DEGREE = 3
"""Of the polynomials."""
DEFAULT = NoiseSettings()


@dataclass(frozen=True, slots=True)
class PoseNoise:
    """Noise of recorded poses.

    Attributes:
        q_cov: Covariance of one pose in the tangent space, (nv, nv).
        source: What it was estimated from, in words.
    """

    q_cov: Array
    source: str


def pose_noise(
    tracks: Sequence[PoseTrack], model: ObjectModel, *, touch: Touch | None = None, settings: NoiseSettings = DEFAULT
) -> PoseNoise:
    """Covariance of the poses' noise, diagonal and the same for all frames.

    Args:
        tracks: Of one object.
        model: The object; its corners say where it flies.
        touch: Says it instead, of an object without corners.
        settings: Of the windows.

    Raises:
        InputError: No track has a window of frames.
    """
    window = settings.window
    flight = [r for track in tracks for r in _window_residuals(track, flight_runs(track, model, touch), window)]
    source = "flight residuals"
    if len(flight) < settings.fewest_windows:
        whole = [r for track in tracks for r in _window_residuals(track, [slice(0, len(track.t))], window)]
        if not whole:
            raise InputError(f"no track has {window} frames in a row: the noise of its poses cannot be estimated")
        size = np.array([np.abs(residuals[:, :3]).mean() for residuals in whole])
        flight = [residuals for residuals, s in zip(whole, size, strict=True) if s <= np.median(size)]
        source = "residuals of the quieter half of all windows"
    sigma = np.sqrt(_typical(np.stack([(residuals**2).sum(axis=0) for residuals in flight]), window - DEGREE - 1))
    # the three axes of a rotation have one noise
    sigma[3:6] = np.sqrt(np.mean(sigma[3:6] ** 2))
    sigma[:3] = np.maximum(sigma[:3], settings.least_position)
    sigma[3:] = np.maximum(sigma[3:], settings.least_angle)
    return PoseNoise(np.diag(sigma**2), source)


def flight_runs(track: PoseTrack, model: ObjectModel, touch: Touch | None = None) -> list[slice]:
    """Stretches of frames between which the object cannot touch the ground.

    Args:
        track: Its poses.
        model: The object.
        touch: Where it may touch, of an object without corners.
    """
    clear = ~(may_touch(model, track.t, track.q) if touch is None else touch(track.t, track.q))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], clear, [False]]).astype(int)))
    return [slice(int(a), int(b) + 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _window_residuals(track: PoseTrack, runs: Sequence[slice], window: int) -> Iterator[Array]:
    """Residuals (window, nv) of cubics in windows of frames."""
    for run in runs:
        for first in range(run.start, run.stop - window + 1, window):
            at = slice(first, first + window)
            yield cubic_residuals(track.t[at], track.q[at])


def _typical(sums: Array, dof: int) -> Array:
    """Variance (nv,) of residuals from their sums of squares (n_windows, nv): their median over that of χ²."""
    return np.median(sums, axis=0) / chi2.median(dof)


def cubic_residuals(t: Array, q: Array) -> Array:
    """Residuals (n, nv) of cubics in time through the tangent coordinates around a window's middle frame.

    Args:
        t: Times [s], (n,).
        q: Poses, (n, nq).
    """
    n = len(t)
    mid = q[n // 2]
    quat = np.broadcast_to(mid[3:7], (n, 4))
    coordinates = np.concatenate([q[:, :3] - mid[:3], quat_boxminus(q[:, 3:7], quat), q[:, 7:] - mid[7:]], axis=1)
    tau = (t - t.mean()) / np.ptp(t)
    basis = np.vander(tau, DEGREE + 1, increasing=True)
    weights, *_ = np.linalg.lstsq(basis, coordinates, rcond=None)
    return np.asarray(coordinates - basis @ weights)


def velocity_noise(
    recorded: Array, smoothed: Array, phase: NDArray[np.uint8], *, settings: NoiseSettings = DEFAULT
) -> Array:
    """Covariance of recorded velocities in each phase, from their distance to smoothed ones, (len(Phase), nv, nv).

    It is a second moment, not a variance: velocities that lag, as backward differences do by half a frame, are wrong by
    the lag too. A channel's standard deviation is the larger of its 68 % quantile and half its 95 % quantile, so that a
    few wrong frames do not set it and tails count. It is diagonal; phases with too few frames have that of all frames.

    Args:
        recorded: Velocities, (m, nv).
        smoothed: The same frames' smoothed velocities, (m, nv).
        phase: Of each frame, (m,).
        settings: Least noise, and how many frames are too few.
    """
    error = np.abs(recorded - smoothed)
    out = np.zeros((max(Phase) + 1, error.shape[1], error.shape[1]))
    for which in range(len(out)):
        of_phase = error[phase == which]
        if len(of_phase) < settings.fewest_frames:
            of_phase = error
        sigma = np.maximum(np.quantile(of_phase, 0.683, axis=0), np.quantile(of_phase, 0.954, axis=0) / 2)
        sigma[:3] = np.maximum(sigma[:3], settings.least_position)
        sigma[3:] = np.maximum(sigma[3:], settings.least_angle)
        out[which] = np.diag(sigma**2)
    return out
