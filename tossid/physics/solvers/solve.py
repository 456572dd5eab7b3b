"""Batches of contact problems, by any registered solver."""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.kernels import fused_kernel
from tossid.parallel import over_threads
from tossid.physics.solvers.cones import ExactCone
from tossid.physics.solvers.problem import ContactSolution
from tossid.physics.solvers.registry import ContactSolver, check_solver, solve_contact
from tossid.physics.solvers.workspace import LAM, MU, NOT_FINITE, TOP, B, problem_rows, work_arrays

Array = NDArray[np.float64]

TOLERANCE = 1e-9
"""KKT error [m/s] at which solvers stop."""


class Problems(NamedTuple):
    """A batch of contact problems, contiguous; rows in the order of `problem`.

    Attributes:
        A: (B, 3 n, 3 n) Delassus matrices [1/kg].
        b: (B, 3 n) [m/s]; of cone programmes, their linear term.
        mu: (B, n) friction coefficients.
    """

    A: Array
    b: Array
    mu: Array


@fused_kernel
def contact_batch(solver, problems, out, tolerance, first, last):  # type: ignore[no-untyped-def]
    """`solve_contact` on problems first..last-1 of a batch, one after another, into `out`, a `ContactSolution`."""
    A, b, mu = problems
    n = mu.shape[1]
    V, index = work_arrays(n)
    rows, local = problem_rows(n), V[TOP + 3 * n :]
    for k in range(first, last):
        status, kkt_error, total = NOT_FINITE, math.inf, 0.0
        for i in range(n):
            V[MU, i] = mu[k, i]
            total += mu[k, i]
        for r in range(3 * n):
            V[B, r], V[LAM, r] = b[k, rows[r]], out.lam[k, rows[r]]
            total += abs(b[k, r])
        if total < math.inf:
            for r in range(3 * n):
                for t in range(3 * n):
                    local[r, t] = A[k, rows[r], rows[t]]
            status, kkt_error = solve_contact(solver, local, V, index, n, tolerance)
        for r in range(3 * n):
            out.lam[k, rows[r]] = 0.0 if status == NOT_FINITE else V[LAM, r]
        out.status[k], out.kkt_error[k] = status, kkt_error


def solve_contacts(
    A: Array,
    b: Array,
    mu: Array,
    *,
    solver: ContactSolver = ExactCone(),
    warm: Array | None = None,
    tolerance: float = TOLERANCE,
    n_threads: int = 1,
) -> ContactSolution:
    """Solve a batch of contact problems as a time step solves its own.

    Args:
        A: (B, 3 n, 3 n) [1/kg] Delassus matrices, symmetric, positive semi-definite.
        b: (B, 3 n) [m/s]; the linear term of a `ConeProgramme`.
        mu: (), (n,) or (B, n) friction coefficients, at least 0.
        solver: A registered one.
        warm: (B, 3 n) [N s] impulses to start from; zero if None.
        tolerance: [m/s] on the KKT error (`problem`), in the unit of b.
        n_threads: The batch is split over this many threads (the kernels release the GIL).

    Returns:
        The solutions; lam (B, 3 n) [N s] in the order [n.., t1 t2 ..].

    Raises:
        InputError: Shapes that do not fit, a negative mu, or no registered solver.
    """
    check_solver(solver, relaxed=False)
    A, b = np.ascontiguousarray(A, dtype=float), np.ascontiguousarray(b, dtype=float)
    if b.ndim != 2 or b.shape[1] % 3 or A.shape != (*b.shape, b.shape[1]):
        raise InputError(f"contact problems of shapes A {A.shape} and b {b.shape}; expected (B, 3 n, 3 n) and (B, 3 n)")
    count, n = b.shape[0], b.shape[1] // 3
    mu = np.asarray(mu, dtype=float)
    if mu.shape not in ((), (n,), (count, n)):
        raise InputError(f"friction of shape {mu.shape}, expected ({n},) or ({count}, {n})")
    if (mu < 0).any():
        raise InputError(f"friction coefficient {mu.min():g} is negative")
    if warm is not None and np.shape(warm) != b.shape:
        raise InputError(f"warm start of shape {np.shape(warm)}, expected {b.shape}")
    lam = np.zeros(b.shape) if warm is None else np.array(warm, dtype=float, order="C")
    out = ContactSolution(lam, np.empty(count, dtype=np.uint8), np.empty(count))
    problems = Problems(A, b, np.ascontiguousarray(np.broadcast_to(mu, (count, n))))
    over_threads(partial(contact_batch, solver, problems, out, tolerance), count, n_threads)
    return out
