"""A bouncing ball analysed by hand, from TUM files of one bounce each on a floor at z = 0.

    python -m experiments.by_hand.ball FOLDER

Nothing of the diagnosis takes part. One linear fit to all bounces gives gravity, quadratic drag, the ball's centre in
the tracked frame, and the velocities either side of each bounce. From these and the spins follow rebound, tangential
rebound, radius of gyration and the time on the ground. The unit is the bounce: intervals are over resampled bounces.
docs/results/by-hand.md has the result.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from experiments.by_hand.fits import robust_line, with_interval

Array = NDArray[np.float64]

CLEAR = 5e-3
"""Height of the tracked point above the radius from which a frame counts as flight [m]."""
FALL = 0.06
"""Time before the lowest frame from which the fall is used [s]: before it, a hand may still push the ball."""
RISE = 0.12
"""Time after the lowest frame up to which the rise is used [s]."""
FASTEST_SPIN = 40.0
"""Rate of turning between two frames beyond which the tracker has jumped [rad/s]: the bounce is left out."""
LEAST_SPIN_CHANGE = 3.0
"""Change of spin from which the radius of gyration is taken [rad/s]."""


@dataclass(frozen=True)
class Bounce:
    """A bounce: times (n,) from the lowest frame, tracked points (n, 3), rotations, frames of fall and of rise (n,)."""

    name: str
    t: Array
    p: Array
    q: Rotation
    parts: tuple[NDArray[np.bool_], NDArray[np.bool_]]


@dataclass(frozen=True)
class Flight:
    """Gravity, quadratic drag, the centre in the tracked frame, which all bounces share, and the residual's size [m].

    `lines` are (2, 2, 3) by bounce: before and after, place and velocity of the centre at the time of the lowest frame.
    """

    gravity: float
    drag: float
    centre: Array
    lines: dict[str, Array]
    residual: float


def read_bounce(path: Path, radius: float) -> Bounce:
    """A bounce of a TUM file."""
    rows = np.loadtxt(path)
    low = int(rows[:, 3].argmin())
    t, high = rows[:, 0] - rows[low, 0], rows[:, 3] > radius + CLEAR
    parts = (high & (t < 0) & (t > -FALL), high & (t > 0) & (t < RISE))
    return Bounce(path.stem, t, rows[:, 1:4], Rotation.from_quat(rows[:, 4:]), parts)


def jumps(bounce: Bounce) -> bool:
    """Whether the tracker's rotation jumps between two frames."""
    turned = (bounce.q[1:] * bounce.q[:-1].inv()).magnitude()
    return bool((turned / np.diff(bounce.t) > FASTEST_SPIN).any())


def fit_flight(some: list[Bounce], offset: bool = True) -> Flight:
    """Gravity, drag, centre and lines from one linear least squares fit; drag acts along velocities of a first fit."""
    blocks, values, count = [], [], 12 * len(some)
    for k, bounce in enumerate(some):
        for side, part in enumerate(bounce.parts):
            t, p = bounce.t[part], bounce.p[part]
            slope = np.array([np.polyfit(t, p[:, axis], 2) for axis in range(3)])
            grid = np.linspace(min(0.0, t.min()), max(0.0, t.max()), 401)
            v = slope[:, 1] + 2 * np.outer(grid, slope[:, 0])
            once = _integral(grid, -np.linalg.norm(v, axis=1, keepdims=True) * v)
            twice = _integral(grid, once)
            turned = bounce.q[part].as_matrix()
            for axis in range(3):
                block = np.zeros((len(t), count + 5))
                at = 12 * k + 6 * side + 2 * axis
                block[:, at], block[:, at + 1] = 1.0, t
                block[:, count] = -0.5 * t**2 if axis == 2 else 0.0
                block[:, count + 1] = np.interp(t, grid, twice[:, axis])
                block[:, count + 2 :] = turned[:, axis] if offset else 0.0
                blocks.append(block)
                values.append(p[:, axis])
    a, y = np.concatenate(blocks), np.concatenate(values)
    x = robust_line(a, y)  # single frames are off by more than a millimetre
    r = y - a @ x
    lines = {b.name: x[12 * k : 12 * k + 12].reshape(2, 3, 2).transpose(0, 2, 1) for k, b in enumerate(some)}
    return Flight(float(x[count]), float(x[count + 1]), -x[count + 2 :], lines, np.sqrt(np.mean(r**2)))


def _integral(t: Array, y: Array) -> Array:
    """Integral by trapezia, zero at t = 0."""
    steps = 0.5 * (y[1:] + y[:-1]) * np.diff(t)[:, None]
    total = np.concatenate([np.zeros((1, y.shape[1])), np.cumsum(steps, axis=0)])
    return np.asarray(total - total[int(np.argmin(np.abs(t)))], dtype=np.float64)


def spin(bounce: Bounce, side: int) -> Array:
    """(3,) constant angular velocity of the fall or the rise [rad/s]."""
    part = bounce.parts[side]
    q, t = bounce.q[part], bounce.t[part]
    turned = (q * q[len(t) // 2].inv()).as_rotvec()
    return np.asarray(np.polyfit(t, turned, 1)[0], dtype=np.float64)


def of_bounce(bounce: Bounce, flight: Flight, radius: float) -> dict[str, float]:
    """The figures of one bounce, at the times when the centre passes the height of the radius."""
    times, speeds = [], []
    for place, v in flight.lines[bounce.name]:
        s = np.linspace(-0.03, 0.03, 6001)
        rate = -flight.drag * np.linalg.norm(v) * v - np.array([0.0, 0.0, flight.gravity])
        height = place[2] + s * v[2] + 0.5 * s**2 * rate[2]
        at = float(s[int(np.argmin(np.abs(height - radius)))])
        times.append(at)
        speeds.append(v + at * rate)
    turned = np.array([spin(bounce, 0), spin(bounce, 1)])
    centre = bounce.p + bounce.q.apply(flight.centre)
    slips = np.array([v[:2] + radius * np.array([-w[1], w[0]]) for v, w in zip(speeds, turned, strict=True)])
    push, turn = (speeds[1] - speeds[0])[:2], (turned[1] - turned[0])[:2]
    # impulse times arm about the centre, per unit of mass: (-radius z) x push
    moment = radius * np.array([push[1], -push[0]])
    large = np.linalg.norm(turn) > LEAST_SPIN_CHANGE
    return {
        "closing speed [m/s]": -speeds[0][2],
        "rebound": -speeds[1][2] / speeds[0][2],
        "tangential rebound": -float(slips[1] @ slips[0] / (slips[0] @ slips[0])),
        "impulse along over across the floor": float(np.linalg.norm(push) / (speeds[1] - speeds[0])[2]),
        "radius of gyration² over radius²": float(moment @ turn / (turn @ turn)) / radius**2 if large else np.nan,
        "time on the ground [ms]": 1e3 * (times[1] - times[0]),
        "least depth [mm]": 1e3 * float(radius - centre[:, 2].min()),
        "slip before [m/s]": float(np.linalg.norm(slips[0])),
    }


def medians(rows: list[dict[str, float]]) -> dict[str, float]:
    """The median of each figure over bounces."""
    return {name: float(np.nanmedian([row[name] for row in rows])) for name in rows[0]}


COMMON: dict[str, Callable[[Flight], float]] = {
    "gravity [m/s²]": lambda flight: flight.gravity,
    "quadratic drag [1/m]": lambda flight: flight.drag,
    "centre, x [mm]": lambda flight: 1e3 * flight.centre[0],
    "centre, y [mm]": lambda flight: 1e3 * flight.centre[1],
    "centre, z [mm]": lambda flight: 1e3 * flight.centre[2],
}
"""What all bounces share."""


def main() -> None:
    """Print the table of a folder of bounces."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--radius", type=float, default=0.119, help="radius of the ball [m]")
    given = parser.parse_args()
    bounces = [read_bounce(path, given.radius) for path in sorted(given.folder.glob("*.txt"))]
    kept = [bounce for bounce in bounces if not jumps(bounce)]
    print(f"left out: {', '.join(b.name for b in bounces if jumps(b)) or 'none'}")
    flight, fixed = fit_flight(kept), fit_flight(kept, offset=False)
    sizes = [1e3 * each.residual for each in (fixed, flight)]
    print(f"residual [mm]: {sizes[0]:.3f}, with the centre free {sizes[1]:.3f}")
    rng = np.random.default_rng(0)
    drawn = [fit_flight([kept[i] for i in sorted(rng.integers(0, len(kept), len(kept)))]) for _ in range(100)]
    print("\n| of all flight | value | 95 % interval |\n|---|---|---|")
    for name, of in COMMON.items():
        low, high = np.percentile([of(each) for each in drawn], [2.5, 97.5])
        print(f"| {name} | {of(flight):.3g} | {low:.3g} to {high:.3g} |")
    for where, fitted in (("at the tracked frame's origin", fixed), ("free", flight)):
        print(f"\n| centre {where} | value | 95 % interval | least | most |\n|---|---|---|---|---|")
        rows = [of_bounce(bounce, fitted, given.radius) for bounce in kept]
        for name, (value, low, high) in with_interval([[row] for row in rows], medians, 2000).items():
            each = np.array([row[name] for row in rows])
            ends = f"{np.nanmin(each):.3g} | {np.nanmax(each):.3g}"
            print(f"| {name} | {value:.3g} | {low:.3g} to {high:.3g} | {ends} |")


if __name__ == "__main__":
    main()
