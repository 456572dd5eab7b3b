"""What impacts of lone corners show of a planar die: lost frames, radius of the corners, rebound, friction, inertia."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from experiments.by_hand.die_recording import SIGNS, Drop, flights, floor_of, turned
from experiments.by_hand.fits import robust_line

Array = NDArray[np.float64]

GRAVITY = 9.81
"""Of which lines of flight are freed [m/s²]."""
NEAR = 12
"""Most frames of flight either side of an impact from which velocities are taken."""
APART = 12
"""Most frames between two flights that belong to one impact."""
MOST_LOST = 3
"""Most frames that an impact may have lost."""
JOINED = 0.3e-3
"""Largest distance of the poses either side of an impact, where they join [m]; angles count by half of a side."""
LONE = 10e-3
"""Height of the second lowest corner above the lowest at which an impact is that of a lone corner [m]."""
LEAST_SLIP = 0.2
"""Speed at which a corner still slips after an impact whose friction is at its limit [m/s]."""


@dataclass(frozen=True)
class Impact:
    """An impact of a lone corner. Velocities are those of the centre of mass along x and z [m/s], and the spin [rad/s].

    Attributes:
        drop: Of which drop.
        first: Whether it is the first of the drop.
        lost: How many frames the recording lost there; None if no number of them, or more than one, joins the flights.
        skip: How many would join them best, if not a whole number.
        due: When the first frame after the impact was due, lost or not, from the impact [s].
        before: (3,) velocities before it.
        after: (3,) after it.
        place: x of the middle [m].
        arm: (2,) from the centre of mass to the tip of a sharp corner [m].
        inward: (2,) from there to the tip of a rounded corner, for a unit of radius.
        depth: Of the tip of a sharp corner below the floor [m]; NaN where the floor is not known.
    """

    drop: str
    first: bool
    lost: int | None
    skip: float
    due: float
    before: Array
    after: Array
    place: float
    arm: Array
    inward: Array
    depth: float


def impacts(drop: Drop, half: Array, centre: Array, drag: float) -> list[Impact]:
    """Impacts of lone corners between two flights.

    Lines of x, z and the angle before and after an impact meet at one time, if the frames that were lost there are
    counted. An impact of more than one corner joins for no number of them.

    Args:
        drop: With times in which frames lost in flight are counted.
        half: (2,) halves of the sides [m].
        centre: (2,) centre of mass from the middle, in the body [m].
        drag: Linear drag in flight [1/s].
    """
    out, floor, weights = [], floor_of(drop, half), np.array([1.0, 1.0, half.mean()])
    for k, (one, two) in enumerate(itertools.pairwise(flights(drop, half))):
        if two.start - one.stop > APART:
            continue
        at = drop.t[one.stop - 1]
        before = _lines(drop, slice(max(one.start, one.stop - NEAR), one.stop), at, centre, drag)
        after = _lines(drop, slice(two.start, min(two.stop, two.start + NEAR)), at, centre, drag)
        joins = [_join(before, after, n * drop.dt, weights, drag) for n in range(MOST_LOST + 1)]
        lost = int(np.argmin([apart for _, apart in joins]))
        time = joins[lost][0]
        (v0, p0), (v1, p1) = _moved(before, time, drag), _moved(after, time - lost * drop.dt, drag)
        pose = 0.5 * (p0 + p1)
        angle, reach = pose[2], turned(pose[2], half * SIGNS)
        lowest, second = np.argsort(reach[:, 1])[:2]
        if reach[second, 1] - reach[lowest, 1] < LONE:
            continue
        middle = pose[:2] - turned(angle, centre)
        # with the time of the impact free, too: three equations, two unknowns
        more = np.linalg.lstsq(weights[:, None] * np.column_stack([v1 - v0, -v1]), weights * (p0 - p1), rcond=None)[0][
            1
        ]
        out.append(
            Impact(
                drop.name,
                k == 0 and one.start == 1,
                lost if sum(apart < JOINED for _, apart in joins) == 1 else None,
                lost + float(more) / drop.dt,
                _first_of_after(drop, slice(one.stop - 1, two.start + 1), centre, (before, after), weights, drag)
                - time,
                v0,
                v1,
                float(middle[0]),
                reach[lowest] - turned(angle, centre),
                -turned(angle, SIGNS[lowest]) - np.array([0.0, 1.0]),
                floor - float(middle[1] + reach[lowest, 1]),
            )
        )
    return out


def _seen(drop: Drop, some: slice, centre: Array) -> Array:
    """(n, 3) place of the centre of mass, and the angle."""
    offset = turned(drop.angle[some], centre)
    return np.column_stack([drop.x[some] + offset[:, 0], drop.z[some] + offset[:, 1], drop.angle[some]])


def _lines(drop: Drop, some: slice, at: float, centre: Array, drag: float) -> Array:
    """(2, 3) velocity and place of the centre of mass and the angle at a time, from lines freed of gravity and drag."""
    t, seen = drop.t[some] - at, _seen(drop, some, centre)
    slows = drag * np.polyfit(t, seen, 1)[0] + np.array([0.0, GRAVITY, 0.0])
    return np.asarray(np.polyfit(t, seen + 0.5 * np.outer(t**2, slows), 1), dtype=np.float64)


def _first_of_after(
    drop: Drop, some: slice, centre: Array, flown: tuple[Array, Array], weights: Array, drag: float
) -> float:
    """Recorded time of the first of some frames that is nearer to the flight after than to that before [s]."""
    times = drop.t[some] - drop.t[some.start]
    for time, seen in zip(times, _seen(drop, some, centre), strict=True):
        before, after = (float(np.linalg.norm(weights * (seen - _moved(each, time, drag)[1]))) for each in flown)
        if after < before:
            return float(time)
    return np.nan


def _moved(lines: Array, s: float, drag: float) -> tuple[Array, Array]:
    """(3,) velocity and (3,) place at a time."""
    a = -drag * lines[0] - np.array([0.0, GRAVITY, 0.0])
    return lines[0] + s * a, lines[1] + s * lines[0] + 0.5 * s**2 * a


def _join(one: Array, two: Array, skip: float, weights: Array, drag: float) -> tuple[float, float]:
    """When two flights come nearest, if times after the impact are too early by a skip [s], and how near [m]."""
    time, apart = 0.0, np.zeros(3)
    for _ in range(4):
        (v0, p0), (v1, p1) = _moved(one, time, drag), _moved(two, time - skip, drag)
        apart, rate = weights * (p1 - p0), weights * (v1 - v0)
        time -= float(apart @ rate / (rate @ rate))
    return time, float(np.linalg.norm(apart))


# ---------------------------------------------------------------- what follows


@dataclass(frozen=True)
class Contact:
    """Impacts of corners of one radius.

    Attributes:
        before: (n, 2) velocities of the contact before the impact, along x and z [m/s].
        after: (n, 2) after it.
        impulse: (n, 2) for a unit of mass [m/s].
        spin: (n,) changes of spin [rad/s].
        moment: (n,) of the impulse about the centre of mass [m²/s].
    """

    before: Array
    after: Array
    impulse: Array
    spin: Array
    moment: Array

    @property
    def rebound(self) -> Array:
        """(n,) speed off the floor after the impact over that onto it."""
        return np.asarray(-self.after[:, 1] / self.before[:, 1])

    @property
    def slides(self) -> NDArray[np.bool_]:
        """(n,) whether the corner keeps slipping one way, so that friction is at its limit."""
        same = np.sign(self.before[:, 0]) == np.sign(self.after[:, 0])
        return np.asarray(same & (np.abs(self.after[:, 0]) > LEAST_SLIP))

    @property
    def friction(self) -> Array:
        """(n,) impulse along the floor against the slip before, over that off the floor."""
        return np.asarray(-np.sign(self.before[:, 0]) * self.impulse[:, 0] / self.impulse[:, 1])


def contacts(some: list[Impact], radius: float) -> Contact:
    """The impacts as those of corners of a radius [m]."""
    before, after = np.array([i.before for i in some]), np.array([i.after for i in some])
    arm = np.array([i.arm + radius * i.inward for i in some])
    across = np.column_stack([arm[:, 1], -arm[:, 0]])  # omega x arm about y
    impulse = (after - before)[:, :2]
    return Contact(
        before[:, :2] + before[:, 2:] * across,
        after[:, :2] + after[:, 2:] * across,
        impulse,
        (after - before)[:, 2],
        np.sum(across * impulse, axis=1),
    )


def radius_by_spin(some: list[Impact]) -> tuple[float, float]:
    """Radius of the corners [m] and squared radius of gyration [m²], so that impulses turn the die as it turned.

    The moment of an impulse grows linearly with the radius: moment = gyration² spin for the right one.
    """
    sharp = contacts(some, 0.0)
    unit = sharp.moment - contacts(some, 1.0).moment
    gyration, radius = robust_line(np.column_stack([sharp.spin, unit]), sharp.moment)
    return float(radius), float(gyration)


def radius_by_depth(some: list[Impact], power: float = 1.0) -> tuple[float, Array]:
    """Radius of the corners [m] by depth, and what of the depths (n,) it leaves [m].

    The tip of a rounded corner is higher than that of a sharp one. Lines of flight meet when half of the impulse has
    passed. Until then the corner is pressed in, by an amount that grows with a power of its speed.
    """
    known = [i for i in some if np.isfinite(i.depth)]
    speed, depth = -contacts(known, 0.0).before[:, 1], np.array([i.depth for i in known])
    columns = np.column_stack([[i.inward[1] for i in known], speed**power])
    both = robust_line(columns, depth)
    return float(both[0]), np.asarray(depth - columns @ both)


def of_impacts(some: list[Impact]) -> dict[str, float]:
    """Speed, rebound, friction, radius of gyration and that of the corners of impacts that join."""
    radius, gyration = radius_by_spin(some)
    deep = radius_by_depth(some)[0]
    hit, sharp, round_ = (contacts(some, each) for each in (radius, 0.0, deep))
    slides, lifts = hit.slides, hit.impulse[:, 1]
    law = robust_line(np.column_stack([np.ones(slides.sum()), np.log(lifts[slides])]), np.log(hit.friction[slides]))
    return {
        "closing speed [m/s]": -float(np.median(hit.before[:, 1])),
        "rebound": float(np.median(hit.rebound)),
        "sliding friction": float(np.median(hit.friction[slides])),
        "friction goes with the impulse to the power": float(law[1]),
        "radius of gyration² [mm²]": 1e6 * gyration,
        "radius of corners, by spin [mm]": 1e3 * radius,
        "radius of corners, by depth [mm]": 1e3 * deep,
        "the same, pressed in by the root of the speed [mm]": 1e3 * radius_by_depth(some, 0.5)[0],
        "radius of gyration², were corners sharp [mm²]": 1e6 * float(robust_line(sharp.spin[:, None], sharp.moment)[0]),
        "the same, by the radius by depth [mm²]": 1e6 * float(robust_line(round_.spin[:, None], round_.moment)[0]),
    }


def scatter_of_impacts(some: list[Impact]) -> dict[str, Array]:
    """(5,) quantiles (5, 25, 50, 75, 95 %) over impacts. Under one law with one set of numbers they would agree."""
    radius, gyration = radius_by_spin(some)
    hit = contacts(some, radius)
    spin = hit.spin - hit.moment / gyration
    values = {
        "rebound": hit.rebound,
        "sliding friction": hit.friction[hit.slides],
        "change of spin less that of its impulse [rad/s]": spin,
        "the same, as an error of the arm [mm]": 1e3 * gyration * spin / hit.impulse[:, 1],
        "depth less that of round corners [mm]": 1e3 * radius_by_depth(some)[1],
        "frames lost, less the whole number": np.array([i.skip - (i.lost or 0) for i in some]),
    }
    return {name: np.percentile(each, [5, 25, 50, 75, 95]) for name, each in values.items()}


def correlations_of_impacts(some: list[Impact]) -> dict[str, tuple[float, float]]:
    """Rank correlations of rebounds, and of changes of spin less those of impulses, with what differs by impact."""
    radius, gyration = radius_by_spin(some)
    hit, left = contacts(some, radius), np.array([i.inward[0] for i in some])
    spin, order = hit.spin - hit.moment / gyration, sorted({i.drop for i in some})
    against = {
        "place": np.array([i.place for i in some]),
        "side": np.sign(left),
        "tilt": left,
        "closing speed": -hit.before[:, 1],
        "slip before": hit.before[:, 0],
        "size of the slip over the closing speed": np.abs(hit.before[:, 0] / hit.before[:, 1]),
        "spin before": np.array([i.before[2] for i in some]),
        "change of spin": hit.spin,
        "order of the drops": np.array([order.index(i.drop) for i in some]),
        "first or later": np.array([float(i.first) for i in some]),
        "frames lost": np.array([i.lost for i in some]),
    }
    return {
        name: (float(spearmanr(each, hit.rebound).statistic), float(spearmanr(each, spin).statistic))
        for name, each in against.items()
        if np.ptp(each) > 0
    }
