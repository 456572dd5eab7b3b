"""What flight shows of a planar die: gravity, drag and the centre of mass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from experiments.by_hand.die_recording import Drop, flights
from experiments.by_hand.fits import robust_line

Array = NDArray[np.float64]

LEAST = 8
"""Frames of the shortest flight from which gravity and drag are taken."""


@dataclass(frozen=True)
class Flight:
    """A stretch of flight, as rows of a linear fit, each freed of its own place and velocity.

    Attributes:
        drop: Of which drop.
        first: Whether before the first impact.
        along: (n, 5) what the centre of mass along the body's x and z, gravity and drag do to x [m], and x itself.
        up: (n, 5) the same for z.
        spin: (n, 2) what drag of the spin does to the angle, and the angle [rad].
        rates: (2,) accelerations of parabolas of x and z [m/s²].
        speeds: (2,) velocities of the parabolas at the recording's first frame [m/s].
        begins: (2,) distance of the recording's first frame from them [m].
    """

    drop: str
    first: bool
    along: Array
    up: Array
    spin: Array
    rates: Array
    speeds: Array
    begins: Array


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

    fits = [np.polyfit(drop.t[some] - drop.t[0], each, 2) for each in (x, z)]
    # the tracked point is the centre of mass less its offset, turned; x'' = -drag x', twice integrated, is
    # x = place + velocity t - drag times the integral of x
    return Flight(
        drop.name,
        some.start == 1,
        freed(-c, -s, none, -_integral(t, x), x),
        freed(s, -c, -0.5 * t**2, -_integral(t, z), z),
        freed(-_integral(t, angle), angle),
        np.array([2 * fit[0] for fit in fits]),
        np.array([fit[1] for fit in fits]),
        np.array([drop.x[0] - fits[0][2], drop.z[0] - fits[1][2]]),
    )


def _integral(t: Array, y: Array) -> Array:
    """Integral by trapezia from the first time."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(t))])


def of_flight(some: list[Flight]) -> dict[str, float]:
    """Gravity, the rates of linear drag of velocity and spin, and the centre of mass, which flights share."""
    rows = np.concatenate([rows for f in some for rows in (f.along, f.up)])
    spins = np.concatenate([f.spin for f in some])
    x, z, gravity, drag = robust_line(rows[:, :4], rows[:, 4])
    return {
        "gravity [m/s²]": float(gravity),
        "drag [1/s]": float(drag),
        "drag, spin [1/s]": float(robust_line(spins[:, :1], spins[:, 1])[0]),
        "centre of mass, x [mm]": 1e3 * float(x),
        "centre of mass, z [mm]": 1e3 * float(z),
    }


def of_first_flight(some: list[Flight]) -> dict[str, float]:
    """What flights before the first impact show: all fall at nearly one speed there, and hardly turn."""
    rates, speeds, begins = (np.array([getattr(f, name) for f in some]) for name in ("rates", "speeds", "begins"))
    late = 1e3 * np.median(begins / speeds, axis=0)
    return {
        "falls at [m/s²]": -float(np.median(rates[:, 1])),
        "drag, x [1/s]": -float(np.median(rates[:, 0] / speeds[:, 0])),
        "first frame is too high by [mm]": 1e3 * float(np.median(begins[:, 1])),
        "if it were late, by z [ms]": float(late[1]),
        "if it were late, by x [ms]": float(late[0]),
    }
