"""Frames that a recording lost at impacts or in flight, and whose loss its times do not show.

Flight before and after an impact is fitted, and continued to the impact. If times are true, the two meet in one pose:
a single impact changes velocities and no pose. If k frames were lost between the two flights and times do not say so,
flight after the impact meets that before it only when it is moved later by k frames. So

    pose_after(s - k h) = pose_before(s),    h the time of a frame,

are six equations for the time s of the impact and the whole number k. An impact that takes time still meets with k = 0
if all parts of its impulse have one mean time. Several impacts close together meet nowhere, or by chance. Chance finds
frames too many (k < 0) as often as lost ones, which is what a verdict on a recording is tested against. A step in
flight that is unlike its neighbours is looked at in the same way: both parts are one flight.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from tossid.motion.contact import lowest_corner
from tossid.motion.sessions.fitted_flight import FittedFlight
from tossid.motion.smoothing.smoother import gyration
from tossid.objects import GRAVITY, ObjectModel
from tossid.rotations import quat_boxminus, quat_rotate
from tossid.settings.sessions import LostSettings
from tossid.types import OnDemand, PoseTrack

Array = NDArray[np.float64]

DEFAULT = LostSettings()
_KEPT = 256
"""Mended tracks that stay in memory."""
_GRID = 64
"""Times of an impact that are tried, between the frames of flight around it."""


@dataclass(frozen=True)
class Impact:
    """An impact that ends a flight, or a step in flight that is unlike its neighbours.

    Attributes:
        toss: In which toss.
        first: Whether it is the toss's first contact.
        in_flight: Whether it is no impact.
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
    in_flight: bool = False
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
        impacts: All that end a flight, and steps in flight that stand out, in the order of tosses.
        first: What the first impacts of tosses say.
        later: What the others say.
        in_flight: What steps in flight say.
    """

    impacts: tuple[Impact, ...]
    first: Verdict
    later: Verdict
    in_flight: Verdict

    @property
    def losses(self) -> tuple[Impact, ...]:
        """The impacts at which frames were lost; none where the recording shows no loss at such impacts."""
        return tuple(impact for impact in self.impacts if self._is_lossy(impact) and (impact.lost or 0) > 0)

    @property
    def unjudged(self) -> frozenset[str]:
        """Names of the tosses that may have lost frames at an impact that cannot be judged."""
        hit = [impact for impact in self.impacts if not impact.in_flight]
        return frozenset(i.toss for i in hit if self._is_lossy(i) and (i.lost is None or i.lost < 0))

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

        return OnDemand(mend, len(tracks), kept=_KEPT)

    def facts(self) -> str:
        """What was lost after which frame of which toss, in a line for a dataset's provenance."""
        return "; ".join(f"{i.toss}: {i.lost} after frame {i.last}" for i in self.losses)

    def as_dict(self) -> dict[str, Any]:
        """The verdicts, and the impacts that could be judged, as reports have them."""
        judged = [asdict(impact) for impact in self.impacts if impact.lost is not None]
        verdicts = {name: asdict(getattr(self, name)) for name in ("first", "later", "in_flight")}
        return {**verdicts, "judged": judged}

    @property
    def is_lossy(self) -> bool:
        """Whether frames were lost."""
        return self.first.is_lossy or self.later.is_lossy or self.in_flight.is_lossy

    def _is_lossy(self, impact: Impact) -> bool:
        return (self.in_flight if impact.in_flight else self.first if impact.first else self.later).is_lossy


def find_lost_frames(
    tracks: Sequence[PoseTrack], model: ObjectModel, *, gravity: float = GRAVITY, settings: LostSettings = DEFAULT
) -> LostFrames:
    """The frames that were lost at impacts and in flight.

    Args:
        tracks: As recorded, z up, the ground near z = 0.
        model: The object, without joints.
        gravity: Of free flight [m/s²].
        settings: What is judged.
    """
    long = (track for track in tracks if len(track.t) > settings.fewest_flight)
    impacts = tuple(impact for track in long for impact in _impacts(track, model, gravity, settings))
    hit = [impact for impact in impacts if not impact.in_flight]
    first, later = (_verdict([i for i in hit if i.first is which], settings) for which in (True, False))
    return LostFrames(impacts, first, later, _verdict([i for i in impacts if i.in_flight], settings))


def lost_words(found: LostFrames) -> str | None:
    """What was found of lost frames, in a sentence; None where none were lost.

    Args:
        found: Of a recording.
    """
    if not found.is_lossy:
        return None
    said = [found.first.words("first impacts"), found.later.words("later impacts")]
    if found.in_flight.impacts:
        said.append(found.in_flight.words("uneven steps in flight"))
    return f"frames were lost, and times do not show it: {'; '.join(said)}"


def _verdict(impacts: Sequence[Impact], settings: LostSettings) -> Verdict:
    judged = [impact.lost for impact in impacts if impact.lost is not None]
    counts = tuple(judged.count(k) for k in range(settings.most_lost + 1))
    lost, chance = sum(counts[1:]), len(judged) - sum(counts)
    significant = float(binom.sf(lost - 1, lost + chance, 0.5)) < settings.significance
    return Verdict(len(impacts), counts, chance, significant and lost >= settings.least_share * len(judged))


# ---------------------------------------------------------------- one toss


def _impacts(track: PoseTrack, model: ObjectModel, gravity: float, settings: LostSettings) -> list[Impact]:
    """The impacts of a toss."""
    clear = lowest_corner(model, track.q) > settings.clear_height * model.width
    hit = _impacts_between(track, model, gravity, settings)
    flies = clear & ~hit
    # a frame beside contact may hide an impact, and a recording's first frame is that of a filter
    flies[1:-1] &= clear[:-2] & clear[2:]
    flies[[0, -1]] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flies.astype(int), [0]])))
    runs = [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    touches = np.flatnonzero(np.maximum.accumulate(clear) & (hit | ~clear))
    uneven = [each for run in runs for each in _uneven_steps(track, run, model, gravity, settings)]
    if not len(touches):
        return uneven
    long = [run for run in runs if run[1] - run[0] >= settings.fewest_flight]
    out = []
    if not long or long[0][0] > touches[0]:
        out.append(Impact(track.name, first=True))
    for before, after in itertools.zip_longest(runs, runs[1:]):
        if before not in long or before[1] > touches[-1]:
            continue
        found = None
        if after in long and track.t[after[0]] - track.t[before[1] - 1] <= settings.longest_contact:
            found = _judged(track, before, after, model, gravity, settings)
        out.append(replace(found or Impact(track.name, False), first=not out))
    return out + uneven


def _uneven_steps(
    track: PoseTrack, run: tuple[int, int], model: ObjectModel, gravity: float, settings: LostSettings
) -> list[Impact]:
    """Steps of a flight that are as long as several, and single steps that stand out."""
    begin, end = run
    if end - begin < 2 * settings.fewest_beside:
        return []
    t = track.t[begin:end]
    place = track.q[begin:end, :3] + quat_rotate(track.q[begin:end, 3:7], model.com[0])
    v = np.diff(place, axis=0) / np.diff(t)[:, None]
    v[:, 2] += gravity * (0.5 * (t[1:] + t[:-1]) - t[0])
    usual = np.median(v, axis=0)
    far = np.linalg.norm(v - usual, axis=1)
    stands_out = far > np.maximum(0.5 * np.linalg.norm(usual), settings.tolerance * model.width / np.diff(t))
    out = []
    edges = [begin, *(begin + 1 + np.flatnonzero(stands_out)).tolist(), end]
    for a, b, c in zip(edges, edges[1:], edges[2:], strict=False):
        found = None
        if min(b - a, c - b) >= settings.fewest_beside:
            beside = replace(settings, fewest_flight=settings.fewest_beside)
            found = _judged(track, (a, b), (b, c), model, gravity, beside)
        out.append(replace(found or Impact(track.name, False), in_flight=True))
    return out


def _impacts_between(track: PoseTrack, model: ObjectModel, gravity: float, settings: LostSettings) -> NDArray[np.bool_]:
    """Frames beside an impact between two frames that are both clear of the ground, (n,).

    It shows in the velocity, where the object could reach the ground if frames were lost there.
    """
    h, out = np.diff(track.t)[:, None], np.zeros(len(track.t), dtype=bool)
    v = np.diff(track.q[:, :3] + quat_rotate(track.q[:, 3:7], model.com[0]), axis=0) / h
    spin = quat_boxminus(track.q[1:, 3:7], track.q[:-1, 3:7]) / h
    jump = np.hstack([np.diff(v, axis=0), gyration(model) * np.diff(spin, axis=0)])
    jump[:, 2:3] += 0.5 * gravity * (h[1:] + h[:-1])
    low = lowest_corner(model, track.q)
    # by how much it falls up to a frame, or rises from it on, in each of two intervals: one wrong pose does neither
    rise = np.pad(np.diff(low), 1)
    falls, rises = np.minimum(-rise[:-3], -rise[1:-2]), np.minimum(rise[2:-1], rise[3:])
    reach = settings.clear_height * model.width + (1 + settings.most_lost) * np.maximum(falls, rises)
    moved = np.linalg.norm(jump, axis=1) * np.median(h) > settings.jump * model.width
    out[1:-1] = moved & (low[1:-1] < reach)
    return out


def _judged(
    track: PoseTrack,
    before: tuple[int, int],
    after: tuple[int, int],
    model: ObjectModel,
    gravity: float,
    settings: LostSettings,
) -> Impact | None:
    """The impact between two flights; None where no number of frames, or more than one, joins them."""
    arm, h = gyration(model), float(np.median(np.diff(track.t)))
    counts = range(settings.most_flight, settings.fewest_flight - 1, -1)
    old = _fitted(track, [slice(max(before[0], before[1] - n), before[1]) for n in counts], model, gravity, settings)
    new = _fitted(track, [slice(after[0], min(after[1], after[0] + n)) for n in counts], model, gravity, settings)
    if old is None or new is None:
        return None
    # one number more either side, so that the best has neighbours
    numbers = range(-settings.most_lost - 1, settings.most_lost + 2)
    joins = [_join(old, new, k * h, track.t[before[1] - 1], track.t[after[0]] + max(0, k) * h, arm) for k in numbers]
    misfit = np.array([each for _, each in joins])
    best, second = (int(i) for i in np.argsort(misfit)[:2])
    tolerance = settings.tolerance * model.width
    if misfit[best] > tolerance or misfit[second] < settings.apart * misfit[best]:
        return None
    k, at, last = numbers[best], joins[best][0], before[1] - 1
    if abs(k) > settings.most_lost:
        return None
    if k > 0:
        frames, outlier = range(last, after[0]), settings.apart * tolerance
        last = _last_before(track, old, new, frames, k * h, at, arm, outlier)
    less, least, more = misfit[best - 1 : best + 2] ** 2
    skip = (k + 0.5 * (less - more) / (less - 2 * least + more)) * h
    distances = float(misfit[best]), float(misfit[second])
    return Impact(track.name, False, False, at, k, last, h, float(skip), *distances)


def _fitted(
    track: PoseTrack, stretches: Sequence[slice], model: ObjectModel, gravity: float, settings: LostSettings
) -> FittedFlight | None:
    """The flight of the longest stretch that is one."""
    for some in stretches:
        flight = FittedFlight.fitted(track, some, model, gravity)
        if flight.misfit(track, some, gyration(model)) < settings.flight_tolerance * model.width:
            return flight
    return None


def _join(
    old: FittedFlight, new: FittedFlight, skip: float, first: float, last: float, arm: float
) -> tuple[float, float]:
    """Time at which two flights are nearest when the new one is later by `skip`, and their distance there [m]."""
    s = np.linspace(first, last, _GRID)
    off = old.distance(new, s, s - skip, arm)
    i = int(np.argmin((off**2).sum(axis=1)))
    a, b = max(i - 1, 0), min(i + 1, len(s) - 1)
    rate = (off[b] - off[a]) / (s[b] - s[a])
    at = float(np.clip(s[i] - off[i] @ rate / max(float(rate @ rate), 1e-12), first, last))
    return at, float(np.linalg.norm(off[i] + (at - s[i]) * rate))


def _last_before(
    track: PoseTrack,
    old: FittedFlight,
    new: FittedFlight,
    frames: range,
    skip: float,
    at: float,
    arm: float,
    outlier: float,
) -> int:
    """The last frame before the loss: that for which the frames of the contact lie nearest to the two flights.

    Frames farther than `outlier` [m] count no more than one at this distance. Of equals, the first is taken.
    """
    some = np.array(frames[1:], dtype=int)
    costs = []
    for last in frames:
        t = track.t[some] + np.where(some > last, skip, 0.0)
        flies = t < at
        off = np.where(flies[:, None], old.off(t, track.q[some], arm), new.off(t - skip, track.q[some], arm))
        costs.append(np.minimum(np.linalg.norm(off, axis=1), outlier).sum())
    return frames[int(np.argmin(costs))]
