"""Contact problems and their solvers: Numba kernels over batches. Tests compare each with a plain reference."""

from tossid.physics.solvers.cone_qp import solve_cone_qp
from tossid.physics.solvers.exact_cone import ExactCone
from tossid.physics.solvers.polyhedral_cone import PolyhedralCone
from tossid.physics.solvers.problem import ContactSolution, SolverStatus
from tossid.physics.solvers.registry import ContactSolver, register_solver
from tossid.physics.solvers.solve import solve_contacts

__all__ = [
    "ContactSolution",
    "ContactSolver",
    "ExactCone",
    "PolyhedralCone",
    "SolverStatus",
    "register_solver",
    "solve_cone_qp",
    "solve_contacts",
]
