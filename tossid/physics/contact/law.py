"""The law of contact at one corner: the only place where laws branch.

`Law` has the parameters of contact beyond a constant friction, each neutral by default; a law of one's own is a field
more, and a line in `normal_target` or `friction_coefficient` (docs/method/scheme.md, "Change the contact law").
docs/method/scheme.md has the equations, whose numbers stand here.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import fused_inlined_kernel, inlined_kernel, lean_kernel

if TYPE_CHECKING:
    from tossid.physics.system import System

Array = NDArray[np.float64]

UNKNOWN = 1.0
"""Stands for the depth of the ground below a corner whose toss has not begun; true depths are not positive."""
BOUNCE_SPEED = 0.02
"""Speed of approach below which restitution does not act [m/s], that of a fall from 0.02 mm: without it, a body at rest
would bounce on in ever shorter bounces. Own choice; Box2D has the same threshold, at 1 m/s."""
RECOVERY_SPEED = 0.02
"""Speed at which a corner that begins in rigid ground comes out of it [m/s]: recorded states lie in the ground by their
noise, and depth over time step would be a kick. Own choice; Chrono and ODE limit the same speed."""
IMPACT_SPEED = 0.1
"""Speed at which a corner has to cross the ground for a time step to end there [m/s], where steps end at impacts
(docs/adr/0010): a slower one moves less than 0.2 mm in a step of 1/592 s. Own choice."""
TOUCHING_HEIGHT, TOUCHING_SPEED = 5e-5, 0.03
"""Height up to which a corner touches rigid ground, where steps end at impacts [m]: an impact at 0.8 m/s is then too
slow by at most 6e-4 m/s. In short steps it is less, so many metres per second times the step: a height that stays would
have impacts the earlier, the shorter steps are. Own choice."""
ADHESION_REACH = 5e-4
"""Height up to which adhesion pulls at a corner that carried no load in the last step [m]. Own choice."""


class Law(NamedTuple):
    """Contact beyond a constant friction.

    Attributes:
        static_rel: friction at rest over that of fast sliding. At slip speed s it is
            mu (1 + (static_rel - 1) exp(-(s / slip_speed)²)).
        slip_speed: [m/s].
        y_rel: friction along the world's y over that along x; 1 / mu² = d_x² / mu_x² + d_y² / mu_y² for a slip along d.
        torsional: torque per normal force against spin about the vertical [m].
        rolling: torque per normal force against spin about the horizontal [m].
        adhesion: pull of the ground on each touching corner [N].
        lifting: height of a corner below which a step's contact problem is the convex relaxation of Coulomb's law
            (Anitescu 2006), as MuJoCo has it: what slips at s leaves the ground at mu s [m]. 0: Coulomb's law.
        rounding: radius of the corners, spheres that touch the faces of a box with sharp ones [m].
        added_mass: of each corner in contact that yields [kg]: its force is that of its spring and damper, less this
            mass times its acceleration (MuJoCo's 1 / R, by which contact holds most of a load at once).
        margin: height of a corner at the beginning of a step from which on it is not in contact within the step, for
            contact that yields [m]. MuJoCo has 0 by default; without a limit, it is in contact where it comes down.
        impulse_parts: parts in which the impulse of a rigid impact is found, each with friction against the slip as it
            is then (Routh; Keller, "Impact with friction", J. Appl. Mech. 53, 1986). 1: all at once, against the slip
            after the impact.
    """

    static_rel: float = 1.0
    slip_speed: float = 0.1
    y_rel: float = 1.0
    torsional: float = 0.0
    rolling: float = 0.0
    adhesion: float = 0.0
    lifting: float = 0.0
    rounding: float = 0.0
    added_mass: float = 0.0
    margin: float = math.inf
    impulse_parts: float = 1.0

    @property
    def acts(self) -> bool:
        """Whether contact differs from that of a constant friction; the slip speed alone does not."""
        return self != Law(slip_speed=self.slip_speed, impulse_parts=self.impulse_parts)


class ContactLaw(NamedTuple):
    """How corners touch the ground, as the time step's kernels read it.

    Attributes:
        mu: (n_c,) friction coefficient of each corner.
        restitution: Newton's coefficient.
        compliance: 1 / stiffness of a corner [m/N], 0 for rigid contact.
        relaxation: damping over stiffness of a corner [s].
        cohesion: c of |f_t| <= mu f_n + c [N].
        rigid: whether nothing yields.
        varied: whether `beyond` differs from a constant friction.
        beyond: contact beyond a constant friction.
        touching_height: up to which a corner touches [m].
    """

    mu: Array
    restitution: float
    compliance: float
    relaxation: float
    cohesion: float
    rigid: bool
    varied: bool
    beyond: Law
    touching_height: float


def make_contact_law(system: System, step: float) -> ContactLaw:
    """The law of contact of a system.

    Args:
        system: the simulator's parameters.
        step: length of a time step [s].
    """
    return ContactLaw(
        mu=np.array(system.mu),
        restitution=float(system.restitution),
        compliance=float(system.compliance),
        relaxation=float(system.relaxation),
        cohesion=float(system.cohesion),
        rigid=system.compliance == 0.0 and system.relaxation == 0.0,
        varied=system.law.acts,
        beyond=Law(*map(float, system.law)),
        touching_height=min(TOUCHING_HEIGHT, TOUCHING_SPEED * step),
    )


@fused_inlined_kernel
def recovery_time(law, h):  # type: ignore[no-untyped-def]
    """Time s [s] over which a touching corner is to be back at phi = 0, in a step of length h (eq. 9).

    A spring at the step's end damps by k h, which is taken off its damper; smoothly, so that the motion still depends
    on a damper that is weaker than that, and it can be learned.
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
def above_ground(law, z, c, sunk, h):  # type: ignore[no-untyped-def]
    """Height of corner c at z over the ground as it is below that corner.

    Recorded states lie in the ground by their noise, and phi / h of that depth would be a kick. So rigid ground is as
    deep as the corner where a toss begins in it, and rises at `RECOVERY_SPEED`. Compliant ground needs no such care.
    """
    if sunk[c] == UNKNOWN:
        sunk[c] = min(z, 0.0) if law.rigid else 0.0
    elif sunk[c] < 0.0:
        sunk[c] = min(sunk[c] + RECOVERY_SPEED * h, 0.0)
    return z - sunk[c]


@inlined_kernel
def normal_target(law, phi, free, before, h, bounces, done):  # type: ignore[no-untyped-def]
    """b_n of a corner's contact problem, w_n = (A lam)_n + b_n >= 0 (eq. 4, 6, 9), and what of its slip is kept.

    Args:
        law: `ContactLaw`.
        phi: gap [m].
        free: J_n v_free, the normal velocity without contact [m/s].
        before: J_n v, the normal velocity at the step's start [m/s].
        h: length of the step [s].
        bounces: whether restitution acts at any approach, not only below `IMPACT_SPEED`.
        done: share of an impact that a part of it ends with, if it is resolved in parts; else 0.

    Returns:
        (b_n [m/s], share of the slip at the step's start that the added mass keeps).
    """
    if done > 0.0 and phi <= 0.0:  # eq. 8: equal shares of rest and bounce
        target = free - (1.0 - done) * min(0.0, before)
        if before < -BOUNCE_SPEED:
            target += done * law.restitution * before
        return target, 0.0
    target = phi / h + free
    if law.restitution > 0.0:
        if target < 0.0 and before < -BOUNCE_SPEED and (bounces or before > -IMPACT_SPEED):
            target = min(target, free + law.restitution * before)  # Newton: J_n v' >= -e J_n v
        return target, 0.0
    if target < 0.0 or phi < 0.0:
        kept, kept_across = kept_speed(law, h)
        return phi / recovery_time(law, h) + free - kept * before, kept_across
    return target, 0.0


@lean_kernel
def friction_coefficient(law, mu, before_x, before_y, free_x, free_y):  # type: ignore[no-untyped-def]
    """A corner's friction coefficient in this step (eq. 11).

    Args:
        law: `Law`.
        mu: of fast sliding along x.
        before_x: slip at the step's start [m/s], along the world's x.
        before_y: along y.
        free_x: slip without this step's contact forces [m/s].
        free_y: along y.
    """
    if law.static_rel != 1.0:
        s = (before_x * before_x + before_y * before_y) / (law.slip_speed * law.slip_speed)
        mu *= 1.0 + (law.static_rel - 1.0) * math.exp(-s)
    if law.y_rel != 1.0:
        s = free_x * free_x + free_y * free_y
        if s > 0.0:
            mu *= math.sqrt(s / (free_x * free_x + free_y * free_y / (law.y_rel * law.y_rel)))
    return mu


@inlined_kernel
def with_cohesion(law, mu, load, h):  # type: ignore[no-untyped-def]
    """The coefficient whose cone is |lam_t| <= mu lam_n + c h at the load lam_n [N s], at most twice mu (eq. 12)."""
    if law.cohesion > 0.0 and load > 0.0:
        return min(2.0 * mu, mu + law.cohesion * h / load)
    return mu


@inlined_kernel
def is_pressed(law, phi, target, mu, slip_x, slip_y):  # type: ignore[no-untyped-def]
    """Whether a corner without impulse breaks its law: b_n < 0, or b outside the dual cone if friction is relaxed."""
    if phi < 0.0 < law.beyond.lifting:
        return target < mu * math.sqrt(slip_x * slip_x + slip_y * slip_y)
    return target < 0.0
