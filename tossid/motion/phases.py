"""What an object does at each frame: flight, impact, slide, roll or rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.motion.contact import may_touch
from tossid.motion.kinematics import corner_velocities, jump_speed
from tossid.objects import GRAVITY, ObjectModel, corner_heights
from tossid.settings.motion import PhaseSettings
from tossid.types import Phase, check_motion

Array = NDArray[np.float64]

DEFAULT = PhaseSettings()


def label_phases(
    model: ObjectModel,
    t: Array,
    q: Array,
    v: Array,
    *,
    gravity: float = GRAVITY,
    v_sigma: float = 0.0,
    settings: PhaseSettings = DEFAULT,
) -> NDArray[np.uint8]:
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
        settings: The limits.
    """
    check_motion(t, q, v)
    h = np.diff(t)
    height = corner_heights(model, q)
    velocity = corner_velocities(model, q, v)
    touching = (height < settings.touch_height * model.width) & (np.abs(velocity[..., 2]) < settings.passing_speed)
    sinking = (height < 0) & (velocity[..., 2] <= -settings.passing_speed)
    speed = np.linalg.norm(velocity[..., :2], axis=-1)
    slowest = np.where(touching, speed, np.inf).min(axis=1)
    spin = np.abs(v[:, 3:]).max(axis=1) if model.n_joints else np.linalg.norm(v[:, 3:6], axis=1)

    phase = np.full(len(t), int(Phase.REST), dtype=np.uint8)
    phase[0.5 * model.width * spin > settings.roll_speed] = Phase.ROLL
    phase[slowest > settings.slide_speed] = Phase.SLIDE
    phase[~touching.any(axis=1)] = Phase.FLIGHT
    phase[sinking.any(axis=1)] = Phase.IMPACT

    jump = jump_speed(model, q[1:], v[:-1], v[1:], gravity * h)
    least = np.maximum(settings.impact_weights * gravity * h, settings.impact_sigmas * np.sqrt(2.0) * v_sigma)
    phase[1:][(jump > least) & may_touch(model, t, q)] = Phase.IMPACT
    return phase
