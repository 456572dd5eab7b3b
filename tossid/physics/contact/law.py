"""The law of contact at one corner, as numbers that the time-stepping kernel reads."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import fused_inlined_kernel
from tossid.physics.forces import Law, law_of
from tossid.physics.system import System
from tossid.settings.contact import ContactSettings

Array = NDArray[np.float64]

UNKNOWN = 1.0
"""Stands for the depth of the ground below a corner whose toss has not begun; true depths are not positive."""


class Thresholds(NamedTuple):
    """The numbers of `ContactSettings`, as kernels read them: speeds [m/s] and heights [m]."""

    bounce_speed: float
    recovery_speed: float
    impact_speed: float
    touching_height: float
    adhesion_reach: float


class ContactLaw(NamedTuple):
    """How corners touch the ground; `stepping` has the equations.

    Attributes:
        mu: (n_c,) friction coefficient of each corner.
        restitution: Newton's coefficient.
        compliance: 1 / stiffness of a corner [m/N], 0 for rigid contact.
        relaxation: damping over stiffness of a corner [s].
        cohesion: c of |f_t| <= mu f_n + c [N].
        varied: whether `beyond` differs from a constant friction.
        beyond: contact beyond a constant friction.
        thresholds: speeds and heights that decide between cases.
    """

    mu: Array
    restitution: float
    compliance: float
    relaxation: float
    cohesion: float
    varied: bool
    beyond: Law
    thresholds: Thresholds


def make_contact_law(system: System, settings: ContactSettings = ContactSettings()) -> ContactLaw:
    """The law of contact of a system.

    Args:
        system: the simulator's parameters.
        settings: speeds and heights that decide between cases.
    """
    beyond = law_of(system.law)
    return ContactLaw(
        mu=np.ascontiguousarray(system.mu),
        restitution=float(system.restitution),
        compliance=float(system.compliance),
        relaxation=float(system.relaxation),
        cohesion=float(system.cohesion),
        varied=beyond.acts,
        beyond=beyond,
        thresholds=Thresholds(
            bounce_speed=float(settings.bounce_speed),
            recovery_speed=float(settings.recovery_speed),
            impact_speed=float(settings.impact_speed),
            touching_height=float(settings.touching_height),
            adhesion_reach=float(settings.adhesion_reach),
        ),
    )


@fused_inlined_kernel
def recovery_time(law, h):  # type: ignore[no-untyped-def]
    """Time s [s] over which a touching corner is to be back at phi = 0, in a step of length h.

    s = sqrt(h² + relaxation²) + m' compliance / h, with m' the added mass; h + relaxation without a spring. A spring
    at the step's end damps by k h, which is taken off its damper; smoothly, so that the motion still depends on a
    damper that is weaker than that, and it can be learned.
    """
    if law.compliance == 0.0:
        return h + law.relaxation
    s = math.sqrt(h * h + law.relaxation * law.relaxation)
    return s + law.beyond.added_mass * law.compliance / h


@fused_inlined_kernel
def kept_speed(law, h):  # type: ignore[no-untyped-def]
    """Shares of a touching corner's speed, along the normal and across, that its added mass m' keeps through a step.

    m' dv/dt + d v + k z = -f along the normal, and m' dv/dt + d v = -f across, where no spring acts.
    """
    inert = law.beyond.added_mass * law.compliance
    if inert == 0.0:
        return 0.0, 0.0
    return inert / (h * recovery_time(law, h)), inert / (inert + h * law.relaxation)


@fused_inlined_kernel
def above_ground(law, z, c, sunk, rigid, h):  # type: ignore[no-untyped-def]
    """Height of corner c at z over the ground as it is below that corner.

    Recorded states lie in the ground by their noise, and phi / h of that depth would be a kick. So rigid ground is as
    deep as the corner where a toss begins in it, and rises at `recovery_speed`. Compliant ground needs no such care.
    """
    if sunk[c] == UNKNOWN:
        sunk[c] = min(z, 0.0) if rigid else 0.0
    elif sunk[c] < 0.0:
        sunk[c] = min(sunk[c] + law.thresholds.recovery_speed * h, 0.0)
    return z - sunk[c]
