"""Batches of contact problems, by any registered solver."""

from __future__ import annotations

import math

from tossid.kernels import fused_kernel
from tossid.parallel import over_threads
from tossid.physics.solvers.exact_cone import ExactCone
from tossid.physics.solvers.problem import DEFAULT_TOLERANCE, Array, ContactSolution, check_batch, empty_solution
from tossid.physics.solvers.registry import ContactSolver, check_solver, solve_contact
from tossid.physics.solvers.workspace import NOT_FINITE, TOP, gather, gather_matrix, scatter, work_arrays


@fused_kernel
def contact_batch(solver, problems, out, tolerance, first, last):  # type: ignore[no-untyped-def]
    """`solve_contact` on problems first..last-1 of a batch, one after another, into `out`, a `ContactSolution`."""
    A, b, mu = problems
    n = mu.shape[1]
    work, index = work_arrays(n)
    local = work[TOP + 3 * n :]
    for k in range(first, last):
        total = gather(b[k], mu[k], out.lam[k], work)
        status, kkt_error = NOT_FINITE, math.inf
        if total < math.inf:
            gather_matrix(A[k], local, n)
            status, kkt_error = solve_contact(solver, local, work, index, n, tolerance)
        scatter(out.lam[k], work, n, status)
        out.status[k], out.kkt_error[k] = status, kkt_error


def solve_contacts(
    A: Array,
    b: Array,
    mu: Array,
    *,
    solver: ContactSolver = ExactCone(),
    warm: Array | None = None,
    tolerance: float = DEFAULT_TOLERANCE,
    n_threads: int = 1,
) -> ContactSolution:
    """Solve a batch of contact problems as a time step solves its own.

    Args:
        A: (B, 3 n, 3 n) [1/kg] Delassus matrices, symmetric, positive semi-definite.
        b: (B, 3 n) [m/s].
        mu: (n,) or (B, n) friction coefficients, at least 0.
        solver: A registered one.
        warm: (B, 3 n) [N s] impulses to start from; zero if None.
        tolerance: [m/s] on the KKT error (`problem`).
        n_threads: The batch is split over this many threads (the kernels release the GIL).

    Returns:
        The solutions; lam (B, 3 n) [N s] in the order [n.., t1 t2 ..].

    Raises:
        InputError: Shapes that do not fit, a negative mu, or no registered solver.
    """
    check_solver(solver, relaxed=False)
    problems, lam = check_batch(A, b, mu, warm)
    out = empty_solution(lam)

    def part(first: int, last: int) -> None:
        contact_batch(solver, problems, out, tolerance, first, last)

    over_threads(part, len(lam), n_threads)
    return out
