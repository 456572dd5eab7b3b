"""Where windows begin and end in a toss, on the clock of its camera, of which frames may be missing."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.states import difference
from tossid.motion.flight import flight_frames
from tossid.objects import GRAVITY, ObjectModel
from tossid.settings.diagnosis.likelihood import WindowSettings
from tossid.types import Phase, Toss

Array = NDArray[np.float64]


def pose_std(cov: Array) -> Array:
    """(n, K) standard deviations of poses.

    Args:
        cov: (n, K, K) their covariances.
    """
    out: Array = np.sqrt(np.maximum(np.einsum("nii->ni", cov), 0.0))
    return out


@dataclass(frozen=True)
class FrameClock:
    """The frames of a toss on a camera's clock.

    Attributes:
        tick: (n,) place of each frame.
        breaks: Frames after which too many are missing, or time is uneven.
        dt: Between ticks [s].
    """

    tick: NDArray[np.int64]
    breaks: NDArray[np.int64]
    dt: float

    @classmethod
    def of(cls, toss: Toss, dt: float, most: int, tolerance: float) -> FrameClock:
        """The clock of a toss.

        Args:
            toss: The toss.
            dt: Between ticks [s].
            most: Ticks of a time step, beyond which it is a break.
            tolerance: Share of a tick by which a time step may miss a whole number.
        """
        tick, steps = toss.ticks(dt), np.diff(toss.t) / dt
        uneven = np.abs(steps - np.diff(tick)) > tolerance
        return cls(tick, np.flatnonzero(uneven | (np.diff(tick) > most)), dt)

    def reach(self, first: int, ticks: int, end: int) -> int:
        """The last frame within some ticks of another.

        Args:
            first: That other frame.
            ticks: How many.
            end: The latest frame that may be the last.
        """
        return min(end, int(np.searchsorted(self.tick, self.tick[first] + ticks, side="right")) - 1)


def cut_first_flight(
    toss: Toss, clock: FrameClock, model: ObjectModel, long: int, cut: WindowSettings
) -> list[tuple[int, int]]:
    """First and last frames of windows over the flight that a toss begins with.

    The flight ends where the stated object may touch the stated ground, or, as neither may be right, where the velocity
    jumps or time is uneven.

    Args:
        toss: As recorded.
        clock: Its frames on the clock.
        model: The stated object.
        long: Most ticks of a window.
        cut: Where windows end.
    """
    end = flight_frames(toss, model) - 1
    end = min(end, int(clock.breaks[0])) if len(clock.breaks) else end
    if end < cut.shortest_flight:
        return []
    poses, cov = toss.measured
    # change of velocity over three frames
    position, s, t = poses[: end + 1, :3], 3, toss.t[: end + 1]
    velocity, middle = (position[s:] - position[:-s]) / (t[s:] - t[:-s])[:, None], 0.5 * (t[s:] + t[:-s])
    change = velocity[s:] - velocity[:-s]
    change[:, 2] += GRAVITY * (middle[s:] - middle[:-s])
    noise = np.sqrt(6 * np.maximum(np.einsum("nii->ni", cov[: end + 1])[:, :3].max(), 0.0)) / (s * clock.dt)
    far = np.linalg.norm(change - np.median(change, axis=0), axis=1)
    jumped = np.flatnonzero(far > cut.velocity_jump * GRAVITY * clock.dt + 6 * noise)
    end = min(end, s + int(jumped[0])) if len(jumped) else end
    if end < cut.shortest_flight:
        return []
    parts = -(-int(clock.tick[end]) // long)
    edges = [int(np.searchsorted(clock.tick, clock.tick[end] * k // parts)) for k in range(parts + 1)]
    return [(first, last) for first, last in itertools.pairwise(edges)]


def cut_consecutively(
    toss: Toss, clock: FrameClock, length: int, long: int, shift: int, cut: WindowSettings
) -> list[tuple[int, int]]:
    """First and last frames of a toss's consecutive windows.

    Args:
        toss: As recorded.
        clock: Its frames on the clock.
        length: Ticks of a window in contact.
        long: Most ticks of a window that is all flight or all rest.
        shift: Frames that are left out at the beginning.
        cut: Where windows end.
    """
    tick, flying = clock.tick, toss.phase == Phase.FLIGHT
    poses, cov = toss.measured
    std = pose_std(cov)
    out = []
    for begin, end in itertools.pairwise([-1, *clock.breaks.tolist(), len(toss) - 1]):
        first = max(begin + 1, shift)
        while end > first and tick[end] - tick[first] >= length // 2:
            landing = int(np.argmin(np.append(flying[first : end + 1], False)))
            near = slice(first, clock.reach(first, long, end) + 1)
            away = np.abs(difference(poses[near], poses[first])) > cut.rest_tolerance * std[near]
            moving = int(np.argmax(np.append(away.any(axis=1), True)))
            last = min(first + max(landing - 1 - cut.frames_before_landing, moving - 1), clock.reach(first, long, end))
            if last <= first or tick[last] - tick[first] <= length:
                last = clock.reach(first, length, end)
            out.append((first, last))
            first = last
    return out
