"""Contact solvers by type: a solver is a NamedTuple of its settings, and a kernel that is registered for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from tossid.errors import InputError
from tossid.kernels import FUSED, by_type, implemented, implements, kernel, register_implementation
from tossid.physics.solvers.workspace import LAM, MU, B, problem_rows

ARGUMENTS = ("solver", "A", "b", "mu", "lam", "tolerance")
"""What a registered function takes, in this order."""

ContactSolver = tuple[Any, ...]
"""A contact solver: a NamedTuple of its settings, of a class that is registered.

The class may have the method `check(relaxed: bool)`, which raises `InputError` for settings out of range or, if
`relaxed`, where the solver cannot stand beside the convex relaxation of Coulomb's law.
"""


def check_solver(solver: ContactSolver, *, relaxed: bool) -> None:
    """Refuse a solver that is not registered, or that refuses its settings.

    Args:
        solver: of contact.
        relaxed: whether contacts near the ground follow the convex relaxation of Coulomb's law.

    Raises:
        InputError: with the solvers that are registered, or by the solver's own check.
    """
    if type(solver) not in implemented(solve_contact):
        names = ", ".join(sorted(kind.__name__ for kind in implemented(solve_contact)))
        raise InputError(f"{solver!r} is no registered contact solver; there are {names} (see register_solver)")
    check = getattr(solver, "check", None)
    if check is not None:
        check(relaxed)


@by_type
def solve_contact(solver, A, V, index, n, tolerance):  # type: ignore[no-untyped-def]
    """Solve A, V[B], V[MU] of n contacts in place of V[LAM], the warm start; returns (status, KKT error [m/s])."""


def register_solver(kind: type) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A decorator that makes a function the contact solver of a NamedTuple class of settings.

    Objects of the class can then be given to `simulate` as `solver`. The first simulation compiles the time stepper
    anew for it.

    Args:
        kind: a NamedTuple class with the solver's settings as fields (numbers); it may have none.

    Returns:
        A decorator of `function(solver, A, b, mu, lam, tolerance) -> (status, kkt_error)`, which Numba can compile. The
        problem is as in `problem`: A (3 n, 3 n) [1/kg], b (3 n,) [m/s], mu (n,); lam (3 n,) [N s] holds the warm start
        and receives the answer, in the order [n.., t1 t2 ..]. status is a `SolverStatus`, kkt_error [m/s] says how far
        from solved the problem is.

    Raises:
        InputError: the class is no NamedTuple class or has a solver already, or the function takes other arguments.
    """

    def register(function: Callable[..., Any]) -> Callable[..., Any]:
        register_implementation(solve_contact, kind, function, ARGUMENTS, "contact solver")
        compiled = function if hasattr(function, "py_func") else kernel(function, fastmath=FUSED, keep=False)

        @kernel(keep=False)
        def in_place(solver, A, V, index, n, tolerance):  # type: ignore[no-untyped-def]
            A_, b, lam, rows = np.empty((3 * n, 3 * n)), np.empty(3 * n), np.empty(3 * n), problem_rows(n)
            for r in range(3 * n):
                b[rows[r]], lam[rows[r]] = V[B, r], V[LAM, r]
                for t in range(3 * n):
                    A_[rows[r], rows[t]] = A[r, t]
            status, kkt_error = compiled(solver, A_, b, V[MU, :n].copy(), lam, tolerance)
            for r in range(3 * n):
                V[LAM, r] = lam[rows[r]]
            return status, kkt_error

        @implements(solve_contact, kind)
        def solve(solver, A, V, index, n, tolerance):  # type: ignore[no-untyped-def]
            return in_place(solver, A, V, index, n, tolerance)

        return compiled

    return register
