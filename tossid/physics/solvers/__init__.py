"""Contact problems and their solvers: Numba kernels over batches. Tests compare each with a plain reference."""

from tossid.physics.solvers.cones import ConeProgramme, ExactCone
from tossid.physics.solvers.polyhedral_cone import PolyhedralCone
from tossid.physics.solvers.problem import ContactSolution, SolverStatus
from tossid.physics.solvers.registry import ContactSolver, register_solver
from tossid.physics.solvers.solve import solve_contacts

__all__ = [
    "ConeProgramme",
    "ContactSolution",
    "ContactSolver",
    "ExactCone",
    "PolyhedralCone",
    "SolverStatus",
    "register_solver",
    "solve_contacts",
]
