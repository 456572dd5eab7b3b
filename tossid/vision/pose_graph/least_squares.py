"""The graph's least squares: normal equations in which time steps meet only in what they share.

Of the unknowns s that steps share and those x_k of each step, the Hessian is an arrow: blocks H_ss, H_ks, H_kk. One
Schur complement over the steps gives both a Gauss-Newton step and the covariances. Where stillness ties each step to
the next one, H_kk is block tridiagonal, and is eliminated from the first step to the last and back (as Rauch, Tung and
Striebel's smoother does).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from tossid.errors import SolverError
from tossid.kernels import kernel
from tossid.least_squares import Damping
from tossid.vision.pose_graph.residuals import Rows

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

LEAST_PIVOT = 1e-13
"""Of a Hessian that is scaled to a unit diagonal, in Cholesky's decomposition: a smaller one counts as zero."""
WEAK_PRIOR = 3.0
"""Standard deviation of the prior that covariances are taken with where a pose is not determined [m, rad]."""
LEVENBERG = Damping(grow=100.0, fall=0.1, least=0.01, vanish=1.0)
"""Gauss-Newton's steps, undamped, until one fails; then λ is 1, 100, …"""
MOST_STEPS = 100
"""Of an optimisation."""
MOST_DAMPING = 1e12
"""λ above which steps are too small to change anything."""


class SingularError(ArithmeticError):
    """The Hessian leaves an unknown undetermined.

    Args:
        column: Of the unknown, as `Rows` counts.
    """

    def __init__(self, column: int) -> None:
        super().__init__(f"column {column} is undetermined")
        self.column = column


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations H δ = -g of n steps, of S columns that they share and d of each step's own.

    Attributes:
        H_ss: (S, S).
        H_ks: (n, d, S).
        H_kk: (n, d, d).
        g_s: (S,).
        g_k: (n, d).
        used: Which of the steps' own columns any residual depends on, (n, d); the others stay as they are.
        H_next: Block of each step and the next one, (n - 1, d, d); None where there is none.
    """

    H_ss: Array
    H_ks: Array
    H_kk: Array
    g_s: Array
    g_k: Array
    used: Bools
    H_next: Array | None = None


def normal_equations(rows: Iterable[Rows], shared: int, n: int, own: int) -> Normal:
    """The normal equations of some residuals.

    Args:
        rows: The residuals.
        shared: Number of columns that steps share.
        n: Number of steps.
        own: Columns of each step.
    """
    H_ss, H_ks, H_kk = np.zeros((shared, shared)), np.zeros((n, own, shared)), np.zeros((n, own, own))
    g_s, g_k, used = np.zeros(shared), np.zeros((n, own)), np.zeros((n, own), dtype=bool)
    for r, J, column, step in rows:
        here = (np.ascontiguousarray(array) for array in (r, J, column, step))
        _accumulate(*here, H_ss, H_ks, H_kk, g_s, g_k)
        at, k = np.nonzero(column >= shared)
        used[step[at], column[at, k] - shared] = True
    return Normal(H_ss, H_ks, H_kk, g_s, g_k, used)


@kernel
def _accumulate(
    r: Array, J: Array, column: Ints, step: Ints, H_ss: Array, H_ks: Array, H_kk: Array, g_s: Array, g_k: Array
) -> None:
    """Add JᵀJ and Jᵀr to the blocks."""
    shared = len(g_s)
    for d in range(len(r)):
        k = step[d]
        for a in range(column.shape[1]):
            i = column[d, a]
            if i < 0:
                continue
            slope = 0.0
            for row in range(r.shape[1]):
                slope += J[d, row, a] * r[d, row]
            if i < shared:
                g_s[i] += slope
            else:
                g_k[k, i - shared] += slope
            for b in range(column.shape[1]):
                j = column[d, b]
                if j < 0 or (i < shared <= j):
                    continue
                product = 0.0
                for row in range(r.shape[1]):
                    product += J[d, row, a] * J[d, row, b]
                if i < shared:
                    H_ss[i, j] += product
                elif j < shared:
                    H_ks[k, i - shared, j] += product
                else:
                    H_kk[k, i - shared, j - shared] += product


@dataclass(frozen=True, eq=False)
class Eliminated:
    """The solution of normal equations, and the covariances that their inverse is.

    Attributes:
        step_s: δ of what steps share, (S,).
        step_k: δ of each step's own, (n, d).
        cov_s: Covariance of what steps share, (S, S).
        cov_k: That of each step's own, (n, d, d).
    """

    step_s: Array
    step_k: Array
    cov_s: Array
    cov_k: Array


def eliminate(normal: Normal, *, damping: Array | float = 0.0) -> Eliminated:
    """Solve (H + λ 1) δ = -g by eliminating the steps.

    Args:
        normal: The equations.
        damping: λ; of steps that share nothing, one of each may be given, (n,).

    Raises:
        SingularError: They leave an unknown undetermined.
    """
    shared, (n, d), damping = len(normal.g_s), normal.g_k.shape, np.reshape(damping, (-1, 1, 1))
    H_kk = normal.H_kk + damping * np.eye(d)
    unused, i = np.nonzero(~normal.used)
    H_kk[unused, i, i] = 1.0
    Z, chain = np.concatenate([normal.H_ks, normal.g_k[..., None]], axis=2), normal.H_next
    if chain is None:
        alone = _inverse(H_kk, shared)
        Z = alone @ Z
    else:
        alone = np.empty_like(H_kk)
        for k in range(n):
            if k:
                gain = chain[k - 1].T @ alone[k - 1]
                H_kk[k] -= gain @ chain[k - 1]
                Z[k] -= gain @ Z[k - 1]
            alone[k] = _inverse(H_kk[k : k + 1], shared)[0]
        Z = alone @ Z
        for k in range(n - 2, -1, -1):
            gain = alone[k] @ chain[k]
            Z[k] -= gain @ Z[k + 1]
            alone[k] += gain @ alone[k + 1] @ gain.T
    X, y = Z[..., :shared], Z[..., shared]
    coupling = normal.H_ks.reshape(n * d, shared).T
    S = normal.H_ss + (damping[0] if shared else 0.0) * np.eye(shared) - coupling @ X.reshape(n * d, shared)
    cov_s = _inverse(0.5 * (S + S.T)[None], 0)[0]
    step_s = -cov_s @ (normal.g_s - coupling @ y.reshape(n * d))
    return Eliminated(step_s, -(y + X @ step_s), cov_s, alone + X @ cov_s @ np.swapaxes(X, 1, 2))


def _inverse(H: Array, first: int) -> Array:
    """The inverses of symmetric matrices (m, d, d), whose columns begin at `first`."""
    if not H.size:
        return H
    scale = np.sqrt(np.maximum(np.diagonal(H, axis1=1, axis2=2), np.finfo(float).tiny))
    scaled = H / (scale[:, :, None] * scale[:, None, :])
    try:
        least = np.diagonal(np.linalg.cholesky(scaled), axis1=1, axis2=2).min() ** 2
    except np.linalg.LinAlgError:
        least = 0.0
    if not least > LEAST_PIVOT:
        eigenvalue, along = np.linalg.eigh(np.nan_to_num(scaled))
        worst = int(np.argmin(eigenvalue[:, 0]))
        raise SingularError(first + int(np.argmax(np.abs(along[worst, :, 0]))))
    inverse = np.linalg.inv(scaled)
    return np.asarray(inverse / (scale[:, :, None] * scale[:, None, :]))


P = TypeVar("P")


class LeastSquares(Protocol[P]):
    """A sum of squares at points of some kind."""

    def error(self, point: P) -> Array:
        """Half of the sum of squares: of each step where steps share nothing, (n,), else of all, (1,)."""

    def normal(self, point: P) -> Normal:
        """Its normal equations."""

    def moved(self, point: P, step_s: Array, step_k: Array) -> P:
        """The point after a step of what steps share (S,) and of each step's own (n, d)."""


def optimise(problem: LeastSquares[P], point: P) -> P:
    """The nearest minimum, by Levenberg's damped Gauss-Newton steps; time steps that share nothing have their own λ.

    Args:
        problem: What is to be minimised.
        point: Where to begin.

    Raises:
        SolverError: An error at the start is not finite, and no step makes it so.
    """
    error = problem.error(point)
    damping, done = np.zeros(len(error)), np.zeros(len(error), dtype=bool)
    for _ in range(MOST_STEPS):
        try:
            found = eliminate(problem.normal(point), damping=damping)
        except SingularError:  # only a damped step exists
            damping = LEVENBERG.each(damping, np.zeros_like(done))
            continue
        moved = problem.moved(point, found.step_s, found.step_k)
        new = problem.error(moved)
        accepted = new <= error
        if accepted.all():
            point = moved
        elif accepted.any():
            point = problem.moved(point, found.step_s, np.where(accepted[:, None], found.step_k, 0.0))
        done |= np.where(accepted, error - new <= 1e-7 + 1e-9 * new, damping > MOST_DAMPING)
        error, damping = np.where(accepted, new, error), LEVENBERG.each(damping, accepted)
        if done.all():
            break
    if not np.isfinite(error).all():
        raise SolverError("the pose graph has no finite error at its first poses")
    return point


def covariances(normal: Normal) -> Eliminated:
    """The covariances of all unknowns; where the equations leave some undetermined, with a weak prior on each.

    Raises:
        SingularError: Even with the prior, some unknown is not determined.
    """
    try:
        return eliminate(normal)
    except SingularError:
        return eliminate(normal, damping=WEAK_PRIOR**-2)
