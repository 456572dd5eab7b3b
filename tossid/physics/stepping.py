"""Time stepping with contact: Stewart and Trinkle's scheme over batches of tosses.

One step of length h from (q, v), with a the acceleration without contact:

    v_free = v + h a(q, v)
    find the corners' impulses lam with  0 <= lam_n  _|_  phi(q) + h J_n v' >= 0  and Coulomb friction
    v' = v_free + M^-1 J^T lam
    q' = q moved along v' if anything touches, else along (v + v') / 2 (exact for constant a)

Stewart and Trinkle, "An implicit time-stepping scheme for rigid body dynamics
with inelastic collisions and Coulomb friction", IJNME 1996. Restitution, where
there is any, is Newton's: an approaching corner must leave with J_n v' >= -e J_n v.

A compliant corner is a spring and a damper at the step's end, phi' = phi + h J_n v',

    lam_n / h = max(0, -k phi' - (d - k h) J_n v'),     k = 1 / compliance,     d = k relaxation

with k h off its damper, by which a spring at the step's end damps; smoothly, since there may be less (s in place of
h + (relaxation - h)). That is the complementarity of a rigid one with another gap and a slack:

    0 <= lam_n  _|_  phi / s + J_n v' + compliance / (h s) lam_n >= 0,     s = sqrt(h² + relaxation²)

as in Castro, Permenter and Han, "An unconstrained convex formulation of compliant contact", T-RO 2022 (whose convex
friction is not used here). The damper does not act at a distance: a corner above the ground that would not reach it in
free motion, and is pushed there by others, has phi / h for its gap. With a margin (`Law.margin`), it acts only on
corners that are that low when a step begins, as engines have it that look for contacts first. Its tangential rows have
a thousandth of the slack (their sigma): several compliant corners that stick would else leave only slips of 1e-6 m/s to
balance their loads, which no solver finds soon. A sticking corner creeps by that slack times lam_t, 1e-5 m/s for a
newton at 33 kN/m.

Where a toss begins with a corner in rigid ground, the ground is as deep below that corner and rises at 2 cm/s
(`ContactSettings.recovery_speed`): recorded states are noisy, and phi / h of a depth that is noise would be a kick.

An impact that falls into a step is felt in two parts: at its end, so much of the impulse as brings the corner to the
ground by then, and the rest a step later. Two parts are not the same impulse where friction turns or others are hit,
and how large each is hangs on where in the step the impact was: motions sway with the grid of steps, by 0.1 to 0.4 mm
after a few frames, however short the steps are. With `impact_parts`, a step of rigid contact ends where a corner
touches, and the impulse is felt there at once (as in event-driven schemes; Studer, "Numerics of Unilateral Contacts and
Friction", 2009). Contact that gives way has no such moment; there steps with an impact are cut in so many, which costs
impacts' share, and the error in their time falls in proportion.

Such steps of rigid contact, and those of flight, go half of their way along v, find a, J and lam there, and go the
other half along v' (the midpoint rule of Moreau, "Numerical aspects of the sweeping process", 1999), so that errors are
of second order but for events. A corner on the ground then has J_n v' + h/2 dJ_n/dt v >= 0, its velocity at the step's
end. Friction of what slides on is against the mean slip, and of what may stop against that at the end. Where a corner
comes to the ground too slowly for a strike, the step is that of above.

Cohesion c lets friction grow less than in proportion to load (Mohr and Coulomb),
|lam_t| <= mu lam_n + c h: the friction coefficient of the step is min(2 mu, mu + c h / lam_n),
and mu where there is no load. lam_n is first that of the step before. Where steps end at impacts,
the step is then solved again with its own.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.kernels import kernel
from tossid.parallel import over_threads
from tossid.physics.body import Body, make_body
from tossid.physics.contact.law import ContactLaw, make_contact_law
from tossid.physics.contact.problem import make_corners
from tossid.physics.links import Links, make_links
from tossid.physics.moving import make_state
from tossid.physics.network import Network, make_network
from tossid.physics.solvers.exact_cone import ExactCone
from tossid.physics.solvers.registry import ContactSolver, check_solver
from tossid.physics.system import System
from tossid.physics.time_step import Simulation, StepSettings, Tosses, simulate_tosses
from tossid.settings.contact import ContactSettings

Array = NDArray[np.float64]

EXACT_CONE = ExactCone()
"""The contact solver where none is named."""
TOUCHING_SPEED = 0.03
"""In short steps a corner touches the ground up to so many metres per second times the step, if that is less than
`ContactSettings.touching_height`: a height that stays would have impacts the earlier, the shorter steps are."""
TOLERANCE = 1e-7
"""KKT error [m/s] below which a step's contact problem counts as solved."""


def simulate(
    system: System,
    q0: Array,
    v0: Array,
    *,
    n_steps: int | NDArray[np.int64],
    dt: float,
    substeps: int = 1,
    impact_parts: int = 1,
    solver: ContactSolver = EXACT_CONE,
    tolerance: float = TOLERANCE,
    contact: ContactSettings = ContactSettings(),
    n_threads: int = 1,
) -> Simulation:
    """The motion of a batch of tosses.

    Args:
        system: the simulator's parameters.
        q0: (B, nq) initial configurations.
        v0: (B, nv) initial velocities.
        n_steps: frames to simulate, one number or one a toss (B,), at least 1.
        dt: time between frames [s], at least `substeps` steps each.
        substeps: steps in a frame.
        impact_parts: more than 1 for impacts where they happen: a step in which a corner crosses the ground at more
            than `contact.impact_speed` ends there or, where contact gives way, is cut in so many.
        solver: of the contact problem: `ExactCone()`, `PolyhedralCone(n_directions=8)`, or one's own
            (`solvers.register_solver`).
        tolerance: on the contact problem's KKT error [m/s].
        contact: speeds and heights that decide between cases of contact.
        n_threads: tosses are split over this many threads.

    Returns:
        The simulated tosses, each with how many steps' contact problems missed the tolerance.

    Raises:
        InputError: shapes that do not fit, numbers out of range, a solver that is not registered, or a law of contact
            that the solver cannot take.
    """
    q0, v0 = np.ascontiguousarray(q0, dtype=float), np.ascontiguousarray(v0, dtype=float)
    count = len(q0)
    if q0.shape != (count, system.nq) or v0.shape != (count, system.nv):
        raise InputError(
            f"initial states of shapes {q0.shape} and {v0.shape}, expected (B, {system.nq}) and (B, {system.nv})"
        )
    steps = np.empty(count, dtype=np.int64)
    steps[:] = n_steps
    if (steps < 1).any() or substeps < 1 or impact_parts < 1 or not dt > 0:
        raise InputError("a simulation needs dt > 0, and at least one step a toss, one substep a step and one part")
    same = _Same(system)
    model, (law, k_res) = _model_of(same), _laws_of(same, contact, dt / substeps)
    check_solver(solver, relaxed=law.beyond.lifting > 0)
    T, nc = int(steps.max()), system.n_corners
    out = Simulation(
        q=np.empty((count, T + 1, system.nq)),
        v=np.empty((count, T + 1, system.nv)),
        lam_n=np.zeros((count, T, nc)),
        unsolved=np.zeros(count, dtype=np.int64),
        kkt_error=np.zeros(count),
        finite=np.ones(count, dtype=bool),
    )
    settings, tosses = StepSettings(float(dt), substeps, impact_parts, tolerance), Tosses(q0, v0, steps)

    def part(first: int, last: int) -> None:
        _simulate_part(model, law, k_res, solver, settings, tosses, out, model.make_work(), first, last)

    over_threads(part, count, n_threads)
    return out


@kernel
def _simulate_part(model, law, k_res, solver, settings, tosses, out, work, first, last):  # type: ignore[no-untyped-def]
    """`simulate_tosses` with its own scratch: to hand thirty more arrays to a kernel takes longer than one motion."""
    nv = tosses.v.shape[1]
    corners = make_corners(law.mu.shape[0], nv - 3)
    state = make_state(tosses.q.shape[1], nv, k_res.b0.shape[0])
    simulate_tosses(model, law, k_res, solver, settings, tosses, out, work, state, corners, first, last)


def _touching_in(step: float, law: ContactLaw) -> ContactLaw:
    """The law with the height up to which a corner touches in steps of a length [s]."""
    height = min(law.thresholds.touching_height, TOUCHING_SPEED * step)
    return law._replace(thresholds=law.thresholds._replace(touching_height=height))


class _Same:
    """A system, equal to itself alone: its arrays have no hash."""

    def __init__(self, system: System) -> None:
        self.system = system

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.system is other.system

    def __hash__(self) -> int:
        return id(self.system)


@lru_cache(maxsize=16)
def _model_of(same: _Same) -> Body | Links:
    """What the kernels read of a system, made once: single frames of a few motions cost little more than it does."""
    return make_body(same.system) or make_links(same.system)


@lru_cache(maxsize=16)
def _laws_of(same: _Same, contact: ContactSettings, step: float) -> tuple[ContactLaw, Network]:
    """Its law of contact in steps of a length [s], and its learned acceleration, likewise."""
    law = _touching_in(step, make_contact_law(same.system, contact))
    return law, make_network(same.system.k_res)
