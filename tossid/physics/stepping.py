"""Time stepping with contact over batches of tosses, by Stewart and Trinkle's scheme (docs/method/scheme.md)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.parallel import over_threads
from tossid.physics.body import Body, make_body
from tossid.physics.contact.law import ContactLaw, make_contact_law
from tossid.physics.links import Links, make_links
from tossid.physics.network import Network, make_network
from tossid.physics.solvers.cones import ExactCone
from tossid.physics.solvers.registry import ContactSolver, check_solver
from tossid.physics.system import System
from tossid.physics.time_step import Engine, Simulation, StepSettings, Tosses, simulate_part

Array = NDArray[np.float64]

EXACT_CONE = ExactCone()
"""The contact solver where none is named."""
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
            than `IMPACT_SPEED` (`contact.law`) ends there or, where contact gives way, is cut in so many.
        solver: of the contact problem: `ExactCone()`, `PolyhedralCone(n_directions=8)`, or one's own
            (`solvers.register_solver`).
        tolerance: on the contact problem's KKT error [m/s].
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
    check_solver(solver, relaxed=system.law.lifting > 0)
    model, law, k_res = _prepared(_ById(system), dt / substeps)
    settings = StepSettings(float(dt), substeps, impact_parts, tolerance)
    engine = Engine(model, law, k_res, solver, settings, at_impacts=impact_parts > 1 and law.rigid)
    T, nc = int(steps.max()), system.n_corners
    out = Simulation(
        q=np.empty((count, T + 1, system.nq)),
        v=np.empty((count, T + 1, system.nv)),
        lam_n=np.zeros((count, T, nc)),
        unsolved=np.zeros(count, dtype=np.int64),
        kkt_error=np.zeros(count),
        finite=np.ones(count, dtype=bool),
    )
    tosses = Tosses(q0, v0, steps)

    def part(first: int, last: int) -> None:
        simulate_part(engine, tosses, out, model.make_work(), first, last)

    over_threads(part, count, n_threads)
    return out


class _ById:
    """A system, equal to itself alone: its arrays have no hash."""

    def __init__(self, system: System) -> None:
        self.system = system

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _ById) and self.system is other.system

    def __hash__(self) -> int:
        return id(self.system)


@lru_cache(maxsize=16)
def _prepared(by_id: _ById, step: float) -> tuple[Body | Links, ContactLaw, Network]:
    """What the kernels read of a system, made once: single frames of a few motions cost little more than it does.

    The system's arrays become read-only: a change in place would not be seen.
    """
    system = by_id.system
    for part in (*system, *system.k_res, *system.joints):
        if isinstance(part, np.ndarray):
            part.flags.writeable = False
    model = make_body(system) or make_links(system)
    return model, make_contact_law(system, step), make_network(system.k_res)
