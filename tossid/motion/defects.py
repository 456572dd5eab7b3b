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

from tossid.objects import GRAVITY, JointType, ObjectModel, body_poses, corner_heights
from tossid.rotations import quat_boxminus, quat_rotate
from tossid.settings.motion import DefectSettings
from tossid.types import Toss

Array = NDArray[np.float64]

RULES = ("flight", "speed", "flip", "jolt")
DEFAULT = DefectSettings()


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


def find_defects(
    tosses: Sequence[Toss], model: ObjectModel, *, gravity: float = GRAVITY, settings: DefectSettings = DEFAULT
) -> tuple[Defect, ...]:
    """All rules that tosses break, in the order of tosses and `RULES`.

    Args:
        tosses: As recorded.
        model: The object.
        gravity: Where they were recorded [m/s²].
        settings: The limits.
    """
    found = []
    for toss in tosses:
        dt = np.diff(toss.t)
        if model.is_stated:
            air = corner_heights(model, toss.q).min(axis=1) > settings.air_height * model.width
        else:  # flight was found in the motion itself, and cannot contradict it
            air = np.zeros(len(toss), dtype=bool)
        turning = [3, 4, 5, *(6 + j for j in range(model.n_joints) if model.joint_type[1 + j] == JointType.HINGE)]
        rates = toss.v[:, turning]
        turn = np.concatenate(
            [
                quat_boxminus(toss.q[1:, 3:7], toss.q[:-1, 3:7]),
                np.diff(toss.q[:, 1 + np.array(turning[3:], int)], axis=0),
            ],
            axis=1,
        )
        difference = turn / dt[:, None] - 0.5 * (rates[1:] + rates[:-1])
        change = np.where((air[1:] & air[:-1])[:, None], np.diff(rates, axis=0), 0.0)
        worst = {
            "flight": (_flight_error(toss, model, air, gravity, settings), settings.flight_acceleration),
            "speed": (_largest(rates), settings.largest_rate),
            "flip": (_largest(difference), settings.flip_rate),
            "jolt": (_largest(change), settings.jolt_rate),
        }
        found += [Defect(toss.name, rule, value, limit) for rule, (value, limit) in worst.items() if value > limit]
    return tuple(found)


def _largest(rates: Array) -> float:
    """Of the base's spin and of each hinge's rate, the largest size (n, 3 + n_h) [rad/s]."""
    spin = np.linalg.norm(rates[:, :3], axis=1).max()
    return float(max(spin, np.abs(rates[:, 3:]).max(initial=0.0)))


def _flight_error(
    toss: Toss, model: ObjectModel, air: NDArray[np.bool_], gravity: float, settings: DefectSettings
) -> float:
    """How far the common centre of mass's acceleration before the first contact is from gravity [m/s²].

    0 where the flight is too short, or the difference is within the fit's own error.
    """
    n = len(air) if air.all() else int(np.argmin(air))
    if n < settings.flight_frames:
        return 0.0
    place, quat = body_poses(model, toss.q[:n])
    com = (place + quat_rotate(quat, np.broadcast_to(model.com, place.shape))).swapaxes(0, 1)
    c = np.tensordot(model.mass / model.mass.sum(), com, 1)
    t = toss.t[:n] - toss.t[:n].mean()
    basis = np.stack([np.ones(n), t, 0.5 * t**2], axis=1)
    fitted, *_ = np.linalg.lstsq(basis, c, rcond=None)
    noise = (c - basis @ fitted).std(axis=0, ddof=3)
    error = float(np.linalg.norm(noise) * np.sqrt(np.linalg.inv(basis.T @ basis)[2, 2]))
    difference = float(np.linalg.norm(fitted[2] + [0.0, 0.0, gravity]))
    return difference if difference > settings.standard_errors * error else 0.0
