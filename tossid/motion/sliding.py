"""Friction from how objects that slide slow down, whatever their shape and inertia.

Where all points that touch slide in one direction s, Coulomb's law gives the whole force on the ground that direction:
with the acceleration a of the centre of mass,

    a_xy = -μ (a_z + g) s.

No law of impacts takes part, and no first state. Over many frames that turn, rest or strike, nothing is found.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.motion.flight import fit_polynomial
from tossid.motion.kinematics import center_of_mass, corner_velocities
from tossid.objects import GRAVITY, ObjectModel, corner_heights
from tossid.types import Toss

Array = NDArray[np.float64]

FRAMES, STRIDE = 9, 3
"""Frames of a parabola, and from one to the next."""
NEAR = 2e-3
"""Height below which a point touches the ground [m]."""
SLOWEST, STRAIGHT = 0.12, 0.98
"""Least speed of points that slide [m/s], and least mean of their directions, which are unit vectors."""
IMPACT = 0.25
"""Change of the velocity between two frames that is an impact [m/s]."""
LEAST_LOAD = 0.3
"""Load on the ground over the weight below which a parabola is nearly flight."""


class Sliding(NamedTuple):
    """What sliding shows of friction.

    Attributes:
        friction: Coulomb's coefficient; NaN where nothing slides.
        deviation: Its standard error, with the toss as the unit; infinite where fewer than two slide.
        tosses: How many slide.
    """

    friction: float
    deviation: float
    tosses: int


def sliding_friction(tosses: Sequence[Toss], model: ObjectModel, *, gravity: float = GRAVITY) -> Sliding:
    """Friction from the accelerations of what slides straight on.

    Args:
        tosses: Over the ground z = 0.
        model: The object: its corners, centre of mass and joints.
        gravity: Where they were recorded [m/s²].
    """
    found = [forces for toss in tosses if len(forces := _forces(toss, model, gravity))]
    if not found:
        return Sliding(np.nan, np.inf, 0)
    # least squares of a_xy = -μ (a_z + g) s: sums by toss of the products with the load, and their scatter
    along, square = (
        np.array(sums) for sums in zip(*((f[:, 0] @ f[:, 1], f[:, 1] @ f[:, 1]) for f in found), strict=True)
    )
    mu = along.sum() / square.sum()
    scatter = ((along - mu * square) ** 2).sum() * len(found) / max(len(found) - 1, 1)
    deviation = np.sqrt(scatter) / square.sum() if len(found) > 1 else np.inf
    return Sliding(float(mu), float(deviation), len(found))


def _forces(toss: Toss, model: ObjectModel, gravity: float) -> Array:
    """(k, 2) force against the direction of sliding and load, over the mass [m/s²], in parabolas of a toss."""
    place = np.arange(0, len(toss.t) - FRAMES + 1, STRIDE)[:, None] + np.arange(FRAMES)
    if not len(place):
        return np.zeros((0, 2))
    touches = corner_heights(model, toss.q) < NEAR
    velocity = corner_velocities(model, toss.q, toss.v)[..., :2]
    speed = np.linalg.norm(velocity, axis=-1)
    unit = velocity / np.maximum(speed, 1e-9)[..., None]
    own = touches[place]
    same = own[:, 0].any(-1) & (own == own[:, :1]).all((1, 2))
    fast = np.where(own, speed[place], np.inf).min((1, 2)) > SLOWEST
    mean = np.where(own[..., None], unit[place], 0.0).sum((1, 2)) / np.maximum(own.sum((1, 2)), 1)[:, None]
    jumps = np.append(np.linalg.norm(np.diff(toss.v[:, :3], axis=0), axis=1), 0.0)
    calm = jumps[place[:, :-1]].max(1) < IMPACT
    t = toss.t[place] - toss.t[place].mean(axis=1, keepdims=True)
    acceleration = fit_polynomial(t, center_of_mass(model, toss.q)[place]).coefficients[:, 2]
    length, load = np.linalg.norm(mean, axis=1), acceleration[:, 2] + gravity
    slides = same & fast & calm & (length > STRAIGHT) & (load > LEAST_LOAD * gravity)
    against = -(acceleration[:, :2] * mean).sum(1) / np.maximum(length, 1e-9)
    return np.stack([against, load], axis=1)[slides]
