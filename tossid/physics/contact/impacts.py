"""Where a step ends that has an impact in it (docs/adr/0010)."""

from __future__ import annotations

import math

from tossid.kernels import inlined_kernel
from tossid.physics.contact.law import IMPACT_SPEED
from tossid.physics.contact.problem import FAR, velocity
from tossid.physics.moving import common_velocity, n_rates, turning

STEADY = 5e-3
"""[m/s] below which a touching corner goes neither up nor down: it slides or turns, and does not land."""
MOST_STRIKES = 64
"""In a frame; what comes after is as in whole steps. A bound on the work of a body that rattles, and no setting."""


@inlined_kernel
def falling(model, work, s, corners, c):  # type: ignore[no-untyped-def]
    """Vertical acceleration of corner c without contact [m/s²], J_n dv/dt + dJ_n/dt v. After the accelerations."""
    R = s.R
    c0, c1, c2 = common_velocity(model, work, s.rate, 0)
    fall = model.gravity[2] + R[2, 0] * (c0 - s.a[0]) + R[2, 1] * (c1 - s.a[1]) + R[2, 2] * (c2 - s.a[2])
    for x in range(n_rates(model)):
        fall += corners.tau[c, 0, x] * s.rate[x]
    return fall + turning(model, work, s, corners, c, 0)


@inlined_kernel
def first_impact(model, law, work, s, corners, strikes, impact_parts, h):  # type: ignore[no-untyped-def]
    """What becomes of a step of length h that is to begin: (parts, strike, length of each part [s], lands).

    Rigid contact: the step ends where the first corner touches, z + v t + a t²/2 = 0; if one that comes down at more
    than `IMPACT_SPEED` touches already, a strike is due, of no length. Contact that gives way: `impact_parts` parts,
    if a corner crosses the ground. A corner lands if it comes to the ground in the step, too slowly for a strike.
    After `find_corners`.
    """
    length, parts, strike, lands = h, 1, False, False
    lowest, touching, fast = 0.0, law.touching_height, IMPACT_SPEED
    for c in range(corners.state.shape[0]):
        if corners.state[c] == FAR:
            continue
        vn = velocity(corners.tau, c, 0, s.u_start, s.xi_start, n_rates(model))
        z = corners.height[c] - min(corners.sunk[c], 0.0)
        if not law.rigid:
            if abs(vn) > fast and z + h * min(vn, 0.0) < 0.0:
                parts = impact_parts
            continue
        if z < touching:
            strike = strike or (vn < -fast and strikes < MOST_STRIKES)
            lands = lands or vn < -STEADY
            continue
        fall = falling(model, work, s, corners, c)
        # the relaxed problem acts on what has come to the ground: it sees the last velocity, and the step is as short
        speed = vn * vn - (2.0 if law.beyond.lifting == 0.0 else 4.0) * fall * z
        if speed > fast * fast and math.sqrt(speed) - vn > 0.0:
            length = min(length, 2.0 * z / (math.sqrt(speed) - vn))
        else:
            lowest = min(lowest, z + h * vn + 0.5 * h * h * fall)
    return parts, strike, length / parts, lands or lowest < -0.1 * STEADY * h


@inlined_kernel
def carry_over(corners, length, rigid):  # type: ignore[no-untyped-def]
    """Scale the last step's impulses to a step of another length.

    The same forces over a longer or shorter time. Of parts in which a corner was loaded only at times, a longer step
    takes what all of them carried.
    """
    ratio, warm = length / corners.span[0], corners.warm
    if length == corners.span[0]:
        return
    corners.span[0] = length
    for c in range(warm.shape[0]):
        scale = ratio
        if ratio > 1.0 and warm[c, 0] > 0.0 and not rigid:
            scale = min(ratio, corners.carried[c] / warm[c, 0])
        for k in range(3):
            warm[c, k] *= scale
