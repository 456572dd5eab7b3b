"""Where a step of a tree ends that has an impact in it (ADR 10); the single body's kernel has its own."""

from __future__ import annotations

import math

from tossid.kernels import fused_kernel
from tossid.physics.articulated import (
    ACCEL,
    ALPHA,
    SPIN,
    X,
    common_velocity,
    swing,
)
from tossid.physics.contact import IMPACT_SPEED, MOST_STRIKES, TOUCHING


@fused_kernel
def first_impact(  # type: ignore[no-untyped-def]
    P, E, R, corner_body, place, tau, state, height, sunk, gravity, a0, a1, a2, rate, u_before, before,
    rigid, strikes, impact_parts, h, dt,
):  # fmt: skip
    """What becomes of a step of length h that is to begin: (parts, strike, length of each part [s]).

    Rigid contact: the step ends where the first corner touches; if one that comes down at more than
    `IMPACT_SPEED` touches already, a strike is due, of no length. Contact that gives way: `impact_parts` parts, if a
    corner crosses the ground.

    height (n_c,), place (n_c, 3), tau, state: of `find_corners`. a (base axes): minus the origin's acceleration
    without gravity; rate (n_x,): that of spin and joint rates. u_before (3: z, x, y), before (n_x,): velocities.
    """
    nx, length, parts, strike = rate.shape[0], h, 1, False
    c0, c1, c2 = common_velocity(P, rate, 0)
    common = gravity[2] + R[2, 0] * (c0 - a0) + R[2, 1] * (c1 - a1) + R[2, 2] * (c2 - a2)
    for c in range(state.shape[0]):
        if state[c] == 0:
            continue
        vn = u_before[0]
        for x in range(nx):
            vn += tau[c, 0, x] * before[x]
        z = height[c] - min(sunk[c], 0.0)
        if not rigid:
            if abs(vn) > IMPACT_SPEED and z + h * min(vn, 0.0) < 0.0:
                parts = impact_parts
            continue
        if z < TOUCHING:
            strike = strike or (vn < -IMPACT_SPEED and strikes < MOST_STRIKES)
            continue
        # the corner's vertical acceleration: J dv/dt + dJ/dt v
        b, fall = corner_body[c], common
        for x in range(nx):
            fall += tau[c, 0, x] * rate[x]
        s0, s1, s2 = swing(
            P[b, ALPHA], P[b, ALPHA + 1], P[b, ALPHA + 2], P[b, SPIN], P[b, SPIN + 1], P[b, SPIN + 2],
            place[c, 0] - P[b, X], place[c, 1] - P[b, X + 1], place[c, 2] - P[b, X + 2],
        )  # fmt: skip
        fall += R[2, 0] * (P[b, ACCEL] + s0) + R[2, 1] * (P[b, ACCEL + 1] + s1) + R[2, 2] * (P[b, ACCEL + 2] + s2)
        speed = vn * vn - 4.0 * fall * z  # with the last velocity, as in its problem
        if speed > IMPACT_SPEED * IMPACT_SPEED and math.sqrt(speed) - vn > 0.0:
            length = min(length, 2.0 * z / (math.sqrt(speed) - vn))
    return parts, strike, length / parts


@fused_kernel
def carry_over(warm, carried, length, loaded, rigid):  # type: ignore[no-untyped-def]
    """Scale the last step's impulses `warm` (n_c, 3) to a step of another length; returns the length they are of.

    The same forces over a longer or shorter time. Of parts in which a corner was loaded only at times, a longer step
    takes what all of them carried (n_c,).
    """
    if length == loaded:
        return loaded
    ratio = length / loaded
    for c in range(warm.shape[0]):
        scale = ratio
        if ratio > 1.0 and warm[c, 0] > 0.0 and not rigid:
            scale = min(ratio, carried[c] / warm[c, 0])
        for k in range(3):
            warm[c, k] *= scale
    return length
