"""A planar die analysed by hand, from TUM files of drops in the x-z plane.

    python -m pipelines.tools.experiments.by_hand.die FOLDER

Nothing of the diagnosis takes part: lines and parabolas are fitted to stretches of flight either side of each impact of
a lone corner. From them follow gravity, drag, rebound, sliding friction and the radius of gyration. The unit is the
drop: intervals are those of the median over resampled drops. docs/experiments/die.md has the result.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pipelines.tools.experiments.by_hand.fits import robust_line, with_interval

Array = NDArray[np.float64]

CLEAR = 4e-3
"""Height of the lowest corner above which the die flies [m]."""
PIECE = 9
"""Frames of a piece of flight from which an acceleration is taken."""
NEAR = 13
"""Most frames of flight either side of an impact from which velocities are taken."""
APART = 5
"""Most frames between two flights that belong to one impact."""
LONE = 10e-3
"""Height of the second lowest corner above the lowest at which an impact is that of a lone corner [m]."""
LEAST_SLIP = 0.2
"""Speed at which a corner still slips after an impact whose friction is at its limit [m/s]."""
LEAST_SPIN_CHANGE = 8.0
"""Change of spin from which the radius of gyration is taken [rad/s]."""
LARGEST_JUMP = 0.2
"""Largest distance of the angles before and after an impact [rad]: beyond, more than one corner has hit."""


@dataclass(frozen=True)
class Drop:
    """A drop: times (n,), centre x and z (n,), and the angle about y (n,), without turns."""

    name: str
    t: Array
    x: Array
    z: Array
    angle: Array


@dataclass(frozen=True)
class Piece:
    """A piece of flight: of which drop, whether before the first impact, velocities and accelerations."""

    drop: str
    first: bool
    v: Array
    a: Array


@dataclass(frozen=True)
class Impact:
    """An impact of a lone corner.

    Attributes:
        drop: Of which drop.
        before: (2,) velocity of the corner before it [m/s], along x and z.
        after: (2,) after it.
        impulse: (2,) change of the centre's velocity [m/s].
        spin: Change of spin about y [rad/s].
        arm: (2,) from the centre to the corner where it touches [m].
        lag: By how much the lines of the angle meet earlier than the corner reaches the floor [s].
    """

    drop: str
    before: Array
    after: Array
    impulse: Array
    spin: float
    arm: Array
    lag: float


Shown = TypeVar("Shown", Piece, Impact)


def read_drop(path: Path) -> Drop:
    """A drop of a TUM file whose motion lies in the x-z plane."""
    rows = np.loadtxt(path)
    return Drop(path.stem, rows[:, 0], rows[:, 1], rows[:, 3], np.unwrap(2 * np.arctan2(rows[:, 5], rows[:, 7])))


def corners(angle: float, half: float) -> Array:
    """(4, 2) corners from the centre, along x and z."""
    plain = half * np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
    c, s = np.cos(angle), np.sin(angle)
    return plain @ np.array([[c, s], [-s, c]]).T


def flights(drop: Drop, half: float) -> list[slice]:
    """Stretches of frames in which no corner is near the floor, without their ends."""
    low = np.array([z + corners(angle, half)[:, 1].min() for z, angle in zip(drop.z, drop.angle, strict=True)])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (low > CLEAR).astype(int), [0]])))
    out = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        # the first frame of a recording is off (docs/experiments/die.md)
        some = slice(begin + (2 if begin == 0 else 1), end - 1)
        if some.stop - some.start >= PIECE - 2:
            out.append(some)
    return out


def pieces(drop: Drop, half: float) -> list[Piece]:
    """Pieces of flight, with velocities and accelerations along x and z and about y, from parabolas."""
    out = []
    for k, flight in enumerate(flights(drop, half)):
        for begin in range(flight.start, flight.stop - PIECE + 1, PIECE):
            some = slice(begin, begin + PIECE)
            t = drop.t[some] - drop.t[some].mean()
            fits = [np.polyfit(t, each[some], 2) for each in (drop.x, drop.z, drop.angle)]
            first = k == 0 and flight.start <= 2
            out.append(Piece(drop.name, first, np.array([f[1] for f in fits]), np.array([2 * f[0] for f in fits])))
    return out


def impacts(drop: Drop, half: float, drag: float) -> list[Impact]:
    """Impacts of lone corners between two flights, where flight has a linear drag [1/s]."""
    out = []
    found = flights(drop, half)
    for before, after in itertools.pairwise(found):
        if after.start - before.stop >= APART:
            continue
        at = drop.t[before.stop - 1]
        lines = [
            _lines(drop, slice(max(before.start, before.stop - NEAR), before.stop), at, drag),
            _lines(drop, slice(after.start, min(after.stop, after.start + NEAR)), at, drag),
        ]
        made = _impact(drop.name, lines[0], lines[1], half, drag)
        if made is not None:
            out.append(made)
    return out


def _lines(drop: Drop, some: slice, at: float, drag: float) -> Array:
    """(3, 2) velocity and place at a time, along x and z and about y; gravity and drag are taken out."""
    t = drop.t[some] - at
    out = []
    for values, gravity in ((drop.x, 0.0), (drop.z, 9.81), (drop.angle, 0.0)):
        speed = np.polyfit(t, values[some], 1)[0]
        out.append(np.polyfit(t, values[some] + 0.5 * (gravity + drag * speed) * t**2, 1))
    return np.array(out)


def _impact(name: str, before: Array, after: Array, half: float, drag: float) -> Impact | None:
    """The impact between two flights; None if the corner does not reach the floor, or is not alone."""
    s = np.linspace(-4e-3, 20e-3, 1201)

    def moved(lines: Array) -> tuple[Array, Array]:
        v, x = lines[:, 0], lines[:, 1]
        a = -drag * v - np.array([0.0, 9.81, 0.0])
        return x + np.outer(s, v) + 0.5 * np.outer(s**2, a), v + np.outer(s, a)

    (x0, v0), (x1, v1) = moved(before), moved(after)
    low = np.array([z + corners(angle, half)[:, 1].min() for _, z, angle in x0])
    if not (low < 0).any():
        return None
    k = int(np.argmax(low < 0))
    r = corners(x0[k, 2], half)
    order = np.argsort(r[:, 1])
    arm, jump = r[order[0]], x1[:, 2] - x0[:, 2]
    jump -= 2 * np.pi * np.round(jump[k] / (2 * np.pi))
    if r[order[1], 1] - arm[1] < LONE or abs(jump[k]) > LARGEST_JUMP:
        return None
    # omega x r about y: (omega r_z, -omega r_x)
    across = np.array([arm[1], -arm[0]])
    corner0, corner1 = v0[k, :2] + v0[k, 2] * across, v1[k, :2] + v1[k, 2] * across
    if corner0[1] > -0.5:
        return None
    lag = float(s[k] - s[int(np.argmin(np.abs(jump)))])
    return Impact(name, corner0, corner1, (v1 - v0)[k, :2], float(v1[k, 2] - v0[k, 2]), arm, lag)


# ---------------------------------------------------------------- what follows


def of_flight(some: list[Piece]) -> dict[str, float]:
    """Gravity and the rates of linear drag along x and z and about y, from pieces of flight."""
    v, a = np.array([p.v for p in some]), np.array([p.a for p in some])
    z = robust_line(np.column_stack([np.ones(len(v)), v[:, 1]]), a[:, 1])
    rates = [-float(robust_line(v[:, k : k + 1], a[:, k])[0]) for k in (0, 2)]
    return {
        "gravity [m/s²]": -float(z[0]),
        "drag, z [1/s]": -float(z[1]),
        "drag, x [1/s]": rates[0],
        "drag, spin [1/s]": rates[1],
    }


def of_impacts(some: list[Impact]) -> dict[str, float]:
    """Medians of rebound, sliding friction, squared radius of gyration [mm²] and lag [ms] over impacts."""
    before, after, impulse = (np.array([getattr(i, name) for i in some]) for name in ("before", "after", "impulse"))
    spin, arm = np.array([i.spin for i in some]), np.array([i.arm for i in some])
    slides = (np.sign(before[:, 0]) == np.sign(after[:, 0])) & (np.abs(after[:, 0]) > LEAST_SLIP)
    turned = np.abs(spin) > LEAST_SPIN_CHANGE
    moment = arm[:, 1] * impulse[:, 0] - arm[:, 0] * impulse[:, 1]
    lag = 1e3 * np.array([i.lag for i in some])
    values = {
        "rebound": -after[:, 1] / before[:, 1],
        "sliding friction": (np.abs(impulse[:, 0]) / impulse[:, 1])[slides],
        "radius of gyration² [mm²]": 1e6 * (moment[turned] / spin[turned]),
        "angle leads height [ms]": lag[turned],
    }
    return {name: float(np.median(each)) if len(each) else np.nan for name, each in values.items()}


def scatter_of_impacts(some: list[Impact]) -> dict[str, Array]:
    """(5,) quantiles (5, 25, 50, 75, 95 %) over impacts. Under one law with one set of numbers they would agree."""
    turned = [i for i in some if abs(i.spin) > LEAST_SPIN_CHANGE]
    gyration = 1e-6 * of_impacts(some)["radius of gyration² [mm²]"]
    moment = np.array([i.arm[1] * i.impulse[0] - i.arm[0] * i.impulse[1] for i in turned])
    values = {
        "rebound": np.array([-i.after[1] / i.before[1] for i in some]),
        "change of spin less that of its impulse [rad/s]": np.array([i.spin for i in turned]) - moment / gyration,
        "angle leads height [ms]": np.array([1e3 * i.lag for i in turned]),
    }
    return {name: np.percentile(each, [5, 25, 50, 75, 95]) for name, each in values.items()}


def by_drop(some: Sequence[Shown]) -> list[list[Shown]]:
    """Pieces or impacts, those of a drop together."""
    return [[each for each in some if each.drop == name] for name in sorted({each.drop for each in some})]


def main() -> None:
    """Print the table of a folder of drops."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--half", type=float, default=0.03, help="half of the die's side [m]")
    parser.add_argument("--drag", type=float, default=0.45, help="linear drag between impacts [1/s]")
    given = parser.parse_args()
    drops = [read_drop(path) for path in sorted(given.folder.glob("*.txt"))]
    flying = [piece for drop in drops for piece in pieces(drop, given.half)]
    # a piece across an impact that no corner height shows has another acceleration altogether
    flying = [p for p in flying if abs(p.a[1] + 9.81) < 4 and abs(p.a[0]) < 4]
    hits = [hit for drop in drops for hit in impacts(drop, given.half, given.drag)]
    parts = {
        "before the first impact": [p for p in flying if p.first],
        "between impacts": [p for p in flying if not p.first],
        "all flight": flying,
    }
    print("| of | figure | value | 95 % interval | drops |\n|---|---|---|---|---|")  # noqa: T201
    for where, some in parts.items():
        rows = with_interval(by_drop(some), of_flight)
        if where.startswith("before"):
            # all fall at nearly one speed, so gravity and drag are one number there
            fall = with_interval(
                by_drop(some), lambda part: {"falls at [m/s²]": -float(np.median([p.a[1] for p in part]))}
            )
            rows = {**fall, **{name: rows[name] for name in ("drag, x [1/s]", "drag, spin [1/s]")}}
        _print(where, rows, len({p.drop for p in some}))
    _print("impacts of a lone corner", with_interval(by_drop(hits), of_impacts), len({h.drop for h in hits}))
    print("\n| over impacts | 5 % | 25 % | 50 % | 75 % | 95 % |\n|---|---|---|---|---|---|")  # noqa: T201
    for name, quantiles in scatter_of_impacts(hits).items():
        print(f"| {name} | {' | '.join(f'{x:.3g}' for x in quantiles)} |")  # noqa: T201


def _print(where: str, rows: dict[str, Array], count: int) -> None:
    for name, (value, low, high) in rows.items():
        print(f"| {where} | {name} | {value:.3g} | {low:.3g} to {high:.3g} | {count} |")  # noqa: T201


if __name__ == "__main__":
    main()
