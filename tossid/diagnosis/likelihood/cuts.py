"""Where windows begin and end in a toss, on the clock of its camera, of which frames may be missing."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.states import difference
from tossid.motion.contact import may_touch, runs
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


def cut_flights(toss: Toss, clock: FrameClock, model: ObjectModel, cut: WindowSettings) -> list[tuple[int, int]]:
    """First and last frames of windows over the flight that a toss begins with, and over those after bounces.

    A flight ends where the stated object may touch the stated ground, or, as neither may be right, where the velocity
    jumps or time is uneven. A later one falls as the first one does: what slides or rests on a ground that is higher
    than the stated one does not.

    Args:
        toss: As recorded.
        clock: Its frames on the clock.
        model: The stated object.
        cut: Where windows end.
    """
    ended = may_touch(model, toss.t, toss.q)
    ended[clock.breaks] = True
    out: list[tuple[int, int]] = []
    falls = None
    for begin, end in runs(~ended):
        first = begin + cut.frames_after_contact if begin else 0
        last = _before_jump(toss, clock, first, end + 1, cut)
        if last - first < (cut.shortest_later_flight if begin else cut.shortest_flight):
            continue
        acceleration = _acceleration(toss, first, last)
        if not begin:
            falls = acceleration
        elif falls is None or np.linalg.norm(acceleration - falls) > cut.falls_alike * GRAVITY:
            continue
        tick = clock.tick[first : last + 1] - clock.tick[first]
        parts = -(-int(tick[-1]) // cut.long)
        edges = [first + int(np.searchsorted(tick, tick[-1] * k // parts)) for k in range(parts + 1)]
        out += itertools.pairwise(edges)
    return out


def _acceleration(toss: Toss, first: int, last: int) -> Array:
    """(3,) of the tracked point between two frames, by the parabola nearest to its places."""
    t = toss.t[first : last + 1] - toss.t[first]
    out: Array = 2 * np.polyfit(t, toss.measured[0][first : last + 1, :3], 2)[0]
    return out


def _before_jump(toss: Toss, clock: FrameClock, first: int, last: int, cut: WindowSettings) -> int:
    """The last frame of a flight before its velocity jumps, by its change over three frames."""
    s, (poses, cov) = 3, toss.measured
    if last - first < 2 * s:
        return last
    position, t = poses[first : last + 1, :3], toss.t[first : last + 1]
    velocity, middle = (position[s:] - position[:-s]) / (t[s:] - t[:-s])[:, None], 0.5 * (t[s:] + t[:-s])
    change = velocity[s:] - velocity[:-s]
    change[:, 2] += GRAVITY * (middle[s:] - middle[:-s])
    largest = max(0.0, np.einsum("nii->ni", cov[first : last + 1])[:, :3].max())
    far = np.linalg.norm(change - np.median(change, axis=0), axis=1)
    jumped = np.flatnonzero(far > cut.velocity_jump * GRAVITY * clock.dt + 6 * np.sqrt(6 * largest) / (s * clock.dt))
    return first + s + int(jumped[0]) if len(jumped) else last


def cut_consecutively(toss: Toss, clock: FrameClock, shift: int, cut: WindowSettings) -> list[tuple[int, int]]:
    """First and last frames of a toss's consecutive windows.

    Args:
        toss: As recorded.
        clock: Its frames on the clock.
        shift: Frames that are left out at the beginning.
        cut: Where windows end.
    """
    tick, flying, length, long = clock.tick, toss.phase == Phase.FLIGHT, cut.length, cut.long
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
