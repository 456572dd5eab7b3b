"""Frames that a recording lost at impacts, and whose loss its times do not show.

Flight before and after an impact is fitted, and continued to the impact. If times are true, the two meet in one pose:
a single impact changes velocities and no pose. If k frames were lost between the two flights and times do not say so,
flight after the impact meets that before it only when it is moved later by k frames. So

    pose_after(s - k h) = pose_before(s),    h the time of a frame,

are six equations for the time s of the impact and the whole number k. An impact that takes time still meets with k = 0
if all parts of its impulse have one mean time. Several impacts close together meet nowhere, or by chance. Chance finds
frames too many (k < 0) as often as lost ones, which is what a verdict on a recording is tested against.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from tossid.motion.contact import lowest_corner, runs
from tossid.motion.flight import fit_polynomial
from tossid.motion.kinematics import center_of_mass, gyration
from tossid.objects import GRAVITY, ObjectModel
from tossid.rotations import quat_boxminus, quat_exp, quat_mul, quat_rotate
from tossid.types import OnDemand, PoseTrack

Array = NDArray[np.float64]

CLEAR_HEIGHT_REL = 0.04
"""Height of the lowest stated corner above which nothing touches, in widths of the object."""
JUMP_REL = 0.03
"""Change of velocity times a frame's time beyond which something has touched nevertheless, in widths."""
FEWEST_FLIGHT, MOST_FLIGHT = 5, 13
"""Frames of flight next to an impact from which on it is looked at, and which are fitted at most."""
LONGEST_CONTACT = 0.05
"""Longest time between two flights that belong to one impact [s]."""
MOST_LOST = 3
"""Frames that an impact is taken to have lost at most."""
FLIGHT_TOLERANCE_REL = 0.0075
"""Root mean square distance of frames of a flight from it, in widths of the object."""
TOLERANCE_REL = 0.015
"""Distance at which two flights meet, in widths of the object."""
APART = 4.0
"""An impact is judged where any other number of frames leaves a distance so many times as large."""
LEAST_SHARE = 0.1
"""Share of impacts that lost frames among those that are judged from which on a recording did."""
SIGNIFICANCE = 0.005
"""Probability of such impacts by chance, which joins with frames too many as often."""
KEPT = 256
"""Mended tracks that stay in memory."""
GRID = 64
"""Times of an impact that are tried, between the frames of flight around it."""


@dataclass(frozen=True)
class Impact:
    """An impact that ends a flight.

    Attributes:
        toss: In which toss.
        first: Whether it is the toss's first contact.
        t: When it was [s]; NaN where it cannot be judged.
        lost: Frames that were lost there; negative where flights join with frames too many; None where it cannot be
            judged.
        last: Number of the last frame before the loss; of the last of flight where nothing was lost.
        frame_time: Time of a frame [s].
        skip: What times leave out, if it need be no whole number of frames [s].
        misfit: Distance of the two flights at the impact [m].
        next_misfit: The same with the number of frames that fits second best [m].
    """

    toss: str
    first: bool
    t: float = float("nan")
    lost: int | None = None
    last: int = -1
    frame_time: float = float("nan")
    skip: float = float("nan")
    misfit: float = float("nan")
    next_misfit: float = float("nan")


@dataclass(frozen=True)
class Verdict:
    """What the judged impacts of a recording say together.

    Attributes:
        impacts: How many there are.
        counts: How many of them were judged to have lost 0, 1, 2, ... frames.
        chance: How many joined only with frames too many, as chance makes them.
        is_lossy: Whether frames were lost.
    """

    impacts: int
    counts: tuple[int, ...]
    chance: int
    is_lossy: bool

    @classmethod
    def of(cls, impacts: Sequence[Impact]) -> Verdict:
        """The verdict: lost frames outnumber frames too many (sign test), and are no few of what was judged."""
        judged = [impact.lost for impact in impacts if impact.lost is not None]
        counts = tuple(judged.count(k) for k in range(MOST_LOST + 1))
        lost, chance = sum(counts[1:]), len(judged) - sum(counts)
        significant = float(binom.sf(lost - 1, lost + chance, 0.5)) < SIGNIFICANCE
        return cls(len(impacts), counts, chance, significant and lost >= LEAST_SHARE * len(judged))

    def words(self, which: str) -> str:
        """How many lost how many, in words.

        Args:
            which: What impacts they are.
        """
        lost = ", ".join(f"{n} lost {k}" for k, n in enumerate(self.counts) if k and n) or "0 lost any"
        return f"of {sum(self.counts) + self.chance} {which} that can be judged (of {self.impacts}), {lost}"


@dataclass(frozen=True)
class LostFrames:
    """The impacts of a recording, and the frames that it lost there.

    Attributes:
        impacts: All that end a flight, in the order of tosses.
        first: What the first impacts of tosses say.
        later: What the others say.
    """

    impacts: tuple[Impact, ...]
    first: Verdict
    later: Verdict

    @property
    def losses(self) -> tuple[Impact, ...]:
        """The impacts at which frames were lost; none where the recording shows no loss at such impacts."""
        return tuple(impact for impact in self._lossy() if (impact.lost or 0) > 0)

    @property
    def unjudged(self) -> frozenset[str]:
        """Names of the tosses that may have lost frames at an impact that cannot be judged."""
        return frozenset(impact.toss for impact in self._lossy() if impact.lost is None or impact.lost < 0)

    @property
    def is_lossy(self) -> bool:
        """Whether frames were lost."""
        return self.first.is_lossy or self.later.is_lossy

    def mended(self, tracks: Sequence[PoseTrack]) -> Sequence[PoseTrack]:
        """The tracks, with what follows a loss later by the time of the lost frames; as they are where nothing is lost.

        Recorded velocities are left out where anything is lost, because they were made of the wrong times.

        Args:
            tracks: As recorded.
        """
        if not self.losses:
            return tracks

        def mend(i: int) -> PoseTrack:
            t = tracks[i].t.copy()
            for impact in self.losses:
                if impact.toss == tracks[i].name:
                    t[impact.last + 1 :] += (impact.lost or 0) * impact.frame_time
            return replace(tracks[i], t=t, v=None)

        return OnDemand(mend, len(tracks), kept=KEPT)

    def facts(self) -> str:
        """What was lost after which frame of which toss, in a line for a dataset's provenance."""
        return "; ".join(f"{i.toss}: {i.lost} after frame {i.last}" for i in self.losses)

    def as_dict(self) -> dict[str, Any]:
        """The verdicts, and the impacts that could be judged, as reports have them."""
        judged = [asdict(impact) for impact in self.impacts if impact.lost is not None]
        return {"first": asdict(self.first), "later": asdict(self.later), "judged": judged}

    def _lossy(self) -> list[Impact]:
        return [impact for impact in self.impacts if (self.first if impact.first else self.later).is_lossy]


def find_lost_frames(tracks: Sequence[PoseTrack], model: ObjectModel, *, gravity: float = GRAVITY) -> LostFrames:
    """The frames that were lost at impacts.

    Args:
        tracks: As recorded, z up, the ground near z = 0.
        model: The object, without joints.
        gravity: Of free flight [m/s²].
    """
    long = (track for track in tracks if len(track.t) > FEWEST_FLIGHT)
    impacts = tuple(impact for track in long for impact in _impacts(track, model, gravity))
    first, later = (Verdict.of([i for i in impacts if i.first is which]) for which in (True, False))
    return LostFrames(impacts, first, later)


def lost_words(found: LostFrames) -> str | None:
    """What was found of lost frames, in a sentence; None where none were lost.

    Args:
        found: Of a recording.
    """
    if not found.is_lossy:
        return None
    both = f"{found.first.words('first impacts')}; {found.later.words('later impacts')}"
    return f"frames were lost, and times do not show it: {both}"


def _impacts(track: PoseTrack, model: ObjectModel, gravity: float) -> list[Impact]:
    """The impacts of a toss."""
    clear = lowest_corner(model, track.q) > CLEAR_HEIGHT_REL * model.width
    hit = _impacts_between(track, model, gravity)
    flies = clear & ~hit
    # a frame beside contact may hide an impact, and a recording's first frame is that of a filter
    flies[1:-1] &= clear[:-2] & clear[2:]
    flies[[0, -1]] = False
    flights = [slice(first, last + 1) for first, last in runs(flies)]
    long = [flight for flight in flights if flight.stop - flight.start >= FEWEST_FLIGHT]
    touches = np.flatnonzero(np.maximum.accumulate(clear) & (hit | ~clear))
    if not len(touches):
        return []
    out = []
    if not long or long[0].start > touches[0]:
        out.append(Impact(track.name, first=True))
    for before, after in itertools.zip_longest(flights, flights[1:]):
        if before not in long or before.stop > touches[-1]:
            continue
        impact = None
        if after in long and track.t[after.start] - track.t[before.stop - 1] <= LONGEST_CONTACT:
            impact = _judged(track, before, after, model, gravity)
        out.append(replace(impact or Impact(track.name, False), first=not out))
    return out


def _impacts_between(track: PoseTrack, model: ObjectModel, gravity: float) -> NDArray[np.bool_]:
    """Frames beside an impact between two frames that are both clear of the ground, (n,).

    It shows in the velocity, where the object could reach the ground if frames were lost there.
    """
    h, out = np.diff(track.t)[:, None], np.zeros(len(track.t), dtype=bool)
    v = np.diff(center_of_mass(model, track.q), axis=0) / h
    spin = quat_boxminus(track.q[1:, 3:7], track.q[:-1, 3:7]) / h
    jump = np.hstack([np.diff(v, axis=0), gyration(model) * np.diff(spin, axis=0)])
    jump[:, 2:3] += 0.5 * gravity * (h[1:] + h[:-1])
    low = lowest_corner(model, track.q)
    # by how much it falls up to a frame, or rises from it on, in each of two intervals: one wrong pose does neither
    rise = np.pad(np.diff(low), 1)
    falls, rises = np.minimum(-rise[:-3], -rise[1:-2]), np.minimum(rise[2:-1], rise[3:])
    reach = CLEAR_HEIGHT_REL * model.width + (1 + MOST_LOST) * np.maximum(falls, rises)
    moved = np.linalg.norm(jump, axis=1) * np.median(h) > JUMP_REL * model.width
    out[1:-1] = moved & (low[1:-1] < reach)
    return out


class FittedFlight(NamedTuple):
    """Free flight of a rigid body: x = c + u s - g s²/2 e_z, R = R_0 exp(w s + a s²/2), s = t - t_0.

    Attributes:
        t: t_0 [s].
        line: c and u, (2, 3).
        quat: R_0, (4,).
        turn: Rotation vector at t_0 and w, in the body's frame, (2, 3).
        spin_rate: a: what Euler's equations make of w, (3,).
        gravity: g [m/s²].
        com: Centre of mass in the body's frame [m], (3,).
        arm: Radius that makes lengths of rotations [m].
    """

    t: float
    line: Array
    quat: Array
    turn: Array
    spin_rate: Array
    gravity: float
    com: Array
    arm: float

    @classmethod
    def fitted(cls, t: Array, q: Array, model: ObjectModel, gravity: float) -> FittedFlight:
        """The flight that is nearest to poses (n, 7) at times (n,), in least squares of places and of attitudes."""
        middle, quat, I = float(t.mean()), q[len(q) // 2, 3:7], model.inertia[0]
        s = (t - middle)[:, None]
        fall = np.array([0.0, 0.0, 0.5 * gravity]) * s**2
        line = fit_polynomial(s[:, 0], center_of_mass(model, q) + fall, 1).coefficients
        turned, spin_rate = quat_boxminus(q[:, 3:7], quat), np.zeros(3)
        for _ in range(3):
            turn = fit_polynomial(s[:, 0], turned - 0.5 * spin_rate * s**2, 1).coefficients
            spin_rate = np.linalg.solve(I, np.cross(I @ turn[1], turn[1]))
        return cls(middle, line, quat, turn, spin_rate, gravity, model.com[0], gyration(model))

    def at(self, t: Array) -> tuple[Array, Array]:
        """Centre of mass (m, 3) and attitude (m, 4) at times (m,)."""
        s = (t - self.t)[:, None]
        c = self.line[0] + s * self.line[1] - np.array([0.0, 0.0, 0.5 * self.gravity]) * s**2
        return c, quat_mul(self.quat, quat_exp(self.turn[0] + s * self.turn[1] + 0.5 * s**2 * self.spin_rate))

    def off(self, t: Array, c: Array, quat: Array) -> Array:
        """How far centres of mass (m, 3) and attitudes (m, 4) are from the flight at times (m,), (m, 6) [m]."""
        own_c, own_quat = self.at(t)
        return np.hstack([c - own_c, self.arm * quat_boxminus(quat, own_quat)])

    def off_poses(self, t: Array, q: Array) -> Array:
        """How far poses (m, 7) are from the flight at times (m,), (m, 6) [m]."""
        return self.off(t, q[:, :3] + quat_rotate(q[:, 3:7], self.com), q[:, 3:7])


def _judged(track: PoseTrack, before: slice, after: slice, model: ObjectModel, gravity: float) -> Impact | None:
    """The impact between two flights; None where no number of frames, or more than one, joins them."""
    h, last = float(np.median(np.diff(track.t))), before.stop - 1
    counts = range(MOST_FLIGHT, FEWEST_FLIGHT - 1, -1)
    old = _longest_flight(
        track, [slice(max(before.start, before.stop - n), before.stop) for n in counts], model, gravity
    )
    new = _longest_flight(track, [slice(after.start, min(after.stop, after.start + n)) for n in counts], model, gravity)
    if old is None or new is None:
        return None
    # one number more either side, so that the best has neighbours
    numbers = range(-MOST_LOST - 1, MOST_LOST + 2)
    joins = [_join(old, new, k * h, track.t[last], track.t[after.start] + max(0, k) * h) for k in numbers]
    misfit = np.array([each for _, each in joins])
    best, second = (int(i) for i in np.argsort(misfit)[:2])
    k, at, tolerance = numbers[best], joins[best][0], TOLERANCE_REL * model.width
    if misfit[best] > tolerance or misfit[second] < APART * misfit[best] or abs(k) > MOST_LOST:
        return None
    if k > 0:
        last = _last_before(track, old, new, range(last, after.start), k * h, at, APART * tolerance)
    # the squared distance is a parabola of the skip, whose least is between whole numbers
    less, least, more = misfit[best - 1 : best + 2] ** 2
    skip = float((k + 0.5 * (less - more) / (less - 2 * least + more)) * h)
    return Impact(track.name, False, at, k, last, h, skip, float(misfit[best]), float(misfit[second]))


def _longest_flight(
    track: PoseTrack, stretches: Sequence[slice], model: ObjectModel, gravity: float
) -> FittedFlight | None:
    """The flight of the first stretch, of ever shorter ones, that is one."""
    for some in stretches:
        t, q = track.t[some], track.q[some]
        flight = FittedFlight.fitted(t, q, model, gravity)
        if np.sqrt((flight.off_poses(t, q) ** 2).sum(axis=1).mean()) < FLIGHT_TOLERANCE_REL * model.width:
            return flight
    return None


def _join(old: FittedFlight, new: FittedFlight, skip: float, first: float, last: float) -> tuple[float, float]:
    """Time at which two flights are nearest when the new one is later by `skip`, and their distance there [m]."""
    s = np.linspace(first, last, GRID)
    off = old.off(s, *new.at(s - skip))
    i = int(np.argmin((off**2).sum(axis=1)))
    a, b = max(i - 1, 0), min(i + 1, len(s) - 1)
    rate = (off[b] - off[a]) / (s[b] - s[a])
    at = float(np.clip(s[i] - off[i] @ rate / max(float(rate @ rate), 1e-12), first, last))
    return at, float(np.linalg.norm(off[i] + (at - s[i]) * rate))


def _last_before(
    track: PoseTrack, old: FittedFlight, new: FittedFlight, frames: range, skip: float, at: float, outlier: float
) -> int:
    """The last frame before the loss: that for which the frames of the contact lie nearest to the two flights.

    Frames farther than `outlier` [m] count no more than one at this distance. Of equals, the first is taken.
    """
    some = np.array(frames[1:], dtype=int)
    costs = []
    for last in frames:
        t, q = track.t[some] + np.where(some > last, skip, 0.0), track.q[some]
        off = np.where((t < at)[:, None], old.off_poses(t, q), new.off_poses(t - skip, q))
        costs.append(np.minimum(np.linalg.norm(off, axis=1), outlier).sum())
    return frames[int(np.argmin(costs))]
