"""Local fits of a track: velocity, acceleration, spin and noise of each frame, and stretches of free flight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.motion.contact import lowest_corner, runs
from tossid.motion.flight import acceleration_deviation, half_width, local_parabolas
from tossid.motion.kinematics import center_of_mass
from tossid.motion.noise import frame_noise
from tossid.objects import ObjectModel
from tossid.rotations import quat_boxminus
from tossid.types import PoseTrack

Array = NDArray[np.float64]

MIN_FLIGHT = 0.04
"""Shortest free flight [s]."""
CERTAIN, LONGEST = 0.8, 0.12
"""Local fits are so long that accelerations have this standard deviation [m/s²], and no longer than this [s]."""
SLOW = 0.15
"""They have at least three frames on each side, and two where three would span more than this [s]."""
FLIGHT_ACCELERATION = 3.5
"""Deviation from gravity that is still free flight [m/s²]."""
NOISY_ACCELERATION = 5.0
"""Where three standard deviations of an acceleration are more than this [m/s²], it shows neither flight nor a hand."""
ON_PARABOLA = (2.5e-4, 1e-2)
"""Distance within which a frame is on a flight's parabola: five times the noise, within these limits [m]."""


class LocalMotion:
    """A track without long gaps, with velocity, acceleration, spin and noise of each frame, and its free flights.

    Args:
        model: The object.
        track: Without long gaps.
        dt: Median time step [s].
        gravity: [m/s²].

    Attributes:
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

    def __init__(self, model: ObjectModel, track: PoseTrack, dt: float, gravity: float) -> None:
        t, q = track.t, track.q
        self.model, self.track, self.t, self.q = model, track, t, q
        self.dt, self.gravity = dt, gravity
        self.com, self.low = center_of_mass(model, q), lowest_corner(model, q)
        self.noise, self.turn_noise = frame_noise(track, self.com)
        fewest, noise = 3 if 6 * dt < SLOW else 2, float(np.median(self.noise))
        least = max(round(0.5 * MIN_FLIGHT / dt), fewest)
        self.window = half_width(noise, dt, least=least, certain=CERTAIN, longest=LONGEST)
        self.velocity, self.acceleration, self.outlier = local_parabolas(t, self.com, self.window, self.noise)
        k = min(self.window, len(t) // 2)
        rate = np.linalg.norm(quat_boxminus(q[2 * k :, 3:7], q[: -2 * k, 3:7]), axis=1) / (t[2 * k :] - t[: -2 * k])
        self.spin = np.pad(rate, k, mode="edge")
        spread = 3 * acceleration_deviation(self.noise, self.window, dt)
        off = np.linalg.norm(self.acceleration + np.array([0.0, 0.0, gravity]), axis=1)
        certain = spread < NOISY_ACCELERATION
        self.free = certain & (off < FLIGHT_ACCELERATION + spread)
        self.carried = certain & ~self.free

    def flights(self, a: int, b: int) -> list[tuple[int, int]]:
        """First and last frames of the free flights from one frame to another.

        Args:
            a: First frame.
            b: Last frame.
        """
        flights: list[tuple[int, int]] = []
        for first, last in runs(self.free[a : b + 1]):
            begin, end = a + first, a + last
            if flights:
                begin = max(begin, flights[-1][1] + 1)
            if end - begin < 1:
                continue
            begin, end = self._grown(begin, end, a, b)
            if self.t[end] - self.t[begin] >= MIN_FLIGHT:
                flights.append((begin, end))
        return flights

    def _grown(self, first: int, last: int, a: int, b: int) -> tuple[int, int]:
        """A flight extended frame by frame while the parabola of its nearest frames predicts the next.

        One frame that is off the parabola is skipped if the frame after it is on it again.
        """
        mean = self.acceleration[first : last + 1].mean(axis=0)
        limit = float(np.clip(5 * np.median(self.noise[first : last + 1]), *ON_PARABOLA))
        # the local fits at both ends may use frames outside the flight
        while last - first >= 4:
            off = [self._off(slice(first, last + 1), frame, mean) for frame in (first, last)]
            if max(off) <= limit:
                break
            first, last = (first + 1, last) if off[0] >= off[1] else (first, last - 1)
        near = max(3 * self.window, 9)
        for step in (-1, 1):
            grows = True
            while grows:
                edge = first if step < 0 else last
                own = (
                    slice(first, min(first + near, last + 1))
                    if step < 0
                    else slice(max(last + 1 - near, first), last + 1)
                )
                ahead = [frame for frame in (edge + step, edge + 2 * step) if a <= frame <= b]
                found = next((frame for frame in ahead if self._off(own, frame, mean) <= 1.6 * limit), None)
                grows = found is not None
                if found is not None:
                    first, last = min(first, found), max(last, found)
        return first, last

    def _off(self, own: slice, frame: int, acceleration: Array) -> float:
        """Distance [m] of a frame from the parabola of given acceleration through frames of the flight."""
        good = np.arange(own.start, own.stop)[~self.outlier[own]]
        s = self.t[good] - self.t[frame]
        line = self.com[good] - 0.5 * acceleration * s[:, None] ** 2
        basis = np.stack([np.ones_like(s), s], axis=1)  # (of fewer than two good frames, the shortest solution)
        return float(np.linalg.norm(np.linalg.lstsq(basis, line, rcond=None)[0][0] - self.com[frame]))
