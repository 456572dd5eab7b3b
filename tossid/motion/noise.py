"""How noisy recorded poses and velocities are, from stretches of free flight.

In flight every coordinate is a smooth function of time, whatever the object's
inertia and the gravity: a cubic over a short window. What a cubic leaves is
noise. Windows in contact would take the contact itself for noise, and resting
frames are less noisy than moving ones (less motion blur, filters at rest), so
flight is preferred; where a recording has too little of it, the quieter half
of all windows serves.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from tossid.errors import InputError
from tossid.motion.contact import may_touch
from tossid.objects import ObjectModel
from tossid.rotations import quat_boxminus
from tossid.types import Phase, PoseTrack

Array = NDArray[np.float64]

WINDOW = 10
"""Frames a window."""
DEGREE = 3
LEAST_WINDOWS = 8
"""Windows of flight below which all windows serve."""
LEAST_FRAMES = 30
"""Frames of a phase below which it has no velocity noise of its own."""
LEAST_SIGMA = (1e-7, 1e-6)
"""Of positions and angles (a second, of velocities); exact synthetic data would make covariances singular."""


@dataclass(frozen=True, slots=True)
class PoseNoise:
    """Covariance of a pose measurement (nv, nv), what it was found from, and from how many windows."""

    q_cov: Array
    source: str
    n_windows: int


def pose_noise(tracks: Sequence[PoseTrack], model: ObjectModel) -> PoseNoise:
    """Covariance of the poses' noise, the same for all frames, without correlation between channels.

    Raises:
        InputError: no track has a window of frames.
    """
    flight = [residuals for track in tracks for residuals in _window_residuals(track, flight_runs(track, model))]
    source = "flight residuals"
    if len(flight) < LEAST_WINDOWS:
        whole = [residuals for track in tracks for residuals in _window_residuals(track, [slice(0, len(track.t))])]
        if not whole:
            raise InputError(f"no track has {WINDOW} frames in a row: the noise of its poses cannot be estimated")
        size = np.array([np.abs(residuals[:, :3]).mean() for residuals in whole])
        flight = [residuals for residuals, s in zip(whole, size, strict=True) if s <= np.median(size)]
        source = "residuals of the quieter half of all windows"
    sigma = np.sqrt(_typical(np.stack([(residuals**2).sum(axis=0) for residuals in flight]), WINDOW - DEGREE - 1))
    # axes of one rotation are alike; a channel that never moved tells nothing
    sigma[3:6] = np.sqrt(np.mean(sigma[3:6] ** 2))
    sigma[:3] = np.maximum(sigma[:3], LEAST_SIGMA[0])
    sigma[3:] = np.maximum(sigma[3:], LEAST_SIGMA[1])
    return PoseNoise(np.diag(sigma**2), source, len(flight))


def flight_runs(track: PoseTrack, model: ObjectModel) -> list[slice]:
    """Stretches of frames between which the object cannot touch the ground."""
    clear = ~may_touch(model, track.t, track.q)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], clear, [False]]).astype(int)))
    return [slice(int(a), int(b) + 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _window_residuals(track: PoseTrack, runs: Sequence[slice]) -> Iterator[Array]:
    """Residuals (WINDOW, nv) of cubics in windows of frames."""
    for run in runs:
        for first in range(run.start, run.stop - WINDOW + 1, WINDOW):
            at = slice(first, first + WINDOW)
            yield LocalFit(track.t[at], track.q[at]).residuals


def _typical(sums: Array, dof: int) -> Array:
    """Variance (nv,) of residuals from their sums of squares (n_windows, nv): a median, so that few windows
    that hold a glitch do not matter, divided by the median of χ²."""
    return np.median(sums, axis=0) / chi2.median(dof)


class LocalFit:
    """A cubic in time through the tangent coordinates around a window's middle frame.

    Attributes:
        residuals: (n, nv), of the coordinates.
    """

    def __init__(self, t: Array, q: Array) -> None:
        n = len(t)
        mid = q[n // 2]
        quat = np.broadcast_to(mid[3:7], (n, 4))
        coordinates = np.concatenate([q[:, :3] - mid[:3], quat_boxminus(q[:, 3:7], quat), q[:, 7:] - mid[7:]], axis=1)
        tau = (t - t.mean()) / np.ptp(t)
        basis = np.vander(tau, DEGREE + 1, increasing=True)
        weights, *_ = np.linalg.lstsq(basis, coordinates, rcond=None)
        fitted = basis @ weights
        self.residuals = coordinates - fitted


def velocity_noise(recorded: Array, smoothed: Array, phase: NDArray[np.uint8]) -> Array:
    """Covariance of recorded velocities in each phase, from their distance to smoothed ones.

    It is a second moment, not a variance: recorded velocities that lag (as
    backward differences do, by half a frame) are wrong by that lag too. Each
    channel's standard deviation is the larger of its 68 % quantile and half
    its 95 % quantile, so that a few glitches do not set it and tails count.

    Args:
        recorded, smoothed: (m, nv). phase: (m,).

    Returns:
        (len(Phase), nv, nv), diagonal; phases with too few frames have that of all frames.
    """
    error = np.abs(recorded - smoothed)
    out = np.zeros((max(Phase) + 1, error.shape[1], error.shape[1]))
    for which in range(len(out)):
        of_phase = error[phase == which]
        if len(of_phase) < LEAST_FRAMES:
            of_phase = error
        sigma = np.maximum(np.quantile(of_phase, 0.683, axis=0), np.quantile(of_phase, 0.954, axis=0) / 2)
        sigma[:3] = np.maximum(sigma[:3], LEAST_SIGMA[0])
        sigma[3:] = np.maximum(sigma[3:], LEAST_SIGMA[1])
        out[which] = np.diag(sigma**2)
    return out
