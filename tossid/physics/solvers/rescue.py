"""Second tries for the few problems that the quick kernels leave unsolved (slow, thorough, rarely reached).

They run one problem at a time from Python. Their kernels are compiled when first needed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tossid.physics.solvers.interior import interior_point
from tossid.physics.solvers.problem import Array, contact_rows
from tossid.physics.solvers.workspace import MAX_ITERATIONS, SOLVED

Attempt = Callable[[Array, int], tuple[int, float, int]]
"""(warm start and answer lam (3 n,), iteration limit) -> (status, kkt_error, iterations)."""


def interior_start(A: Array, c: Array, mu: Array, active: NDArray[np.bool_], regularization: float) -> Array:
    """The interior-point method's answer to one cone programme, as a warm start.

    Args:
        A: (3 n, 3 n).
        c: (3 n,).
        mu: (n,).
        active: (n,); other contacts get zero.
        regularization: added to A's diagonal.

    Returns:
        (3 n,); zero if the method fails.
    """
    n = len(mu)
    rows = np.array([contact_rows(int(i), n) for i in np.flatnonzero(active)], dtype=int).ravel()
    local = np.ascontiguousarray(A[np.ix_(rows, rows)]) + regularization * np.eye(len(rows))
    answer = np.zeros(len(rows))
    interior_point(local, c[rows], mu[active], int(active.sum()), answer)
    lam = np.zeros(3 * n)
    if np.isfinite(answer).all():
        lam[rows] = answer
    return lam


def rescue_programme(start: Array, attempt: Attempt, lam: Array, kkt_error: float) -> tuple[int, float]:
    """Try a cone programme again from another start.

    Args:
        start: (3 n,).
        attempt: the quick solver.
        lam: (3 n,) the best answer so far, replaced by a better one.
        kkt_error: of lam.

    Returns:
        (status, KKT error).
    """
    trial = start.copy()
    status, found, _ = attempt(trial, 500)
    if found < kkt_error:
        lam[:] = trial
        return status, found
    return MAX_ITERATIONS, kkt_error


def rescue_cone(
    A: Array,
    b: Array,
    mu: Array,
    lam: Array,
    kkt_error: float,
    *,
    polyhedral: Array,
    programme: Callable[[Array, Array], None],
    attempt: Attempt,
    turns: int = 60,
) -> tuple[int, float]:
    """Second tries of an exact-cone problem.

    First from the answer of the same problem with a polyhedral cone. Then as a sequence of cone programmes
    (Cadoux 2009): each turn holds c_n = b_n + mu |w_t|, solves the programme and starts `attempt` from its answer.

    Args:
        A: (3 n, 3 n) [1/kg].
        b: (3 n,) [m/s].
        mu: (n,).
        lam: (3 n,) the best answer so far [N s], replaced by a better one.
        kkt_error: of lam [m/s].
        polyhedral: (3 n,) the polyhedral cone's answer [N s].
        programme: programme(c, lam) solves a cone programme in place of lam, its warm start.
        attempt: the quick solver.
        turns: programmes, at most.

    Returns:
        (status, KKT error [m/s]).
    """
    n = len(mu)
    trial = polyhedral.copy()
    status, found, _ = attempt(trial, 60)
    if found < kkt_error:
        lam[:], kkt_error = trial, found
    if status == SOLVED:
        return status, kkt_error
    guess = lam.copy()
    slip = np.zeros(n)
    for turn in range(turns):
        c = b.copy()
        c[:n] += mu * slip
        programme(c, guess)
        trial = guess.copy()
        status, found, _ = attempt(trial, 25)
        if found < kkt_error:
            lam[:], kkt_error = trial, found
        if status == SOLVED:
            return status, kkt_error
        w = A @ guess + b
        new = np.hypot(w[n::2], w[n + 1 :: 2])
        slip = new if turn < turns // 3 else 0.5 * (slip + new)
    return MAX_ITERATIONS, kkt_error
