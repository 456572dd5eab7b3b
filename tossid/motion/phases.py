"""What an object does at each frame: flight, impact, slide, roll or rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.motion.contact import may_touch
from tossid.motion.kinematics import corner_velocities, jump_speed
from tossid.objects import GRAVITY, ObjectModel, corner_positions
from tossid.types import Phase, check_motion

Array = NDArray[np.float64]

TOUCH_REL = 0.03
"""Of the object's width: a corner lower than this touches the ground. Tracked corners of resting
objects lie some millimetres off the ground; lower hops are not told from contact."""
IMPACT_WEIGHTS = 3.0
"""An impact is a mean contact force beyond so many times the object's weight over an interval."""
IMPACT_SIGMAS = 5.0
"""And a change of velocity beyond so many of its standard errors."""
PASSING_SPEED = 0.1
"""[m/s] of a corner up or down: faster, it is on its way to the ground or from it and not in lasting contact."""
SLIDE_SPEED = 0.05
"""[m/s] of the slowest touching corner, above which the object slides."""
REST_SPIN_REL = 0.05
"""[m/s] of the spin (and of joint rates) times half the width, above which an object that does not slide rolls."""


def label_phases(
    model: ObjectModel,
    t: Array,
    q: Array,
    v: Array,
    *,
    gravity: float = GRAVITY,
    v_sigma: float = 0.0,
) -> NDArray[np.uint8]:
    """Phase of every frame; an impact is labelled on the frame that follows it.

    flight: every corner is clear of the ground, or on its way to it or from it.
    impact: the velocity jumped since the frame before, by more than
    `IMPACT_WEIGHTS` weights explain, where the object may touch the ground; or
    a corner sinks into it. slide: every touching corner moves along
    the ground. roll: one does not, but the object turns (rolls, tips, pivots).
    rest: neither.

    Args:
        t: (n,). q: (n, nq). v: (n, nv).
        gravity: [m/s²].
        v_sigma: standard error of a velocity as `jump_speed` measures it [m/s].

    Returns:
        (n,) of `Phase`.
    """
    check_motion(t, q, v)
    h = np.diff(t)
    height = corner_positions(model, q)[..., 2]
    velocity = corner_velocities(model, q, v)
    touching = (height < TOUCH_REL * model.width) & (np.abs(velocity[..., 2]) < PASSING_SPEED)
    sinking = (height < 0) & (velocity[..., 2] <= -PASSING_SPEED)
    speed = np.linalg.norm(velocity[..., :2], axis=-1)
    slowest = np.where(touching, speed, np.inf).min(axis=1)
    spin = np.abs(v[:, 3:]).max(axis=1) if model.n_joints else np.linalg.norm(v[:, 3:6], axis=1)

    phase = np.full(len(t), int(Phase.REST), dtype=np.uint8)
    phase[0.5 * model.width * spin > REST_SPIN_REL] = Phase.ROLL
    phase[slowest > SLIDE_SPEED] = Phase.SLIDE
    phase[~touching.any(axis=1)] = Phase.FLIGHT
    phase[sinking.any(axis=1)] = Phase.IMPACT

    jump = jump_speed(model, q[1:], v[:-1], v[1:], gravity * h)
    least = np.maximum(IMPACT_WEIGHTS * gravity * h, IMPACT_SIGMAS * np.sqrt(2.0) * v_sigma)
    phase[1:][(jump > least) & may_touch(model, t, q)] = Phase.IMPACT
    return phase
