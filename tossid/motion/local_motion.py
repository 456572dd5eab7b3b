"""Local fits of a track: velocity, acceleration, spin and noise of each frame, and stretches of free flight."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tossid.motion.stability import center_of_mass
from tossid.objects import ObjectModel, corner_heights
from tossid.rotations import quat_boxminus
from tossid.settings.segmentation import SegmentSettings
from tossid.types import PoseTrack

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

OUTLIER = 4.0
"""Residual over the noise from which one of a fit's frames may be an outlier; then it is fitted without one."""
INLIERS = 2.0
"""It is one if the rms residual of the others, fitted without it, is below this many times the noise."""


def scatter(third: Array) -> float:
    """Robust standard deviation of a quantity's noise: the third differences of smooth motion are far smaller.

    Args:
        third: Third differences, of any shape.
    """
    return float(1.4826 * np.median(np.abs(third)) / np.sqrt(20.0))


def local_parabolas(t: Array, x: Array, half: int, noise: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Velocity and acceleration at each frame, from a parabola through it and `half` frames on each side.

    Where one frame is an outlier of a parabola that fits all others, it is left out: one wrong pose is no acceleration.

    Args:
        t: Times [s], (n,).
        x: Positions [m], (n, 3).
        half: Frames on each side.
        noise: Standard deviation of x [m], (n,).

    Returns:
        Velocities [m/s] (n, 3), accelerations [m/s²] (n, 3), and which frames are outliers of their own parabola (n,).
    """
    n, width = len(t), 2 * half + 1
    first = np.clip(np.arange(n) - half, 0, max(n - width, 0))
    index = np.minimum(first[:, None] + np.arange(width), n - 1)
    s = t[index] - t[:, None]
    basis = np.stack([np.ones_like(s), s, 0.5 * s**2], axis=-1)
    fitted = np.linalg.pinv(basis) @ x[index]
    off = np.linalg.norm(x[index] - basis @ fitted, axis=-1)
    outlier = np.zeros(n, dtype=bool)
    suspect = np.flatnonzero(off.max(axis=1) > OUTLIER * noise) if n >= width > 4 else np.zeros(0, dtype=np.int64)
    if len(suspect):
        best = np.full(len(suspect), np.inf)
        for left_out in range(width):
            keep = np.delete(np.arange(width), left_out)
            B, X = basis[suspect][:, keep], x[index[suspect]][:, keep]
            again = np.linalg.pinv(B) @ X
            rms = np.sqrt(np.mean((X - B @ again) ** 2, axis=(1, 2)))
            better = (rms < INLIERS * noise[suspect]) & (rms < best)
            fitted[suspect[better]], best[better] = again[better], rms[better]
            outlier[suspect[better]] = index[suspect[better], left_out] == suspect[better]
    return fitted[:, 1], fitted[:, 2], outlier


def alone(flags: Bools) -> Bools:
    """Which true flags have no true neighbour, (n,).

    Args:
        flags: (n,).
    """
    padded = np.concatenate([[False], flags, [False]])
    return np.asarray(flags & ~padded[:-2] & ~padded[2:])


def runs(flags: Bools) -> Iterator[tuple[int, int]]:
    """First and last index of each run of true flags.

    Args:
        flags: (n,).

    Yields:
        Both, in order.
    """
    steps = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    yield from zip(steps[::2].tolist(), (steps[1::2] - 1).tolist(), strict=True)


class LocalMotion:
    """A track without long gaps, with velocity, acceleration, spin and noise of each frame, and its free flights.

    Attributes:
        model: The object.
        track: As recorded.
        t: Times [s], (n,).
        q: Configurations, (n, nq).
        com: The centre of mass [m], (n, 3).
        low: Height of the lowest corner [m], (n,).
        noise: Standard deviation of the centre of mass [m], (n,).
        turn_noise: Likewise of the attitude [rad], (n,).
        window: Half width of local fits, in frames.
        velocity: Of the centre of mass [m/s], (n, 3).
        acceleration: Likewise [m/s²], (n, 3).
        outlier: Frames beside the parabola of their neighbours, (n,).
        spin: Angular speed [rad/s], (n,).
        free: Frames in free fall, (n,).
        carried: Frames not in free fall, (n,); where the track is too noisy, a frame is neither.
    """

    def __init__(
        self,
        model: ObjectModel,
        track: PoseTrack,
        dt: float,
        gravity: float,
        gyration2: float,
        settings: SegmentSettings,
    ) -> None:
        """Fit parabolas to each frame's neighbours.

        Args:
            model: The object.
            track: Without long gaps.
            dt: Median time step [s].
            gravity: [m/s²].
            gyration2: Largest squared radius of gyration of a body [m²].
            settings: What counts as flight.
        """
        t, q, q_cov = track.t, track.q, track.q_cov
        com = center_of_mass(model, q)
        self.model, self.track, self.t, self.com, self.q = model, track, t, com, q
        self.low = corner_heights(model, q).min(axis=1)
        self.dt, self.gravity, self.gyration2, self.settings = dt, gravity, gyration2, settings
        # the track's own noise, and at least that of its third differences
        turn = quat_boxminus(q[1:, 3:7], q[:-1, 3:7])
        self.noise = np.full(len(t), scatter(np.diff(com, n=3, axis=0)))
        self.turn_noise = np.full(len(t), scatter(np.diff(turn, n=2, axis=0)))
        if q_cov is not None:
            self.noise = np.maximum(self.noise, np.sqrt(np.linalg.eigvalsh(q_cov[:, :3, :3])[:, -1]))
            self.turn_noise = np.maximum(self.turn_noise, np.sqrt(np.linalg.eigvalsh(q_cov[:, 3:6, 3:6])[:, -1]))
        self.window = max(round(0.5 * settings.min_flight / dt), 3)  # half width of local fits
        self.velocity, self.acceleration, self.outlier = local_parabolas(t, com, self.window, self.noise)
        self.spin = self._spin()
        # three standard deviations of an acceleration: of a quadratic fit to N frames its variance is 720 / N⁵
        spread = 3 * np.sqrt(720.0 / (2 * self.window + 1) ** 5) * self.noise / dt**2
        off = np.linalg.norm(self.acceleration + np.array([0.0, 0.0, gravity]), axis=1)
        certain = spread < settings.noisy_acceleration
        self.free = certain & (off < settings.flight_acceleration + spread)
        self.carried = certain & ~self.free

    def _spin(self) -> Array:
        """Angular speed over a few frames [rad/s]. (n,)."""
        k = min(self.window, len(self.t) // 2)
        rate = np.linalg.norm(quat_boxminus(self.q[2 * k :, 3:7], self.q[: -2 * k, 3:7]), axis=1)
        rate = rate / (self.t[2 * k :] - self.t[: -2 * k])
        return np.concatenate([np.repeat(rate[:1], k), rate, np.repeat(rate[-1:], k)])

    def flights(self, a: int, b: int) -> list[tuple[int, int]]:
        """First and last frames of the free flights from one frame to another.

        Args:
            a: First frame.
            b: Last frame.
        """
        settings = self.settings
        flights: list[tuple[int, int]] = []
        for first, last in runs(self.free[a : b + 1]):
            core = (a + first, a + last)
            if flights and core[0] <= flights[-1][1]:
                core = (flights[-1][1] + 1, core[1])
            if core[1] - core[0] < 1:
                continue
            grown = self._grow(*core, a, b)
            if (self.t[grown[1]] - self.t[grown[0]]) >= settings.min_flight:
                flights.append(grown)
        return flights

    def _grow(self, first: int, last: int, a: int, b: int) -> tuple[int, int]:
        """Extend a flight frame by frame while the parabola of its nearest frames predicts the next.

        One frame that is off the parabola is skipped if the frame after it is on it again.
        """
        mean = self.acceleration[first : last + 1].mean(axis=0)
        limit = float(np.clip(5 * np.median(self.noise[first : last + 1]), 2.5e-4, 2e-3))
        # the local fits at both ends may use frames outside the flight
        first, last = self._shrink(first, last, mean, limit)
        near = max(3 * self.window, 9)
        for step in (-1, 1):
            while True:
                edge = first if step < 0 else last
                if step < 0:
                    own = slice(first, min(first + near, last + 1))
                else:
                    own = slice(max(last + 1 - near, first), last + 1)
                for ahead in (edge + step, edge + 2 * step):
                    if a <= ahead <= b and self._off(own, ahead, mean) <= 1.6 * limit:
                        first, last = min(first, ahead), max(last, ahead)
                        break
                else:
                    break
        return first, last

    def _off(self, own: slice, frame: int, acceleration: Array) -> float:
        """Distance [m] of a frame from the parabola through others."""
        return float(np.linalg.norm(self._predict(own, self.t[frame], acceleration) - self.com[frame]))

    def _shrink(self, first: int, last: int, mean: Array, limit: float) -> tuple[int, int]:
        while last - first >= 4:
            own = slice(first, last + 1)
            fitted = np.stack([self._predict(own, time, mean) for time in (self.t[first], self.t[last])])
            off = np.linalg.norm(fitted - self.com[[first, last]], axis=1)
            if (off <= limit).all():
                break
            first, last = (first + 1, last) if off[0] >= off[1] else (first, last - 1)
        return first, last

    def _predict(self, own: slice, time: float, acceleration: Array) -> Array:
        """Position at a time on the parabola of given acceleration through frames of the flight."""
        good = np.arange(own.start, own.stop)[~self.outlier[own]]
        s = self.t[good] - time
        rest = self.com[good] - 0.5 * acceleration * s[:, None] ** 2
        basis = np.stack([np.ones_like(s), s], axis=1)
        return np.asarray(np.linalg.lstsq(basis, rest, rcond=None)[0][0])
