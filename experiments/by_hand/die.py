"""A planar die analysed by hand, from TUM files of drops in the x-z plane.

    python -m experiments.by_hand.die FOLDER

Nothing of the diagnosis takes part. One linear fit to stretches of flight gives gravity, drag and the centre of mass.
Lines of flight either side of an impact have to join, which says when it was and how many frames were lost there. The
velocities give rebound, sliding friction, the radius of gyration and that of the corners. The unit is the drop:
intervals are of the same figures over resampled drops. docs/results/by-hand.md has the result.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from experiments.by_hand.die_recording import (
    SIGNS,
    Drop,
    flights,
    floor_of,
    halves,
    heights_by_face,
    lost_in_flight,
    read_drop,
    turned,
    with_true_times,
)
from experiments.by_hand.fits import robust_line, with_interval

Array = NDArray[np.float64]

RESAMPLES = 200
"""Draws of drops for each interval."""
LEAST = 8
"""Frames of the shortest flight from which gravity and drag are taken."""
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


# ---------------------------------------------------------------- flight


@dataclass(frozen=True)
class Flight:
    """A stretch of flight, as rows of a linear fit, each freed of its own place and velocity.

    Attributes:
        drop: Of which drop.
        first: Whether before the first impact.
        along: (n, 5) what the centre of mass along the body's x and z, gravity and drag do to x [m], and x itself.
        up: (n, 5) the same for z.
    """

    drop: str
    first: bool
    along: Array
    up: Array


def flights_of(drop: Drop, half: Array) -> list[Flight]:
    """The flights of a drop that are long enough; halves of the sides are (2,) [m]."""
    return [_flight(drop, some) for some in flights(drop, half) if some.stop - some.start >= LEAST]


def _flight(drop: Drop, some: slice) -> Flight:
    t, x, z, angle = drop.t[some] - drop.t[some].mean(), drop.x[some], drop.z[some], drop.angle[some]
    none, c, s = np.zeros_like(t), np.cos(angle), np.sin(angle)
    line = np.column_stack([np.ones_like(t), t])

    def freed(*columns: Array) -> Array:
        every = np.column_stack(columns)
        return np.asarray(every - line @ np.linalg.lstsq(line, every, rcond=None)[0], dtype=np.float64)

    # the tracked point is the centre of mass less its offset, turned; x'' = -drag x', twice integrated, is
    # x = place + velocity t - drag times the integral of x
    return Flight(
        drop.name,
        some.start == 1,
        freed(-c, -s, none, -_integral(t, x), x),
        freed(s, -c, -0.5 * t**2, -_integral(t, z), z),
    )


def _integral(t: Array, y: Array) -> Array:
    """Integral by trapezia from the first time."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(t))])


def of_flight(some: list[Flight]) -> dict[str, float]:
    """Gravity, the rate of linear drag and the centre of mass, which flights share."""
    rows = np.concatenate([rows for f in some for rows in (f.along, f.up)])
    x, z, gravity, drag = robust_line(rows[:, :4], rows[:, 4])
    return {
        "gravity [m/s²]": float(gravity),
        "drag [1/s]": float(drag),
        "centre of mass, x [mm]": 1e3 * float(x),
        "centre of mass, z [mm]": 1e3 * float(z),
    }


# ---------------------------------------------------------------- impacts


@dataclass(frozen=True)
class Impact:
    """An impact of a lone corner. Velocities are those of the centre of mass along x and z [m/s], and the spin [rad/s].

    Attributes:
        drop: Of which drop.
        first: Whether it is the first of the drop.
        lost: How many frames the recording lost there; None if no number of them, or more than one, joins the flights.
        before: (3,) velocities before it.
        after: (3,) after it.
        arm: (2,) from the centre of mass to the tip of a sharp corner [m].
        inward: (2,) from there to the tip of a rounded corner, for a unit of radius.
        depth: Of the tip of a sharp corner below the floor [m]; NaN where the floor is not known.
    """

    drop: str
    first: bool
    lost: int | None
    before: Array
    after: Array
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
        out.append(
            Impact(
                drop.name,
                k == 0 and one.start == 1,
                lost if sum(apart < JOINED for _, apart in joins) == 1 else None,
                v0,
                v1,
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


def radius_by_depth(some: list[Impact]) -> float:
    """Radius of the corners [m] by depth.

    The tip of a rounded corner is higher than that of a sharp one. Lines of flight meet when half of the impulse has
    passed. Until then the corner is pressed in, by an amount that grows with its speed.
    """
    known = [i for i in some if np.isfinite(i.depth)]
    speed, depth = -contacts(known, 0.0).before[:, 1], np.array([i.depth for i in known])
    return float(robust_line(np.column_stack([[i.inward[1] for i in known], speed]), depth)[0])


def of_impacts(some: list[Impact]) -> dict[str, float]:
    """Speed, rebound, friction, radius of gyration and that of the corners of impacts that join."""
    radius, gyration = radius_by_spin(some)
    hit = contacts(some, radius)
    return {
        "closing speed [m/s]": -float(np.median(hit.before[:, 1])),
        "rebound": float(np.median(hit.rebound)),
        "sliding friction": float(np.median(hit.friction[hit.slides])),
        "radius of gyration² [mm²]": 1e6 * gyration,
        "radius of corners, by spin [mm]": 1e3 * radius,
        "radius of corners, by depth [mm]": 1e3 * radius_by_depth(some),
    }


# ---------------------------------------------------------------- tables


Part = TypeVar("Part", Flight, Impact)


def main() -> None:
    """Print the tables of a folder of drops."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--half", type=float, default=0.03, help="half of the die's side [m]")
    given = parser.parse_args()
    recorded = [read_drop(path) for path in sorted(given.folder.glob("*.txt"))]
    half = halves(heights_by_face(recorded), given.half)
    drops = [with_true_times(drop, lost_in_flight(drop, half)) for drop in recorded]
    later = [flight for drop in drops for flight in flights_of(drop, half) if not flight.first]
    flight = of_flight(later)
    centre = 1e-3 * np.array([flight[f"centre of mass, {axis} [mm]"] for axis in "xz"])
    every = [hit for drop in drops for hit in impacts(drop, half, centre, flight["drag [1/s]"])]
    hits = [hit for hit in every if hit.lost is not None]
    print("| of | figure | value | 95 % interval | drops |\n|---|---|---|---|---|")
    _print("flight, after the first impact", later, of_flight)
    _print("impacts of a lone corner", hits, of_impacts)
    _print("first ones", [hit for hit in hits if hit.first], of_impacts)
    _print("later ones", [hit for hit in hits if not hit.first], of_impacts)
    print("\n| impacts of a lone corner | lost 0 frames | 1 | 2 | 3 | do not join |\n|---|---|---|---|---|---|")
    for where, first in (("first", True), ("later", False)):
        lost = [hit.lost for hit in every if hit.first == first]
        counts = [str(lost.count(n)) for n in (*range(MOST_LOST + 1), None)]
        print(f"| {where} | {' | '.join(counts)} |")


def _print(where: str, some: Sequence[Part], figures: Callable[[list[Part]], Mapping[str, float]]) -> None:
    """Rows of figures of flights or impacts; those of a drop are drawn together."""
    by_drop = [[each for each in some if each.drop == name] for name in sorted({each.drop for each in some})]
    rows = with_interval(by_drop, figures, RESAMPLES) if some else {}
    for name, (value, low, high) in rows.items():
        print(f"| {where} | {name} | {value:.3g} | {low:.3g} to {high:.3g} | {len(by_drop)} |")


if __name__ == "__main__":
    main()
