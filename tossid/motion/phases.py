"""What an object does at each frame: flight, impact, slide, roll or rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.motion.contact import may_touch
from tossid.motion.free_fall import Parabola
from tossid.motion.kinematics import body_motions, com_velocities, corner_velocities, jump_speed
from tossid.objects import GRAVITY, ObjectModel, corner_heights
from tossid.types import Phase, check_motion

Array = NDArray[np.float64]
Phases = NDArray[np.uint8]

TOUCH_HEIGHT_REL = 0.03
"""Height below which a corner touches the ground, in widths of the object; tracked corners of resting objects are some
millimetres off the ground, and lower hops count as contact."""
IMPACT_WEIGHTS = 3.0
"""An impact's mean contact force over an interval exceeds so many weights,"""
IMPACT_SIGMAS = 5.0
"""and its change of velocity exceeds so many standard errors."""
PASSING_SPEED = 0.1
"""Vertical speed above which a corner is on its way to or from the ground, not in lasting contact [m/s]."""
SLOW = 0.05
"""Speed of the slowest touching corner above which the object slides, and spin times half the width above which it
rolls if it does not slide; of a body without a shape, speed and spin times gyration below which it rests [m/s]."""


def label_phases(
    model: ObjectModel, t: Array, q: Array, v: Array, *, gravity: float = GRAVITY, v_sigma: float = 0.0
) -> Phases:
    """Phase of every frame, (n,) of `Phase`; an impact is labelled on the frame that follows it.

    Flight: every corner is clear of the ground, or on its way to it or from it. Impact: the velocity jumped since the
    frame before by more than some weights explain, where the object may touch the ground; or a corner sinks into it.
    Slide: every touching corner moves along the ground. Roll: one does not, but the object turns (rolls, tips, pivots).
    Rest: neither.

    Args:
        model: The object.
        t: Times [s], (n,).
        q: Configurations, (n, nq).
        v: Velocities, (n, nv).
        gravity: [m/s²].
        v_sigma: Standard error of a velocity as `jump_speed` measures it [m/s].
    """
    check_motion(t, q, v)
    h = np.diff(t)
    height, velocity = corner_heights(model, q), corner_velocities(model, q, v)
    touching = (height < TOUCH_HEIGHT_REL * model.width) & (np.abs(velocity[..., 2]) < PASSING_SPEED)
    sinking = (height < 0) & (velocity[..., 2] <= -PASSING_SPEED)
    speed = np.linalg.norm(velocity[..., :2], axis=-1)
    slowest = np.where(touching, speed, np.inf).min(axis=1)
    spin = np.abs(v[:, 3:]).max(axis=1) if model.n_joints else np.linalg.norm(v[:, 3:6], axis=1)

    phase = np.full(len(t), int(Phase.REST), dtype=np.uint8)
    phase[0.5 * model.width * spin > SLOW] = Phase.ROLL
    phase[slowest > SLOW] = Phase.SLIDE
    phase[~touching.any(axis=1)] = Phase.FLIGHT
    phase[sinking.any(axis=1)] = Phase.IMPACT
    jump = jump_speed(model, q[1:], v[:-1], v[1:], gravity * h)
    phase[1:][(jump > _least_jump(gravity * h, v_sigma)) & may_touch(model, t, q)] = Phase.IMPACT
    return phase


def phases_of_motion(parabola: Parabola, t: Array, q: Array, v: Array, *, v_sigma: float = 0.0) -> Phases:
    """Phase of every frame by motion alone, (n,) of `Phase`: flight, impact and rest; unknown where it is in contact.

    Without a shape, sliding cannot be distinguished from rolling.

    Args:
        parabola: Of the recording.
        t: Times [s], (n,).
        q: Configurations, (n, nq).
        v: Velocities, (n, nv).
        v_sigma: Standard error of a velocity [m/s].
    """
    body, fall = parabola.body(), parabola.gravity * np.diff(t)
    u = com_velocities(body, q, v).mean(axis=-2)
    turning = body_motions(body, q, v)[2]
    spin = parabola.gyration * np.sqrt((turning**2).sum(-1).mean(-1))
    change = np.diff(u, axis=0)
    change[:, 2] += fall
    turned = v[:, None, 3:6] if not body.n_joints else turning
    jump = np.sqrt((change**2).sum(1) + parabola.gyration**2 * (np.diff(turned, axis=0) ** 2).sum(-1).mean(-1))

    flying = parabola.flying(t, q)
    phase = np.full(len(t), int(Phase.UNKNOWN), dtype=np.uint8)
    phase[1:][(jump > _least_jump(fall, v_sigma)) & parabola.may_touch(t, q)] = Phase.IMPACT
    phase[(np.linalg.norm(u, axis=1) < SLOW) & (spin < SLOW)] = Phase.REST
    phase[flying] = Phase.FLIGHT
    return phase


def _least_jump(fall: Array, v_sigma: float) -> Array:
    """Change of velocity from which an interval holds an impact [m/s]; fall: that of gravity in the interval [m/s]."""
    return np.maximum(IMPACT_WEIGHTS * fall, IMPACT_SIGMAS * np.sqrt(2.0) * v_sigma)
