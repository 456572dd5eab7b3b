"""How noisy recorded poses and velocities are, from stretches of free flight.

In flight every coordinate is a smooth function of time, whatever the inertia and gravity: a cubic over a short window.
The residuals of a cubic are noise. In contact they would hold the contact too, and resting frames are less noisy than
moving ones (less motion blur, filters at rest), so windows of flight are used. Where a recording has too few, the
quieter half of all windows is used.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from tossid.errors import InputError
from tossid.motion.contact import Touch, may_touch, runs
from tossid.motion.flight import fit_polynomial
from tossid.objects import ObjectModel
from tossid.robust import NORMAL_MAD
from tossid.rotations import quat_boxminus
from tossid.types import Phase, PoseTrack

Array = NDArray[np.float64]

DEGREE = 3
"""Of the polynomials."""
WINDOW = 10
"""Frames that a cubic is fitted to."""
FEWEST_WINDOWS = 8
"""Windows of flight below which the quieter half of all windows is used."""
FEWEST_FRAMES = 30
"""Frames of a phase below which it has no velocity noise of its own."""
LEAST_POSITION, LEAST_ANGLE = 1e-7, 1e-6
"""Least standard deviations of positions [m] and angles [rad], and of their rates: exact data would make covariances
singular."""


def scatter(third: Array) -> float:
    """Robust standard deviation of a quantity's noise, rms over its axes; third differences of motion are far smaller.

    Axis by axis: what one camera sees is ten times as noisy along its view as across.

    Args:
        third: Third differences (n, d); those of white noise have 20 times its variance.
    """
    size = NORMAL_MAD * np.median(np.abs(third), axis=0)
    return float(np.sqrt(np.mean(size**2) / 20.0))


def frame_noise(track: PoseTrack, com: Array) -> tuple[Array, Array]:
    """Standard deviations of positions [m] and attitudes [rad] of a track's frames, (n,) each.

    From third differences, and at least along the axis that the track's own covariance says is the worst.

    Args:
        track: The track.
        com: Its centre of mass [m], (n, 3).
    """
    turn = quat_boxminus(track.q[1:, 3:7], track.q[:-1, 3:7])
    out = []
    for third, own in ((np.diff(com, n=3, axis=0), slice(0, 3)), (np.diff(turn, n=2, axis=0), slice(3, 6))):
        noise = np.full(len(com), scatter(third))
        if track.q_cov is not None:
            noise = np.maximum(noise, np.sqrt(np.linalg.eigvalsh(track.q_cov[:, own, own])[:, -1]))
        out.append(noise)
    return out[0], out[1]


def pose_noise(tracks: Sequence[PoseTrack], model: ObjectModel, *, touch: Touch | None = None) -> Array:
    """Covariance of the poses' noise in the tangent space (nv, nv), diagonal and the same for all frames.

    Args:
        tracks: Of one object.
        model: The object; its corners say where it flies.
        touch: Says it instead, of an object without corners.

    Raises:
        InputError: No track has a window of frames.
    """
    flight = []
    for track in tracks:
        clear = ~(may_touch(model, track.t, track.q) if touch is None else touch(track.t, track.q))
        for first, last in runs(clear):
            flight += _window_residuals(track, first, last + 2)
    if len(flight) < FEWEST_WINDOWS:
        whole = [r for track in tracks for r in _window_residuals(track, 0, len(track.t))]
        if not whole:
            raise InputError(f"no track has {WINDOW} frames in a row: the noise of its poses cannot be estimated")
        size = np.array([np.abs(residuals[:, :3]).mean() for residuals in whole])
        flight = [residuals for residuals, s in zip(whole, size, strict=True) if s <= np.median(size)]
    # the median of the windows' sums of squares, over that of χ²: a few windows with contact do not count
    sums = np.stack([(residuals**2).sum(axis=0) for residuals in flight])
    sigma = np.sqrt(np.median(sums, axis=0) / chi2.median(WINDOW - DEGREE - 1))
    sigma[3:6] = np.sqrt(np.mean(sigma[3:6] ** 2))  # the three axes of a rotation have one noise
    return np.asarray(np.diag(_at_least(sigma) ** 2))


def velocity_noise(recorded: Array, smoothed: Array, phase: NDArray[np.uint8]) -> Array:
    """Covariance of recorded velocities in each phase, from their distance to smoothed ones, (len(Phase), nv, nv).

    It is a second moment, not a variance: velocities that lag, as backward differences do by half a frame, are wrong by
    the lag too. A channel's standard deviation is the larger of its 68 % quantile and half its 95 % quantile, so that a
    few wrong frames do not set it and tails count. It is diagonal; phases with too few frames have that of all frames.

    Args:
        recorded: Velocities, (m, nv).
        smoothed: The same frames' smoothed velocities, (m, nv).
        phase: Of each frame, (m,).
    """
    error = np.abs(recorded - smoothed)
    out = []
    for which in range(max(Phase) + 1):
        own = phase == which
        of_phase = error[own] if own.sum() >= FEWEST_FRAMES else error
        sigma = np.maximum(np.quantile(of_phase, 0.683, axis=0), np.quantile(of_phase, 0.954, axis=0) / 2)
        out.append(np.diag(_at_least(sigma) ** 2))
    return np.array(out)


def _at_least(sigma: Array) -> Array:
    return np.maximum(sigma, np.where(np.arange(len(sigma)) < 3, LEAST_POSITION, LEAST_ANGLE))


def _window_residuals(track: PoseTrack, start: int, stop: int) -> list[Array]:
    """Residuals (WINDOW, nv) of cubics through the tangent coordinates around the middle of each window of frames."""
    count = max(0, (stop - start) // WINDOW)
    if not count:
        return []
    rows = start + np.arange(count * WINDOW).reshape(count, WINDOW)
    t, q = track.t[rows], track.q[rows]
    mid = q[:, WINDOW // 2, None]
    turned = quat_boxminus(q[..., 3:7], mid[..., 3:7])
    coordinates = np.concatenate([q[..., :3] - mid[..., :3], turned, q[..., 7:] - mid[..., 7:]], axis=-1)
    return list(fit_polynomial(t - t.mean(axis=1, keepdims=True), coordinates, DEGREE).residuals)
