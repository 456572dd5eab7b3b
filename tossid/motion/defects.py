"""Defects of recorded tosses, by rules that need no simulator but gravity.

    flight   the common centre of mass does not accelerate by gravity while no corner is near the ground
    speed    a link turns faster, or a joint moves faster, than tosses do
    flip     a pose jumps: its turn in a frame differs from the rates on both sides
    jolt     rates change within a frame although the ground is not near

Contact explains none of these. Published recordings have them where a tag was lost or confused with another, or where
a link's pose is turned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.motion.contact import lowest_corner
from tossid.motion.flight import first_parabola
from tossid.motion.kinematics import center_of_mass
from tossid.objects import GRAVITY, JointType, ObjectModel
from tossid.rotations import quat_boxminus
from tossid.types import Toss

Array = NDArray[np.float64]

LIMITS = {"flight": 3.0, "speed": 70.0, "flip": 20.0, "jolt": 15.0}
"""What a value must exceed to break a rule: a flight's acceleration that of gravity [m/s²], a spin or a hinge's rate, a
frame's turn over its time the mean of the recorded rates, and a rate that of the frame before [rad/s]."""
RULES = tuple(LIMITS)
AIR_HEIGHT_REL = 0.3
"""Height of the lowest corner above which nothing touches, in widths; stated geometry may be off."""
FEWEST_FRAMES = 8
"""Frames from the first on that a flight must have to be judged."""
STANDARD_ERRORS = 4.0
"""The difference from gravity must also exceed so many standard errors of the fitted acceleration."""


@dataclass(frozen=True)
class Defect:
    """A toss that breaks a rule.

    Attributes:
        toss: Its name.
        rule: One of `RULES`.
        value: The worst value [m/s² or rad/s].
        limit: What it exceeds, in the same unit.
    """

    toss: str
    rule: str
    value: float
    limit: float


def find_defects(tosses: Sequence[Toss], model: ObjectModel, *, gravity: float = GRAVITY) -> tuple[Defect, ...]:
    """All rules that tosses break, in the order of tosses and `RULES`.

    Args:
        tosses: As recorded.
        model: The object.
        gravity: Where they were recorded [m/s²].
    """
    found = []
    for toss in tosses:
        if model.is_stated:
            air = lowest_corner(model, toss.q) > AIR_HEIGHT_REL * model.width
        else:  # flight was found in the motion itself, and cannot contradict it
            air = np.zeros(len(toss), dtype=bool)
        hinges = np.flatnonzero(np.array(model.joint_type[1:]) == JointType.HINGE)
        rates = toss.v[:, [3, 4, 5, *(6 + hinges)]]
        turn = np.column_stack(
            [quat_boxminus(toss.q[1:, 3:7], toss.q[:-1, 3:7]), np.diff(toss.q[:, 7 + hinges], axis=0)]
        )
        change = np.where((air[1:] & air[:-1])[:, None], np.diff(rates, axis=0), 0.0)
        worst = {
            "flight": _flight_error(toss, model, air, gravity),
            "speed": _largest(rates),
            "flip": _largest(turn / np.diff(toss.t)[:, None] - 0.5 * (rates[1:] + rates[:-1])),
            "jolt": _largest(change),
        }
        found += [Defect(toss.name, rule, worst[rule], limit) for rule, limit in LIMITS.items() if worst[rule] > limit]
    return tuple(found)


def _largest(rates: Array) -> float:
    """Of the base's spin and of each hinge's rate, the largest size (n, 3 + n_h) [rad/s]."""
    spin = np.linalg.norm(rates[:, :3], axis=1).max()
    return float(max(spin, np.abs(rates[:, 3:]).max(initial=0.0)))


def _flight_error(toss: Toss, model: ObjectModel, air: NDArray[np.bool_], gravity: float) -> float:
    """How far the common centre of mass's acceleration before the first contact is from gravity [m/s²].

    0 where the flight is too short, or the difference is within the fit's own error.
    """
    fit = first_parabola(toss.t, center_of_mass(model, toss.q), air, FEWEST_FRAMES)
    if fit is None:
        return 0.0
    error = float(fit.noise * np.sqrt(3 * fit.unit_cov[2, 2]))
    difference = float(np.linalg.norm(fit.coefficients[2] + [0.0, 0.0, gravity]))
    return difference if difference > STANDARD_ERRORS * error else 0.0
