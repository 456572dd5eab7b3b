"""Recordings of a planar die: poses, stretches of flight, lost frames, and where the die rests."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CLEAR = 2e-3
"""Height of the lowest corner of a sharp die above which it flies [m]."""
TURNING = 1e-3
"""Steps of the centre down, then up, between which there was an impact, wherever the corners are [m]."""
SHORTEST = 5
"""Frames of the shortest stretch of flight."""
SEEN = 1e-3
"""Displacement between frames from which lost frames are seen in it [m]: the others are near the top of a flight."""
ALIKE = 0.25
"""Largest difference of a displacement, divided by a whole number, from its neighbours', as a share of theirs."""
AT_REST = 25
"""Frames at the end of a recording in which the die rests."""
STILL = np.array([2e-3, 1e-2])
"""How far a die moves along the floor [m] and turns [rad] at most while it rests."""


@dataclass(frozen=True)
class Drop:
    """A drop: times (n,), tracked point's x and z (n,), and the angle about y (n,), without turns."""

    name: str
    t: Array
    x: Array
    z: Array
    angle: Array

    @property
    def dt(self) -> float:
        """Time between frames [s]."""
        return float(np.median(np.diff(self.t)))


def read_drop(path: Path) -> Drop:
    """A drop of a TUM file whose motion lies in the x-z plane."""
    rows = np.loadtxt(path)
    return Drop(path.stem, rows[:, 0], rows[:, 1], rows[:, 3], np.unwrap(2 * np.arctan2(rows[:, 5], rows[:, 7])))


def turned(angle: Array | float, points: Array) -> Array:
    """(..., 2) points of the body, along x and z, turned about y by angles (...)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * points[..., 0] + s * points[..., 1], -s * points[..., 0] + c * points[..., 1]], axis=-1)


SIGNS = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
"""(4, 2) on which side of the centre each corner is."""


def flights(drop: Drop, half: Array) -> list[slice]:
    """Stretches of frames in which no corner of a sharp die is near the floor, without their ends.

    A frame about which the centre turns from falling to rising is that of an impact, also where no pose near the floor
    was recorded. The first frame of a recording is left out (docs/results/by-hand.md). Halves of sides are (2,) [m].
    """
    corners = turned(drop.angle[:, None], half * SIGNS)
    flying = drop.z + corners[..., 1].min(axis=1) > CLEAR
    steps = np.diff(drop.z)
    falls, rises = steps < -TURNING, steps > TURNING
    flying[2:-2] &= ~((falls[:-3] | falls[1:-2]) & (rises[2:-1] | rises[3:]))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flying.astype(int), [0]])))
    found = (slice(int(begin) + 1, int(end) - 1) for begin, end in zip(edges[::2], edges[1::2], strict=True))
    return [each for each in found if each.stop - each.start >= SHORTEST]


def lost_in_flight(drop: Drop, half: Array) -> NDArray[np.int64]:
    """(n - 1,) how many frames are missing between two that follow each other in flight.

    A displacement (x, z, and the angle times half of a side) is compared with the median of those around it. Where it
    is a whole multiple of that, in all three alike, frames are missing.
    """
    lost = np.zeros(len(drop.t) - 1, dtype=np.int64)
    steps = np.diff(np.column_stack([drop.x, drop.z, half.mean() * drop.angle]), axis=0)
    for flight in flights(drop, half):
        for i in range(flight.start, flight.stop - 1):
            usual = np.median(steps[max(i - 3, flight.start) : min(i + 4, flight.stop - 1)], axis=0)
            size = float(np.linalg.norm(usual))
            times = round(float(steps[i] @ usual) / max(size, SEEN) ** 2)
            if size > SEEN and times > 1 and np.linalg.norm(steps[i] / times - usual) < ALIKE * size:
                lost[i] = times - 1
    return lost


def with_true_times(drop: Drop, lost: NDArray[np.int64]) -> Drop:
    """The drop with times in which missing frames (n - 1,) are counted."""
    return replace(drop, t=drop.t + drop.dt * np.concatenate([[0], np.cumsum(lost)]))


def rest(drop: Drop) -> tuple[int, float] | None:
    """The face on which the die rests (quarters of a turn about y), and its height [m]; None if it is not flat."""
    end = slice(-AT_REST, None)
    angle = float(np.median(drop.angle[end]))
    quarters = round(angle / (np.pi / 2))
    moved = np.array([np.ptp(drop.x[end]), np.ptp(drop.angle[end])])
    if (moved > STILL).any() or abs(angle - quarters * np.pi / 2) > STILL[1]:
        return None
    return quarters % 4, float(np.median(drop.z[end]))


def heights_by_face(drops: list[Drop]) -> Array:
    """(4,) median height at rest on each face [m]."""
    found = [each for each in map(rest, drops) if each is not None]
    return np.array([np.median([z for face, z in found if face == k]) for k in range(4)])


def halves(heights: Array, half: float) -> Array:
    """(2,) halves of the sides along the body's x and z [m].

    Heights at rest on each face (4,) tell their difference, as the floor's own height is not known.

    Args:
        heights: At rest on each face [m].
        half: Of the mean side [m].
    """
    return np.array([heights[[1, 3]].mean(), heights[[0, 2]].mean()]) - heights.mean() + half


def floor_of(drop: Drop, half: Array) -> float:
    """Height of the floor under the die at rest [m]; NaN if it does not rest flat."""
    found = rest(drop)
    return np.nan if found is None else found[1] - half[1 - found[0] % 2]
