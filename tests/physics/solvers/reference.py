"""Plain NumPy solvers of the same problems: slow, short, and written another way than the kernels.

Tests compare the kernels with these. They take one problem at a time, order [n.., t1 t2 ..].
"""

from __future__ import annotations

import numpy as np

from tossid.physics.solvers.problem import (
    Array,
    by_contact,
    cone_kkt_error,
    cone_qp_kkt_error,
    project_cone,
    tangent_directions,
)


def project_cones(x: Array, mu: Array) -> Array:
    """Every contact's part of x (3 n,) projected on its friction cone. (3 n,)."""
    projected = project_cone(by_contact(x), mu)
    return np.concatenate([projected[:, 0], projected[:, 1:].ravel()])


def cone_qp_reference(
    A: Array, c: Array, mu: Array, *, tolerance: float = 1e-10, max_iterations: int = 200_000
) -> tuple[Array, float]:
    """min over the friction cones of 1/2 lam^T A lam + c^T lam by accelerated projected gradient.

    Nesterov's method with restart on the gradient (O'Donoghue & Candes 2015).
    Returns lam (3 n,) and the KKT error of `cone_qp_kkt_error`.
    """
    step = 1.0 / max(float(np.linalg.eigvalsh(A)[-1]), 1e-300)
    lam = np.zeros(len(c))
    ahead, momentum = lam.copy(), 1.0
    for iteration in range(max_iterations):
        gradient = A @ ahead + c
        new = project_cones(ahead - step * gradient, mu)
        if gradient @ (new - lam) > 0:
            momentum = 1.0
        following = 0.5 * (1 + np.sqrt(1 + 4 * momentum**2))
        ahead = new + (momentum - 1) / following * (new - lam)
        lam, momentum = new, following
        if iteration % 20 == 0 and cone_qp_kkt_error(A, c, mu, lam) <= tolerance:
            break
    return lam, float(cone_qp_kkt_error(A, c, mu, lam))


def cone_reference(A: Array, b: Array, mu: Array, *, tolerance: float = 1e-9, turns: int = 500) -> tuple[Array, float]:
    """The exact cone with maximum dissipation, as cone programmes with c_n = b_n + mu |w_t| held and renewed.

    (De Saxce & Feng 1998; the iteration of Cadoux 2009.) Returns lam (3 n,) and the KKT error of `cone_kkt_error`.
    """
    n = len(mu)
    slip = np.zeros(n)
    lam, kkt_error = np.zeros(3 * n), np.inf
    for _ in range(turns):
        c = b.copy()
        c[:n] += mu * slip
        lam, _ = cone_qp_reference(A, c, mu, tolerance=0.01 * tolerance)
        kkt_error = float(cone_kkt_error(A, b, mu, lam))
        if kkt_error <= tolerance:
            break
        w = A @ lam + b
        slip = np.hypot(w[n::2], w[n + 1 :: 2])
    return lam, kkt_error


def lcp_matrices(A: Array, b: Array, mu: Array, n_directions: int) -> tuple[Array, Array]:
    """M, q of the polyhedral problem w = M z + q with z = (lam_n (n,), beta (n k,), gamma (n,))."""
    n, k = len(mu), n_directions
    directions = np.kron(np.eye(n), tangent_directions(k))
    spread = np.zeros((3 * n, n + n * k))
    spread[:n, :n] = np.eye(n)
    spread[n:, n:] = directions.T
    E = np.kron(np.eye(n), np.ones((k, 1)))
    size = n * (k + 2)
    M = np.zeros((size, size))
    M[: n + n * k, : n + n * k] = spread.T @ A @ spread
    M[n : n + n * k, n + n * k :] = E
    M[n + n * k :, :n] = np.diag(mu)
    M[n + n * k :, n : n + n * k] = -E.T
    return M, np.concatenate([spread.T @ b, np.zeros(n)])


def lemke_reference(M: Array, q: Array, *, max_pivots: int = 5000) -> Array | None:
    """z of 0 <= z _|_ M z + q >= 0 by Lemke's algorithm with the lexicographic rule; None on a ray.

    The basis matrix is inverted afresh at every pivot.
    """
    size = len(q)
    if (q >= 0).all():
        return np.zeros(size)
    columns = np.hstack([np.eye(size), -M, -np.ones((size, 1))])
    basis = list(range(size))
    enter, row = 2 * size, int(np.argmin(q))
    for _ in range(max_pivots):
        left, basis[row] = basis[row], enter
        if left == 2 * size:
            values = np.linalg.solve(columns[:, basis], q)
            z = np.zeros(2 * size + 1)
            z[basis] = values
            return z[size : 2 * size]
        enter = left + size if left < size else left - size
        inverse = np.linalg.inv(columns[:, basis])
        direction = inverse @ columns[:, enter]
        table = np.column_stack([np.maximum(inverse @ q, 0.0), inverse])
        rows = np.flatnonzero(direction > 1e-10)
        if len(rows) == 0:
            return None
        for column in range(size + 1):
            ratio = table[rows, column] / direction[rows]
            rows = rows[ratio <= ratio.min() + 1e-11 * (1 + abs(ratio.min()))]
            artificial = [r for r in rows if basis[r] == 2 * size]
            if artificial:
                rows = np.array(artificial)
            if len(rows) == 1:
                break
        row = int(rows[0])
    return None
