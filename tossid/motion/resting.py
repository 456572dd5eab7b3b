"""How far poses of resting objects scatter: errors that do not change from frame to frame.

A tracker's calibration, or uneven ground, puts an object that lies flat a little above the ground or below, and tilts
it, differently in every place and on every face. No single frame's noise says so.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import median_abs_deviation

from tossid.objects import ObjectModel, corner_positions
from tossid.rotations import quat_conj, quat_rotate
from tossid.types import Toss

Array = NDArray[np.float64]

FRAMES = 8
"""Last frames of a toss in which it has to lie still."""
STILL = 6.0
"""Standard deviations of noise within which it does."""
TOUCHING_REL = 0.05
"""Of the object's width: how much higher than its lowest corner a resting object's others are that touch."""
FEWEST = 6
"""Resting tosses that are enough for a scatter."""
CLEAR = 2.0
"""Scatter over that of the noise below which it counts as noise."""


def rest_scatter(tosses: Sequence[Toss], model: ObjectModel) -> tuple[float, float]:
    """Standard deviations, beyond noise, of the height [m] and the tilt [rad] at which an object comes to rest.

    A plane is laid through the corners that touch. Heights are taken over one plane through all tosses' places, and
    over what an offset of the recorded frame in the body makes of each side that is down; slopes against their median:
    a wrong size, a tilted ground or a wrong frame is no scatter. Zeros where fewer than `FEWEST` tosses end at rest, or
    where the scatter is that of the noise.
    """
    places, downs, slopes, noises = [], [], [], []
    for toss in tosses:
        q, cov = toss.measured
        if len(q) < FRAMES:
            continue
        last, std = q[-FRAMES:], np.sqrt(np.einsum("nii->ni", cov[-FRAMES:]).mean(0))
        if np.abs(last[:, :3] - np.median(last[:, :3], axis=0)).max() > STILL * max(float(std[:3].max()), 1e-6):
            continue
        corners = np.median(corner_positions(model, last), axis=0)
        low = corners[corners[:, 2] < corners[:, 2].min() + TOUCHING_REL * model.width]
        A = np.column_stack([np.ones(len(low)), low[:, :2] - low[:, :2].mean(0)])
        if len(low) < 3 or np.linalg.cond(A.T @ A) > 1e6:
            continue
        height, *slope = np.linalg.lstsq(A, low[:, 2], rcond=None)[0]
        places.append([*low[:, :2].mean(0), height])
        downs.append(np.median(quat_rotate(quat_conj(last[:, 3:7]), np.array([0.0, 0.0, -1.0])), axis=0))
        slopes.append(slope)
        noises.append([std[2], std[3:5].max()])
    if len(places) < FEWEST:
        return 0.0, 0.0
    height = _scatter(np.array(places), np.array(downs))
    tilt = median_abs_deviation(slopes - np.median(slopes, axis=0), axis=None, scale="normal")
    noise = np.mean(noises, axis=0) / np.sqrt(FRAMES)
    found = [
        float(np.sqrt(size**2 - small**2)) if size > CLEAR * small else 0.0
        for size, small in zip((height, tilt), noise, strict=True)
    ]
    return found[0], found[1]


def _scatter(places: Array, downs: Array) -> float:
    """Of heights of places (n, 3) over what fits most: a plane and, if tosses are enough, an offset in the body;
    downs (n, 3): the downward direction in its axes."""
    shared = [np.ones(len(places)), places[:, 0], places[:, 1]]
    if len(places) >= 2 * FEWEST:
        shared += list(downs.T)
    A, kept = np.column_stack(shared), np.ones(len(places), bool)
    for _ in range(3):
        off: Array = places[:, 2] - A @ np.linalg.lstsq(A[kept], places[kept, 2], rcond=1e-3)[0]
        kept = np.abs(off) <= 3 * median_abs_deviation(off, scale="normal")
    return float(median_abs_deviation(off, scale="normal"))
