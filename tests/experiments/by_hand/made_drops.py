"""Drops of a planar die that are made by one law: flight with linear drag, and one impact of a lone, rounded corner."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from experiments.by_hand.die_recording import SIGNS, Drop, read_drop, turned

Array = NDArray[np.float64]

DT = 0.004
NOISE = np.array([1.4e-5, 3.5e-5, 7e-4])
"""Standard deviations of x and z [m] and of the angle [rad], as third differences of the real recordings have them."""
LEAST = 25
"""Frames that a drop flies at least after its impact: others are thrown anew."""


@dataclass(frozen=True)
class Law:
    """What makes a drop. Lengths in m, gyration in m²."""

    half: tuple[float, float] = (0.0298, 0.0302)
    radius: float = 0.006
    centre: tuple[float, float] = (4e-4, -2e-4)
    gravity: float = 9.8
    drag: float = 0.4
    rebound: float = 0.45
    friction: float = 0.1
    gyration: float = 450e-6
    floor: float = 0.0


LAW = Law()


def make_drop(path: Path, rng: np.random.Generator, law: Law = LAW, *, lost: int = 0) -> Drop:
    """A drop with one impact, written as a TUM file with noise, from which frames at the impact are taken out.

    Args:
        path: Of the file.
        rng: Of the throw and the noise.
        law: What makes it.
        lost: How many frames the recording loses at the impact.
    """
    poses: list[Array] = []
    last = 0
    while len(poses) < last + LEAST:
        poses, last = _thrown(rng, law)
    quarters = round(poses[-1][2] / (np.pi / 2))
    rest = [poses[-1][0], law.floor + law.half[1 - quarters % 2], quarters * np.pi / 2]
    kept = np.delete(np.array(poses + [rest] * 30), range(last, last + lost), axis=0)
    x, z, a = (kept + NOISE * rng.normal(size=kept.shape)).T
    q = np.column_stack([0 * a, np.sin(a / 2), 0 * a, np.cos(a / 2)])
    np.savetxt(path, np.column_stack([DT * np.arange(len(a)), x, 0 * x, z, q]), fmt="%.9f")
    return read_drop(path)


def _thrown(rng: np.random.Generator, law: Law) -> tuple[list[Array], int]:
    """Poses of the middle until a second corner comes near the floor, and the first frame after the impact."""
    angle = np.deg2rad(rng.uniform(25, 40)) * rng.choice([-1.0, 1.0]) + rng.integers(4) * np.pi / 2
    start = np.array([0.0, 0.14, angle, rng.uniform(0.6, 0.9), -rng.uniform(1.5, 2.0), rng.uniform(-3, 3)])
    hit = brentq(lambda t: _tip(_flown(start, t, law), law)[1][1], 0.02, 0.09, xtol=1e-12)
    after, poses = _hit(_flown(start, hit, law), law), []
    for t in DT * np.arange(110):
        state = _flown(start, t, law) if t < hit else _flown(after, t - hit, law)
        if t > hit + 4 * DT and _tip(state, law)[1][1] < 1e-3:
            break
        poses.append(np.array([*(state[:2] - turned(state[2], np.array(law.centre))), state[2]]))
    return poses, int(np.ceil(hit / DT))


def _flown(state: Array, t: float, law: Law) -> Array:
    """The centre of mass's state (place, angle, velocities) after a time of flight with linear drag."""
    k, down = law.drag, np.array([0.0, law.gravity, 0.0])
    gone = (1 - np.exp(-k * t)) / k
    place = state[:3] + (state[3:] + down / k) * gone - down * t / k
    return np.concatenate([place, (state[3:] + down / k) * np.exp(-k * t) - down / k])


def _tip(state: Array, law: Law) -> tuple[Array, Array]:
    """(2,) from the centre of mass to the lowest point, and (2,) that point."""
    inner = turned(state[2], SIGNS * (np.array(law.half) - law.radius) - np.array(law.centre))
    arm = inner[np.argmin(inner[:, 1])] - np.array([0.0, law.radius])
    return arm, state[:2] + arm - np.array([0.0, law.floor])


def _hit(state: Array, law: Law) -> Array:
    """The state after an impact with a rebound and friction at its limit."""
    arm, _ = _tip(state, law)
    across = np.array([arm[1], -arm[0]])
    slip, closing = state[3:5] + state[5] * across
    pull = np.array([-law.friction * np.sign(slip), 1.0])
    # a unit of impulse off the floor, for a unit of mass, changes the spin and the tip's speed off the floor by this
    turn = float(across @ pull) / law.gyration
    lift = -(1 + law.rebound) * closing / (1 + turn * across[1])
    return np.concatenate([state[:3], state[3:5] + lift * pull, [state[5] + lift * turn]])
