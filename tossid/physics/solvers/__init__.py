"""Contact problems and their solvers: Numba kernels over batches. Tests compare each with a plain reference."""

from tossid.physics.solvers.cone import cone_kernel, solve_cone
from tossid.physics.solvers.cone_qp import cone_qp_kernel, solve_cone_qp
from tossid.physics.solvers.exact_cone import ExactCone
from tossid.physics.solvers.lcp import LcpSolution, lcp_kernel, lcp_scratch, solve_lcp
from tossid.physics.solvers.polyhedral_cone import PolyhedralCone
from tossid.physics.solvers.problem import ContactSolution, SolverStatus, tangent_directions
from tossid.physics.solvers.registry import ContactSolver, register_solver
from tossid.physics.solvers.workspace import work_arrays

__all__ = [
    "ContactSolution",
    "ContactSolver",
    "ExactCone",
    "LcpSolution",
    "PolyhedralCone",
    "SolverStatus",
    "cone_kernel",
    "cone_qp_kernel",
    "lcp_kernel",
    "lcp_scratch",
    "register_solver",
    "solve_cone",
    "solve_cone_qp",
    "solve_lcp",
    "tangent_directions",
    "work_arrays",
]
