"""Scatter of the poses of resting objects: errors that do not change from frame to frame.

A tracker's calibration, or uneven ground, shifts and tilts an object that lies flat by another amount in every place
and on every face. The noise of single frames does not show this.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import median_abs_deviation

from tossid.objects import ObjectModel, corner_positions
from tossid.rotations import quat_conj, quat_rotate
from tossid.settings.motion import RestScatterSettings
from tossid.types import Toss

Array = NDArray[np.float64]

DEFAULT = RestScatterSettings()


def rest_scatter(
    tosses: Sequence[Toss], model: ObjectModel, *, over_order: bool = False, settings: RestScatterSettings = DEFAULT
) -> tuple[float, float]:
    """Standard deviations, beyond noise, of the height [m] and the tilt [rad] at which an object comes to rest.

    A plane is fitted to the corners that touch. Heights are residuals of one plane through all places of rest and, with
    enough tosses, of an offset of the recorded frame in the body. Slopes are residuals of their median. So a wrong
    size, a tilted ground and a wrong frame are no scatter. Zeros where too few tosses end at rest, or where the scatter
    is that of the noise.

    Over the order of recording, neighbours are compared instead (von Neumann 1941), of which a change between sessions
    or a drift moves few or hardly any. What such a change does to all tosses together is no scatter then.

    Args:
        tosses: With measured poses.
        model: The object.
        over_order: Whether the tosses come in the order of recording, and neighbours are compared.
        settings: What is at rest, and what is noise.
    """
    n_frames = settings.frames
    places, downs, slopes, noises = [], [], [], []
    for toss in tosses:
        q, cov = toss.measured
        if len(q) < n_frames:
            continue
        last, std = q[-n_frames:], np.sqrt(np.einsum("nii->ni", cov[-n_frames:]).mean(0))
        if np.abs(last[:, :3] - np.median(last[:, :3], axis=0)).max() > settings.still_sigmas * max(
            float(std[:3].max()), 1e-6
        ):
            continue
        corners = np.median(corner_positions(model, last), axis=0)
        low = corners[corners[:, 2] < corners[:, 2].min() + settings.touching_height * model.width]
        A = np.column_stack([np.ones(len(low)), low[:, :2] - low[:, :2].mean(0)])
        if len(low) < 3 or np.linalg.cond(A.T @ A) > 1e6:
            continue
        height, *slope = np.linalg.lstsq(A, low[:, 2], rcond=None)[0]
        places.append([*low[:, :2].mean(0), height])
        downs.append(np.median(quat_rotate(quat_conj(last[:, 3:7]), np.array([0.0, 0.0, -1.0])), axis=0))
        slopes.append(slope)
        noises.append([std[2], std[3:5].max()])
    if len(places) < settings.fewest_tosses:
        return 0.0, 0.0
    height = _scatter(np.array(places), np.array(downs), settings.fewest_tosses, over_order=over_order)
    off = np.diff(slopes, axis=0) / np.sqrt(2) if over_order else slopes - np.median(slopes, axis=0)
    tilt = median_abs_deviation(off, axis=None, scale="normal")
    noise = np.mean(noises, axis=0) / np.sqrt(n_frames)
    found = [
        float(np.sqrt(size**2 - small**2)) if size > settings.noise_ratio * small else 0.0
        for size, small in zip((height, tilt), noise, strict=True)
    ]
    return found[0], found[1]


def _scatter(places: Array, downs: Array, fewest: int, *, over_order: bool) -> float:
    """Robust scatter of the heights of places (n, 3) about a plane and, with enough tosses, an offset in the body.

    downs: the downward direction in the body's axes, (n, 3). Over the order, of the differences between neighbours.
    """
    shared = [np.ones(len(places)), places[:, 0], places[:, 1]]
    if len(places) >= 2 * fewest:
        shared += list(downs.T)
    A, heights = np.column_stack(shared), places[:, 2]
    if over_order:
        A, heights = np.diff(A[:, 1:], axis=0) / np.sqrt(2), np.diff(heights) / np.sqrt(2)
    kept = np.ones(len(heights), bool)
    for _ in range(3):
        off: Array = heights - A @ np.linalg.lstsq(A[kept], heights[kept], rcond=1e-3)[0]
        kept = np.abs(off) <= 3 * median_abs_deviation(off, scale="normal")
    return float(median_abs_deviation(off, scale="normal"))
