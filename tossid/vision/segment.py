"""Find the tosses in one long track: from the release to rest, with a reason for everything else.

Free flight is recognised by its acceleration, -g, and by its end on the ground;
rest by the pose that no longer changes and stands by itself; the hand by flights that end in the
air, and by the energy it brings in, for an object left to itself can only lose it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.objects import GRAVITY, ObjectModel, corner_positions
from tossid.rotations import quat_boxminus
from tossid.types import LongTrack, OnDemand, PoseTrack
from tossid.vision.parabolas import local_parabolas, scatter
from tossid.vision.standing import center_of_mass, mean_pose, near, stands, still_for

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

BLOCK = 10_000
"""Frames that are looked at at a time, or more, for what lies between rests is looked at as one."""
SETTLED = 1.0
"""Rests that are nearer to one another [s] may be one."""
KEPT = 64
"""Tosses that stay in memory once they were read."""
RESTING = "resting"
CLEAR, HELD = 0.008, 0.05
"""An object whose lowest corner is higher than this over the ground [m] for longer than this [s], and does not fall, is
held. (An impact looks like that for as long as a local fit of the acceleration spans it.)"""


@dataclass(frozen=True, slots=True)
class SegmentSettings:
    """What counts as flight and as rest.

    rest_distance [m], rest_angle [rad]: of the final pose, within which the object rests; more if the track's
    noise is more.
    min_rest, min_flight: shortest rest and free flight [s].
    flight_acceleration: deviation from -g that is still free flight [m/s²].
    energy: rise of energy over weight [m] that only a hand can cause.
    ground: height of the lowest corner [m] at which a flight can have ended on the ground.
    max_gap: longest gap [s] in a toss.
    """

    rest_distance: float = 0.0004
    rest_angle: float = 0.006
    min_rest: float = 0.08
    min_flight: float = 0.04
    flight_acceleration: float = 3.5
    energy: float = 0.03
    ground: float = 0.025
    max_gap: float = 0.05


@dataclass(frozen=True, slots=True)
class Stretch:
    """Frames [first, last] of a track, from t0 to t1 [s], that are no toss, and why."""

    first: int
    last: int
    t0: float
    t1: float
    reason: str


def segment(
    track: PoseTrack | LongTrack,
    model: ObjectModel,
    *,
    gravity: float = GRAVITY,
    settings: SegmentSettings = SegmentSettings(),
) -> tuple[Sequence[PoseTrack], tuple[Stretch, ...]]:
    """Cut a track into tosses.

    A toss starts with the first frame of free flight after the release (or with
    the track, where that starts in flight) and ends with the first frame from
    which the object stays at rest (or with the track).

    Args:
        track: at a mostly even rate, in a world whose z points up, ground at z = 0. Some `BLOCK` of it are in memory
            at a time.
        gravity: [m/s²].

    Returns:
        the tosses, named after the track and numbered (read of it when they are asked for), and every other stretch
        with its reason.
    """
    t, n = track.t, len(track.t)
    dt = float(np.median(np.diff(t)))
    if n < 8:
        raise InputError(f"a track of {n} poses is too short to hold a toss")
    # of the body whose moments are largest for its mass: an upper bound for the energy of spin
    gyration = float((np.linalg.eigvalsh(model.inertia).max(axis=1) / model.mass).max())
    tosses: list[slice] = []
    rejected: list[Stretch] = []

    def look(first: int, stop: int) -> _Part:
        return _Part(model, track.frames(slice(first, stop)), dt, gravity, gyration, settings)

    # frames missing for longer than a toss can do without split the track
    breaks = np.flatnonzero(np.diff(t) > max(settings.max_gap, 2.5 * dt)) + 1
    for start, stop in itertools.pairwise([0, *breaks.tolist(), n]):
        if stop - start < 8:
            stretches = iter([(start, stop - 1, "too short")])
        else:
            stretches = _from_rest_to_rest(look, start, stop, round(SETTLED / dt), open_end=stop < n)
        for first, last, reason in stretches:
            if not reason:
                tosses.append(slice(first, last + 1))
            elif last >= first:
                if rejected and reason == rejected[-1].reason == RESTING and first <= rejected[-1].last + 1:
                    first = rejected.pop().first  # one rest, of several blocks
                rejected.append(Stretch(first, last, float(t[first]), float(t[last]), reason))

    def toss(i: int) -> PoseTrack:
        return replace(track.frames(tosses[i]), name=f"{track.name}_{i:03d}")

    return OnDemand(toss, len(tosses), kept=KEPT), tuple(rejected)


def _from_rest_to_rest(
    look: Callable[[int, int], _Part], start: int, stop: int, settled: int, *, open_end: bool
) -> Iterator[tuple[int, int, str]]:
    """(first, last, reason) of frames from start to stop, in blocks: what was before a rest does not matter after it.

    Args:
        look: at frames of the track. settled: frames within which rests may be one. open_end: more frames follow later.
    """
    at, size = start, BLOCK
    while True:
        end = min(at + size, stop)
        part = look(at, end)
        rests = part.rests(resting=at > start)
        until = None if end == stop else part.until(rests, settled)
        if until is None and end < stop:
            size *= 2
            continue
        for first, last, reason in part.stretches(rests, until, open_end=open_end):
            yield at + first, at + last, reason
        if until is None:
            return
        at, size = at + until, BLOCK


def rest_frame(q: Array, *, settings: SegmentSettings = SegmentSettings()) -> int:
    """First frame from which the configuration stays within the rest tolerance of its last five frames' mean.

    q: (n, nq). A single frame beyond the tolerance does not count as motion.
    """
    distance, angle = np.full(len(q), settings.rest_distance), np.full(len(q), settings.rest_angle)
    moving = ~near(q, mean_pose(q[-5:]), distance, angle)
    index = np.flatnonzero(moving & ~_alone(moving))
    return int(min(index[-1] + 1, len(q) - 1)) if len(index) else 0


def _alone(flags: Bools) -> Bools:
    """Which of the flags stand with none beside them."""
    padded = np.concatenate([[False], flags, [False]])
    return np.asarray(flags & ~padded[:-2] & ~padded[2:])


def _runs(flags: Bools) -> Iterator[tuple[int, int]]:
    """First and last index of each run of true flags."""
    steps = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    yield from zip(steps[::2].tolist(), (steps[1::2] - 1).tolist(), strict=True)


class _Part:
    """A stretch of track without long gaps."""

    def __init__(
        self,
        model: ObjectModel,
        track: PoseTrack,
        dt: float,
        gravity: float,
        gyration: float,
        settings: SegmentSettings,
    ) -> None:
        t, q, q_cov = track.t, track.q, track.q_cov
        com = center_of_mass(model, q)
        self.model, self.t, self.com, self.q = model, t, com, q
        self.low = corner_positions(model, q)[..., 2].min(axis=1)
        self.dt, self.gravity, self.gyration, self.settings = dt, gravity, gyration, settings
        # noise of each frame [m], [rad]: what the track says, and at least what its third differences
        # show, which of smooth motion are far smaller than of noise
        turn = quat_boxminus(q[1:, 3:7], q[:-1, 3:7])
        self.noise = np.full(len(t), scatter(np.diff(com, n=3, axis=0)))
        self.turn_noise = np.full(len(t), scatter(np.diff(turn, n=2, axis=0)))
        if q_cov is not None:
            self.noise = np.maximum(self.noise, np.sqrt(np.linalg.eigvalsh(q_cov[:, :3, :3])[:, -1]))
            self.turn_noise = np.maximum(self.turn_noise, np.sqrt(np.linalg.eigvalsh(q_cov[:, 3:6, 3:6])[:, -1]))
        self.window = max(round(0.5 * settings.min_flight / dt), 3)  # half width of local fits
        self.velocity, self.acceleration, self.beside = local_parabolas(t, com, self.window, self.noise)
        self.spin = self._spin()
        # noise of a local acceleration: 720 / N⁵ of a quadratic fit (N frames), three times
        spread = 3 * np.sqrt(720.0 / (2 * self.window + 1) ** 5) * self.noise / dt**2
        off = np.linalg.norm(self.acceleration + np.array([0.0, 0.0, gravity]), axis=1)
        told = spread < 5.0  # where the track is too noisy to tell, it tells neither of flight nor of a hand
        self.free = told & (off < settings.flight_acceleration + spread)
        self.carried = told & ~self.free

    def _spin(self) -> Array:
        """Angular speed over a few frames [rad/s]. (n,)."""
        k = min(self.window, len(self.t) // 2)
        rate = np.linalg.norm(quat_boxminus(self.q[2 * k :, 3:7], self.q[: -2 * k, 3:7]), axis=1)
        rate = rate / (self.t[2 * k :] - self.t[: -2 * k])
        return np.concatenate([np.repeat(rate[:1], k), rate, np.repeat(rate[-1:], k)])

    def rests(self, *, resting: bool) -> list[tuple[int, int]]:
        """Runs of frames at rest: the first within the tolerance of the run's own pose, to the last.

        resting: the object is known to rest at the first frame.
        """
        n = len(self.t)
        span = max(round(self.settings.min_rest / self.dt), 4)
        if n <= span:
            return []
        distance = np.maximum(self.settings.rest_distance, 4 * self.noise)
        angle = np.maximum(self.settings.rest_angle, 4 * self.turn_noise)
        # candidates: the same pose at both ends and in the middle of the shortest rest
        quiet = still_for(self.q, span, 1.5 * distance[: n - span], 1.5 * angle[: n - span])
        found: list[tuple[int, int]] = []
        for a, b in _runs(quiet):
            # what comes last is nearest to the final pose
            pose = mean_pose(self.q[(a + b + span) // 2 : b + span + 1])
            first, last = self._around(a, b + span, pose, distance, angle)
            if last < first:
                continue
            if not stands(self.model, pose):
                continue  # held, or still for a moment on an edge
            if found and first <= found[-1][1] + 1:
                first = min(first, found.pop()[0])
            if (last - first) * self.dt >= 0.9 * self.settings.min_rest:
                found.append((first, last))
        if resting and found and found[0][0] < span:
            found[0] = (0, found[0][1])
        return self._merge(found)

    def until(self, rests: list[tuple[int, int]], settled: int) -> int | None:
        """A frame at rest after which nothing can change what was before it, the last if there are several."""
        end = len(self.t) - 1 - settled
        ended = [first for first, last in rests if last < end and first > 0]
        if ended:
            return ended[-1]
        # a rest that goes on, and has for long
        return end if rests and rests[-1][0] + settled < end <= rests[-1][1] else None

    def _around(self, a: int, b: int, pose: Array, distance: Array, angle: Array) -> tuple[int, int]:
        """The longest run at a pose that has to do with frames a to b, as far as it goes on both sides.

        (0, -1) if there is none.
        """
        n, reach = len(self.t), b - a + 1
        while True:
            low, high = max(a - reach, 0), min(b + reach, n - 1) + 1
            still = near(self.q[low:high], pose, distance[low:high], angle[low:high])
            still |= _alone(~still)
            runs = [(low + i, low + j) for i, j in _runs(still) if low + j >= a and low + i <= b]
            if not runs:
                return 0, -1
            first, last = max(runs, key=lambda run: run[1] - run[0])
            if (first > low or low == 0) and (last < high - 1 or high == n):
                return first, last
            reach *= 2

    def _merge(self, rests: list[tuple[int, int]]) -> list[tuple[int, int]]:
        """Join rests between which the object only settled further by itself: it had not come to rest before.

        On the ground it may have stood on what does not hold for long, and tipped over: no faster than by its fall.
        """
        merged: list[tuple[int, int]] = []
        for first, last in rests:
            if merged:
                before = merged[-1][1]
                between = slice(before, first + 1)
                fall = self.com[before, 2] - self.com[between, 2]
                speed = np.linalg.norm(self.velocity[between], axis=1)
                lay = self.low[before] < self.low[first] + CLEAR
                fastest = np.sqrt(0.15**2 + (2 * self.gravity * np.maximum(fall, 0.0) if lay else 0.0))
                if -fall.min() < 0.004 and (speed < fastest).all() and (first - before) * self.dt < SETTLED:
                    merged[-1] = (first, last)
                    continue
            merged.append((first, last))
        return merged

    def stretches(
        self, rests: list[tuple[int, int]], until: int | None, *, open_end: bool
    ) -> Iterator[tuple[int, int, str]]:
        """(first, last, reason) of all frames in order, or of those to a frame at rest; an empty reason is a toss."""
        n = len(self.t)
        ends = [*rests, (n, n)] if until is None else [(a, min(b, until)) for a, b in rests if a <= until]
        at = 0
        for first_rest, last_rest in ends:
            end = min(first_rest, n - 1)
            if end > at or (first_rest == n and at < n - 1):
                at_end = first_rest == n
                yield from self._motion(at, end, at_end=at_end, open_end=open_end)
            if first_rest < n and first_rest != until:
                yield min(first_rest + 1, last_rest), last_rest, RESTING
                at = last_rest + 1
            if at >= n:
                break

    def _motion(self, a: int, b: int, *, at_end: bool, open_end: bool) -> Iterator[tuple[int, int, str]]:
        """One motion between rests, frames a to b; b is the first of rest unless `at_end`."""
        ground = float(self.low[b]) if not at_end else 0.0
        # what only tips over, or hops a little, was not let go in the air
        flights = [flight for flight in self._flights(a, b) if self.low[slice(*flight)].max() > ground + CLEAR]
        landed = [flight for flight in flights if self._lands(flight[1], b)]
        release = next(
            (flight for flight in landed if self._left_alone(*flight, b) and not self._held(flight[1], b, ground)), None
        )
        if release is None:
            if landed:
                reason = "taken up again before it rested"
            else:
                reason = "carried: no free flight" if not flights else "carried: no free flight to the ground"
            yield a, b - (not at_end), reason
            return
        first = release[0]
        if first > a:
            yield a, first - 1, "carried" if release == landed[0] else "taken up again before it rested"
        if at_end and open_end:
            yield first, b, "lost from view before it rests"
        elif at_end and release[1] >= b - 1:
            yield first, b, "too short: the track ends in its first flight"
        else:
            yield first, b, ""

    def _lands(self, last: int, b: int) -> bool:
        """Whether a flight ends near the ground, or with the track."""
        if last >= len(self.t) - 2:
            return True
        return bool(self.low[max(last - 1, 0) : min(last + 2, b) + 1].min() < self.settings.ground)

    def _flights(self, a: int, b: int) -> list[tuple[int, int]]:
        """Runs of free flight in frames a to b, grown to their last frames of free motion."""
        settings = self.settings
        flights: list[tuple[int, int]] = []
        for first, last in _runs(self.free[a : b + 1]):
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

        One frame beside the parabola is passed over if the frame behind it is on it again.
        """
        mean = self.acceleration[first : last + 1].mean(axis=0)
        limit = float(np.clip(5 * np.median(self.noise[first : last + 1]), 2.5e-4, 2e-3))
        # the local fits at the core's ends may already lean on frames outside the flight
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
        good = np.arange(own.start, own.stop)[~self.beside[own]]
        s = self.t[good] - time
        rest = self.com[good] - 0.5 * acceleration * s[:, None] ** 2
        basis = np.stack([np.ones_like(s), s], axis=1)
        return np.asarray(np.linalg.lstsq(basis, rest, rcond=None)[0][0])

    def _held(self, last: int, b: int, ground: float) -> bool:
        """Whether from a flight to the end of the motion it ever is off the ground [m] for long without falling."""
        held = self.carried[last + 1 : b + 1] & (self.low[last + 1 : b + 1] > ground + CLEAR)
        return any((j - i + 1) * self.dt > HELD for i, j in _runs(held))

    def _left_alone(self, first: int, last: int, b: int) -> bool:
        """Whether nothing brought in energy from a flight to the end of the motion.

        Energy over mass: g z + |v|²/2 [J/kg], at the start with that of the spin, which an impact can turn into it.
        """
        energy = self.gravity * self.com[:, 2] + 0.5 * np.sum(self.velocity**2, axis=1)
        flight = slice(first, last + 1)
        start = np.median(energy[flight] + 0.5 * self.gyration * self.spin[flight] ** 2)
        later = np.sort(energy[last + 1 : b + 1])
        # three frames, for one alone may be the track's fault
        return not len(later) or bool(later[-min(3, len(later))] < start + self.settings.energy * self.gravity)
