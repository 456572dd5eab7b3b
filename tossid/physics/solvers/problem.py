"""What a contact problem is, how its answer is judged, and how it can fail (NumPy, plain).

One time step with n contacts has the impulses lam (3 n,) [N s] in the order

    lam = [n_1 .. n_n, t1_1, t2_1, t1_2, t2_2, ..]

and the contact velocities after the step w = A lam + b [m/s], with the Delassus
matrix A = J M^-1 J^T (3 n, 3 n) [1/kg], symmetric and positive semi-definite, and
b_n = phi / dt + J_n v_free, b_t = J_t v_free.

Exact cone (maximum dissipation, Moreau 1988; Stewart & Trinkle 1996):

    0 <= lam_n  _|_  w_n >= 0,    lam_t = argmin over |lam_t| <= mu lam_n of lam_t . w_t

Cone programme (the inner problem of the ContactNets loss, Pfrommer et al. 2020):

    min over lam_n >= 0, |lam_t| <= mu lam_n of  1/2 lam^T A lam + c^T lam

Residuals are natural maps, zero exactly at a solution. Impulses are weighed with
a_i = trace(A_ii) / 3 of the contact's own block, so that every residual is a velocity
[m/s] (or the unit of c) and a problem scaled in mass keeps its residual.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError

Array = NDArray[np.float64]

DEFAULT_TOLERANCE = 1e-9
ACCEPTED_RESIDUAL = 1e-8


class SolverStatus(IntEnum):
    """How a contact problem ended. Anything but SOLVED is counted and reported by the caller."""

    SOLVED = 0
    """The residual is at or below the tolerance."""

    MAX_ITERATIONS = 1
    """The iteration limit came first: raise it, or look for contacts that exclude each other."""

    INFEASIBLE = 2
    """No impulse keeps the contacts apart, or the programme has no minimum (a ray termination)."""

    NOT_FINITE = 3
    """The problem holds NaN or infinity; the impulses are returned as zero."""


class ContactSolution(NamedTuple):
    """Solved contact problems; `status` holds `SolverStatus` values.

    lam (B, 3 n) [N s], status (B,) uint8, residual (B,) [m/s], iterations (B,) int64.
    """

    lam: Array
    status: NDArray[np.uint8]
    residual: Array
    iterations: NDArray[np.int64]

    @property
    def unsolved(self) -> int:
        """How many problems of the batch met no tolerance."""
        return int(np.count_nonzero(self.status != SolverStatus.SOLVED))


def contact_rows(i: int, n: int) -> list[int]:
    """Rows of contact i of n in the order of `lam`: normal, first and second tangent."""
    return [i, n + 2 * i, n + 2 * i + 1]


def contact_scale(A: Array) -> Array:
    """a_i = trace(A_ii) / 3 [1/kg] of each contact. A: (3 n, 3 n) -> (n,), at least 1e-12 of the largest."""
    n = len(A) // 3
    scale = np.array([sum(A[k, k] for k in contact_rows(i, n)) / 3 for i in range(n)])
    floor = 1e-12 * scale.max(initial=0.0)
    return np.maximum(scale, floor if floor > 0 else 1.0)


def project_cone(x: Array, mu: float) -> Array:
    """Nearest point of the cone |x_t| <= mu x_n to x = (x_n, x_t1, x_t2), Euclidean."""
    normal, tangent = x[0], float(np.hypot(x[1], x[2]))
    if normal >= 0 and tangent <= mu * normal:
        return x.copy()
    if normal + mu * tangent <= 0 or tangent == 0:
        return np.array([max(normal, 0.0), 0.0, 0.0])
    s = (normal + mu * tangent) / (1 + mu * mu)
    return np.array([s, mu * s * x[1] / tangent, mu * s * x[2] / tangent])


def cone_qp_residual(A: Array, c: Array, mu: Array, lam: Array) -> float:
    """max_i a_i |lam_i - P_i(lam_i - g_i / a_i)|, g = A lam + c, P_i the projection on contact i's cone."""
    n = len(mu)
    g, scale = A @ lam + c, contact_scale(A)
    worst = 0.0
    for i in range(n):
        rows = contact_rows(i, n)
        step = lam[rows] - project_cone(lam[rows] - g[rows] / scale[i], float(mu[i]))
        worst = max(worst, float(scale[i] * np.linalg.norm(step)))
    return worst


def cone_residual(A: Array, b: Array, mu: Array, lam: Array) -> float:
    """The exact cone's natural map [m/s]: the largest over contacts of

    |a lam_n - max(0, a lam_n - w_n)| and a |lam_t - P(lam_t - w_t / a)|,
    P the projection on the disk of radius mu max(lam_n, 0).
    """
    n = len(mu)
    w, scale = A @ lam + b, contact_scale(A)
    worst = 0.0
    for i in range(n):
        rows = contact_rows(i, n)
        normal, tangent = lam[rows[0]], lam[rows[1:]]
        reach = tangent - w[rows[1:]] / scale[i]
        radius, length = mu[i] * max(normal, 0.0), float(np.linalg.norm(reach))
        if length > radius:
            reach = reach * (radius / length)
        worst = max(worst, abs(min(scale[i] * normal, w[rows[0]])), scale[i] * float(np.linalg.norm(tangent - reach)))
    return worst


def tangent_directions(k: int) -> Array:
    """k unit vectors evenly around the tangent plane, the first along t1. (k, 2).

    Raises:
        InputError: k is odd or below 4.
    """
    if k < 4 or k % 2:
        raise InputError(f"{k} friction directions; expected an even number of at least 4")
    angle = 2 * np.pi * np.arange(k) / k
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def lcp_residual(A: Array, b: Array, mu: Array, beta: Array, gamma: Array, lam_n: Array) -> float:
    """The polyhedral problem's complementarity residual [m/s]: the largest over contacts and directions of

    |min(a lam_n, w_n)|, |min(a beta_j, d_j . w_t + gamma)| and |min(gamma, a (mu lam_n - sum beta))|.

    Args:
        A (3 n, 3 n), b (3 n,), mu (n,), beta (n, k), gamma (n,), lam_n (n,).
    """
    n, k = beta.shape
    directions = tangent_directions(k)
    lam = np.concatenate([lam_n, (beta @ directions).ravel()])
    w, scale = A @ lam + b, contact_scale(A)
    speed = w[n:].reshape(n, 2) @ directions.T + gamma[:, None]
    normal = np.minimum(scale * lam_n, w[:n])
    tangent = np.minimum(scale[:, None] * beta, speed)
    cone = np.minimum(gamma, scale * (mu * lam_n - beta.sum(axis=1)))
    return float(max(np.abs(normal).max(initial=0), np.abs(tangent).max(initial=0), np.abs(cone).max(initial=0)))
