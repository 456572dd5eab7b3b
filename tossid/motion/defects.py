"""What is wrong with recorded tosses, by rules that need no simulator but gravity.

    flight   the common centre of mass does not fall as gravity has it while no corner is near the ground
    speed    a link turns faster, or a joint moves faster, than tosses do
    flip     a pose jumps: it turns in a frame by what the rates on both sides do not show
    jolt     rates change within a frame although nothing is near enough to hit

Contact explains none of these. Published recordings have them where a tag was lost or taken for another, or where a
link's pose came out turned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.objects import GRAVITY, JointType, ObjectModel, body_poses, corner_positions
from tossid.rotations import quat_boxminus, quat_rotate
from tossid.types import Toss

Array = NDArray[np.float64]

RULES = ("flight", "speed", "flip", "jolt")
AIR_REL = 0.3
"""Height of the lowest corner over the ground, in widths, above which nothing touches; stated geometry may be off."""
FLIGHT_FRAMES = 8
"""Frames in the air from the first on that a flight must have to be judged."""
FLIGHT_MS2 = 3.0
"""[m/s²] by which a flight's acceleration may miss gravity."""
STANDARD_ERRORS = 4.0
"""And so many standard errors of the fitted acceleration."""
SPEED_RADPS = 70.0
"""Fastest spin of the base and rate of a hinge [rad/s]."""
FLIP_RADPS = 20.0
"""[rad/s] by which a frame's turn over its time may differ from the mean of the recorded rates."""
JOLT_RADPS = 15.0
"""Change of a rate from one frame to the next in the air [rad/s]."""


@dataclass(frozen=True)
class Defect:
    """A toss that breaks a rule: its name, the rule, the worst value and the limit [m/s² or rad/s]."""

    toss: str
    rule: str
    value: float
    limit: float


def find_defects(tosses: Sequence[Toss], model: ObjectModel, *, gravity: float = GRAVITY) -> tuple[Defect, ...]:
    """All rules that tosses break, in the order of tosses and `RULES`.

    Args:
        tosses: as recorded. gravity: where they were [m/s²].
    """
    found = []
    for toss in tosses:
        dt = np.diff(toss.t)
        air = corner_positions(model, toss.q)[..., 2].min(axis=1) > AIR_REL * model.width
        turning = [3, 4, 5, *(6 + j for j in range(model.n_joints) if model.joint_type[1 + j] == JointType.HINGE)]
        rates = toss.v[:, turning]
        turn = np.concatenate(
            [
                quat_boxminus(toss.q[1:, 3:7], toss.q[:-1, 3:7]),
                np.diff(toss.q[:, 1 + np.array(turning[3:], int)], axis=0),
            ],
            axis=1,
        )
        miss = turn / dt[:, None] - 0.5 * (rates[1:] + rates[:-1])
        change = np.where((air[1:] & air[:-1])[:, None], np.diff(rates, axis=0), 0.0)
        worst = {
            "flight": (_flight_miss(toss, model, air, gravity), FLIGHT_MS2),
            "speed": (_largest(rates), SPEED_RADPS),
            "flip": (_largest(miss), FLIP_RADPS),
            "jolt": (_largest(change), JOLT_RADPS),
        }
        found += [Defect(toss.name, rule, value, limit) for rule, (value, limit) in worst.items() if value > limit]
    return tuple(found)


def _largest(rates: Array) -> float:
    """Of the base's spin and of each hinge's rate, the largest size (n, 3 + n_h) [rad/s]."""
    spin = np.linalg.norm(rates[:, :3], axis=1).max()
    return float(max(spin, np.abs(rates[:, 3:]).max(initial=0.0)))


def _flight_miss(toss: Toss, model: ObjectModel, air: NDArray[np.bool_], gravity: float) -> float:
    """By how much the common centre of mass's acceleration before the first contact misses gravity [m/s²].

    0 where the flight is too short, or the miss is within what a fit of it leaves open.
    """
    n = len(air) if air.all() else int(np.argmin(air))
    if n < FLIGHT_FRAMES:
        return 0.0
    place, quat = body_poses(model, toss.q[:n])
    com = (place + quat_rotate(quat, np.broadcast_to(model.com, place.shape))).swapaxes(0, 1)
    c = np.tensordot(model.mass / model.mass.sum(), com, 1)
    t = toss.t[:n] - toss.t[:n].mean()
    basis = np.stack([np.ones(n), t, 0.5 * t**2], axis=1)
    fitted, *_ = np.linalg.lstsq(basis, c, rcond=None)
    noise = (c - basis @ fitted).std(axis=0, ddof=3)
    error = float(np.linalg.norm(noise) * np.sqrt(np.linalg.inv(basis.T @ basis)[2, 2]))
    miss = float(np.linalg.norm(fitted[2] + [0.0, 0.0, gravity]))
    return miss if miss > STANDARD_ERRORS * error else 0.0
