"""Contact problems and their solvers: Numba kernels over batches, each with a plain reference."""

from tossid.physics.solvers.cone_qp import cone_qp_kernel, qp_work, solve_cone_qp
from tossid.physics.solvers.problem import ContactSolution, SolverStatus

__all__ = ["ContactSolution", "SolverStatus", "cone_qp_kernel", "qp_work", "solve_cone_qp"]
