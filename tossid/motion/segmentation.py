"""The tosses in one long track, from release to rest, with a reason for every other stretch.

Free flight is recognised by its acceleration, -g, and by its end on the ground. Rest is a pose that no longer changes
and stands by itself. A hand is recognised by flights that end in the air, and by the energy that it adds: an object
left alone only loses energy.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.motion.contact import may_touch, runs
from tossid.motion.local_motion import LocalMotion
from tossid.motion.release import release_frame
from tossid.motion.resting import mean_pose, near, stands, still_for
from tossid.objects import GRAVITY, ObjectModel
from tossid.types import LongTrack, OnDemand, PoseTrack

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Rest = tuple[int, int]
"""First and last frame of a rest."""

RESTING = "resting"

REST_DISTANCE, REST_ANGLE = 4e-4, 6e-3
"""Distance [m] and angle [rad] from its final pose within which an object rests; four times the track's noise if that
is more."""
MIN_REST = 0.08
"""Shortest rest [s]."""
MAX_GAP = 0.05
"""Longest gap in a toss [s]."""
GROUND = 0.025
"""Height of the lowest corner at which a flight can have ended on the ground [m]."""
HAND_ENERGY = 0.03
"""Rise of energy over weight that only a hand can cause [m]."""
HELD_HEIGHT, HELD_TIME = 0.008, 0.05
"""An object is held that is higher than this over the ground [m] for longer than this [s] and does not fall; a fit of
the acceleration that spans an impact looks like being held for less."""
MERGED_RESTS = 1.0
"""Two rests that are nearer in time [s] may be one, between which the object only moved by itself:"""
TIPPING_RISE, TIPPING_SPEED = 0.004, 0.15
"""the centre of mass rises by less than this [m], and is no faster than this, beside what a fall gives [m/s]."""
BLOCK_FRAMES = 10_000
"""Frames that are in memory at a time, or more where no rest divides them."""
KEPT = 64
"""Tosses that stay in memory once they were read."""
FEWEST_FRAMES = 8
"""A track of fewer frames holds no toss."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """A stretch of a track that is no toss.

    Attributes:
        first: Number of its first frame.
        last: Number of its last frame.
        t0: Time of the first [s].
        t1: Time of the last [s].
        reason: Why it is no toss.
    """

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
) -> tuple[Sequence[PoseTrack], tuple[Stretch, ...]]:
    """The tosses of a track, and every other stretch with its reason.

    A toss starts with the first frame of free flight after the release (or with the track, where that starts in flight)
    and ends with the first frame from which the object stays at rest (or with the track).

    Args:
        track: At a mostly even rate, in a world whose z points up, ground at z = 0. A few blocks of it are in memory at
            a time.
        model: The object.
        gravity: [m/s²].

    Returns:
        The tosses' tracks, named after the track and numbered, read when they are asked for; and the other stretches.

    Raises:
        InputError: The track is too short to hold a toss.
    """
    t, n = track.t, len(track.t)
    dt = float(np.median(np.diff(t)))
    if n < FEWEST_FRAMES:
        raise InputError(f"a track of {n} poses is too short to hold a toss")
    tosses: list[slice] = []
    rejected: list[Stretch] = []

    def block(first: int, stop: int) -> _Block:
        return _Block(model, track.frames(slice(first, stop)), dt, gravity)

    # long gaps split the track
    breaks = np.flatnonzero(np.diff(t) > max(MAX_GAP, 2.5 * dt)) + 1
    for start, stop in itertools.pairwise([0, *breaks.tolist(), n]):
        if stop - start < FEWEST_FRAMES:
            stretches = iter([(start, stop - 1, "too short")])
        else:
            stretches = _stretches(block, start, stop, round(MERGED_RESTS / dt), open_end=stop < n)
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


def _stretches(
    block: Callable[[int, int], _Block], start: int, stop: int, merge: int, *, open_end: bool
) -> Iterator[tuple[int, int, str]]:
    """(first, last, reason) of frames from start to stop, block by block; an empty reason is a toss.

    A block ends in a rest, since what was before a rest does not matter after it. block: makes one of frames. merge:
    frames within which two rests may be one. open_end: more frames follow after a gap.
    """
    at, size = start, BLOCK_FRAMES
    while True:
        end = min(at + size, stop)
        part = block(at, end)
        rests = part.rests(resting=at > start)
        until = None if end == stop else part.end_of_block(rests, merge)
        if until is None and end < stop:
            size *= 2
            continue
        for first, last, reason in part.stretches(rests, until, open_end=open_end):
            yield at + first, at + last, reason
        if until is None:
            return
        at, size = at + until, BLOCK_FRAMES


def rest_frame(q: Array) -> int:
    """First frame from which the configuration stays within the rest tolerance of its last five frames' mean.

    A single frame beyond the tolerance does not count as motion.

    Args:
        q: Configurations, (n, nq).
    """
    moving = ~near(q, mean_pose(q[-5:]), REST_DISTANCE, REST_ANGLE)
    index = np.flatnonzero(moving & ~_alone(moving))
    return int(min(index[-1] + 1, len(q) - 1)) if len(index) else 0


def _alone(flags: Bools) -> Bools:
    """Which true flags (n,) have no true neighbour, (n,)."""
    padded = np.concatenate([[False], flags, [False]])
    return np.asarray(flags & ~padded[:-2] & ~padded[2:])


class _Block(LocalMotion):
    """A block of a track without long gaps, cut into rests and motions."""

    def rests(self, *, resting: bool) -> list[Rest]:
        """All rests. resting: the object is known to rest at the first frame."""
        n = len(self.t)
        span = max(round(MIN_REST / self.dt), 4)
        if n <= span:
            return []
        distance = np.maximum(REST_DISTANCE, 4 * self.noise)
        angle = np.maximum(REST_ANGLE, 4 * self.turn_noise)
        # candidates: frames with the same pose half of the shortest rest and the shortest rest later
        quiet = still_for(self.q, span, 1.5 * distance[: n - span], 1.5 * angle[: n - span])
        found: list[Rest] = []
        for a, b in runs(quiet):
            # of a rest that is still creeping, the second half is nearest to the final pose
            pose = mean_pose(self.q[(a + b + span) // 2 : b + span + 1])
            first, last = self._around(a, b + span, pose, distance, angle)
            if last < first or not stands(self.model, pose):  # (held by a hand, or on an edge for a moment)
                continue
            if found and first <= found[-1][1] + 1:
                first = min(first, found.pop()[0])
            if (last - first) * self.dt >= 0.9 * MIN_REST:
                found.append((first, last))
        if resting and found and found[0][0] < span:
            found[0] = (0, found[0][1])
        return self._merged(found)

    def end_of_block(self, rests: list[Rest], merge: int) -> int | None:
        """The last frame at rest that no later frame can change; None if there is none."""
        end = len(self.t) - 1 - merge
        ended = [first for first, last in rests if last < end and first > 0]
        if ended:
            return ended[-1]
        # a long rest that continues
        return end if rests and rests[-1][0] + merge < end <= rests[-1][1] else None

    def _around(self, a: int, b: int, pose: Array, distance: Array, angle: Array) -> Rest:
        """The longest run at a pose that overlaps frames a to b, extended on both sides; (0, -1) if there is none."""
        n, reach = len(self.t), b - a + 1
        while True:
            low, high = max(a - reach, 0), min(b + reach, n - 1) + 1
            still = near(self.q[low:high], pose, distance[low:high], angle[low:high])
            still |= _alone(~still)
            found = [(low + i, low + j) for i, j in runs(still) if low + j >= a and low + i <= b]
            if not found:
                return 0, -1
            first, last = max(found, key=lambda run: run[1] - run[0])
            if (first > low or low == 0) and (last < high - 1 or high == n):
                return first, last
            reach *= 2

    def _merged(self, rests: list[Rest]) -> list[Rest]:
        """Rests, of which those are one between which the object only moved by itself: it had not come to rest before.

        On the ground it may have stood upright for a moment and tipped over, no faster than its fall makes it.
        """
        merged: list[Rest] = []
        for first, last in rests:
            if merged:
                before = merged[-1][1]
                between = slice(before, first + 1)
                fall = self.com[before, 2] - self.com[between, 2]
                speed = np.linalg.norm(self.velocity[between], axis=1)
                on_ground = self.low[before] < self.low[first] + HELD_HEIGHT
                by_fall = 2 * self.gravity * np.maximum(fall, 0.0) if on_ground else 0.0
                soon = (first - before) * self.dt < MERGED_RESTS
                if soon and -fall.min() < TIPPING_RISE and (speed**2 < TIPPING_SPEED**2 + by_fall).all():
                    merged[-1] = (first, last)
                    continue
            merged.append((first, last))
        return merged

    def stretches(self, rests: list[Rest], until: int | None, *, open_end: bool) -> Iterator[tuple[int, int, str]]:
        """(first, last, reason) of all frames in order, or of those up to a frame at rest; a toss has no reason."""
        n = len(self.t)
        ends = [*rests, (n, n)] if until is None else [(a, min(b, until)) for a, b in rests if a <= until]
        at = 0
        for first_rest, last_rest in ends:
            end = min(first_rest, n - 1)
            if end > at or (first_rest == n and at < n - 1):
                yield from self._motion(at, end, at_end=first_rest == n, open_end=open_end)
            if first_rest < n and first_rest != until:
                yield min(first_rest + 1, last_rest), last_rest, RESTING
                at = last_rest + 1
            if at >= n:
                break

    def _motion(self, a: int, b: int, *, at_end: bool, open_end: bool) -> Iterator[tuple[int, int, str]]:
        """One motion between rests, frames a to b; b is the first of rest unless `at_end`."""
        ground = float(self.low[b]) if not at_end else 0.0
        # an object that only tips over, or hops a little, was not released in the air
        high = ground + HELD_HEIGHT
        flights = [flight for flight in self.flights(a, b) if self.low[slice(*flight)].max() > high]
        landed = [flight for flight in flights if self._lands(flight[1], b)]
        release = next(
            (flight for flight in landed if self._left_alone(*flight, b) and not self._held(flight[1], b, high)), None
        )
        if release is None:
            if landed:
                reason = "taken up again before it rested"
            else:
                reason = "carried: no free flight" if not flights else "carried: no free flight to the ground"
            yield a, b - (not at_end), reason
            return
        first = self._let_go(*release, a)
        if first > a:
            yield a, first - 1, "carried" if release == landed[0] else "taken up again before it rested"
        reason = ""
        if at_end and open_end:
            reason = "lost from view before it rests"
        elif at_end and release[1] >= b - 1:
            reason = "too short: the track ends in its first flight"
        yield first, b, reason

    def _let_go(self, first: int, last: int, a: int) -> int:
        """The first frame that flight explains, of a flight whose first frame is known to a few frames."""
        clear = np.flatnonzero(~may_touch(self.model, self.t[first : last + 1], self.q[first : last + 1]))
        if not len(clear):
            return first
        begin, end = max(first - self.window, a), first + int(clear[-1]) + 1
        return begin + release_frame(self.track.frames(slice(begin, end + 1)), self.model, gravity=self.gravity)

    def _lands(self, last: int, b: int) -> bool:
        """Whether a flight ends near the ground, or with the track."""
        if last >= len(self.t) - 2:
            return True
        return bool(self.low[max(last - 1, 0) : min(last + 2, b) + 1].min() < GROUND)

    def _held(self, last: int, b: int, high: float) -> bool:
        """Whether, from a flight to the end of the motion, it ever is high up for long without falling."""
        held = self.carried[last + 1 : b + 1] & (self.low[last + 1 : b + 1] > high)
        return any((j - i + 1) * self.dt > HELD_TIME for i, j in runs(held))

    def _left_alone(self, first: int, last: int, b: int) -> bool:
        """Whether nothing added energy from a flight to the end of the motion.

        Energy over mass: g z + |v|²/2 [J/kg], at the start with that of the spin, which an impact can convert.
        """
        energy = self.gravity * self.com[:, 2] + 0.5 * np.sum(self.velocity**2, axis=1)
        flight = slice(first, last + 1)
        # the squared radius of gyration of the body where it is largest: an upper bound for the energy of spin
        gyration2 = (np.linalg.eigvalsh(self.model.inertia).max(axis=1) / self.model.mass).max()
        start = np.median(energy[flight] + 0.5 * gyration2 * self.spin[flight] ** 2)
        later = np.sort(energy[last + 1 : b + 1])
        # the third largest, since single frames may be wrong
        return not len(later) or bool(later[-min(3, len(later))] < start + HAND_ENERGY * self.gravity)
