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

KKT errors are natural maps, zero exactly at a solution. Impulses are weighed with
a_i = trace(A_ii) / 3 of the contact's own block, so that every KKT error is a velocity
[m/s] (or the unit of c) and a problem scaled in mass keeps its KKT error.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError

Array = NDArray[np.float64]

DEFAULT_TOLERANCE = 1e-9
"""KKT error [m/s] at which the cone solvers stop."""
ACCEPTED_KKT_ERROR = 1e-8
"""KKT error [m/s] at which the polyhedral solver stops: its impulses are sums over directions."""


class SolverStatus(IntEnum):
    """How a contact problem ended. Anything but SOLVED is counted and reported by the caller."""

    SOLVED = 0
    """The KKT error is at or below the tolerance."""

    MAX_ITERATIONS = 1
    """The iteration limit came first: raise it, or look for contacts that exclude each other."""

    INFEASIBLE = 2
    """No impulse keeps the contacts apart, or the programme has no minimum (a ray termination)."""

    NOT_FINITE = 3
    """The problem holds NaN or infinity; the impulses are returned as zero."""

    INACCURATE = 4
    """The method came to its end, but rounding keeps the KKT error above the tolerance."""


class ContactSolution(NamedTuple):
    """Solved contact problems.

    Attributes:
        lam: (B, 3 n) impulses [N s].
        status: (B,) `SolverStatus` values.
        kkt_error: (B,) [m/s].
        iterations: (B,) of the quick solver.
    """

    lam: Array
    status: NDArray[np.uint8]
    kkt_error: Array
    iterations: NDArray[np.int64]

    @property
    def unsolved(self) -> int:
        """How many problems of the batch met no tolerance."""
        return int(np.count_nonzero(self.status != SolverStatus.SOLVED))


def empty_solution(lam: Array) -> ContactSolution:
    """A solution to be filled in, of impulses lam (B, 3 n), which are taken as they are."""
    count = len(lam)
    return ContactSolution(lam, np.empty(count, dtype=np.uint8), np.empty(count), np.empty(count, dtype=np.int64))


def contact_rows(i: int, n: int) -> list[int]:
    """Rows of contact i of n in the order of `lam`: normal, first and second tangent."""
    return [i, n + 2 * i, n + 2 * i + 1]


def contact_scale(A: Array) -> Array:
    """a_i = trace(A_ii) / 3 [1/kg] of each contact, at least 1e-12 of the largest.

    Args:
        A: (*b, 3 n, 3 n).

    Returns:
        (*b, n).
    """
    diagonal = np.diagonal(A, axis1=-2, axis2=-1)
    n = diagonal.shape[-1] // 3
    scale = (diagonal[..., :n] + diagonal[..., n::2] + diagonal[..., n + 1 :: 2]) / 3
    floor = 1e-12 * scale.max(axis=-1, keepdims=True, initial=0.0)
    return np.maximum(scale, np.where(floor > 0, floor, 1.0))


def by_contact(x: Array) -> Array:
    """(*b, 3 n) in the order [n.., t1 t2 ..] -> (*b, n, 3)."""
    n = x.shape[-1] // 3
    return np.stack([x[..., :n], x[..., n::2], x[..., n + 1 :: 2]], axis=-1)


def project_cone(x: Array, mu: Array) -> Array:
    """Nearest point of the cone |x_t| <= mu x_n, Euclidean.

    Args:
        x: (*b, 3) normal first.
        mu: (*b) at least 0.

    Returns:
        (*b, 3).
    """
    normal, tangent = x[..., 0], np.hypot(x[..., 1], x[..., 2])
    surface = np.maximum((normal + mu * tangent) / (1 + mu * mu), 0.0)
    inside = (normal >= 0) & (tangent <= mu * normal)
    part = mu * surface / np.where(tangent > 0, tangent, 1.0)
    on_surface = np.stack([surface, part * x[..., 1], part * x[..., 2]], axis=-1)
    return np.where(inside[..., None], x, on_surface)


def cone_qp_kkt_error(A: Array, c: Array, mu: Array, lam: Array) -> Array:
    """The cone programme's natural map: the largest a_i |lam_i - P_i(lam_i - g_i / a_i)|, g = A lam + c.

    P_i is the projection on contact i's cone.

    Args:
        A: (*b, 3 n, 3 n).
        c: (*b, 3 n).
        mu: (*b, n).
        lam: (*b, 3 n).

    Returns:
        (*b) in the unit of c.
    """
    g, scale, impulse = by_contact(_velocity(A, c, lam)), contact_scale(A)[..., None], by_contact(lam)
    step = scale * (impulse - project_cone(impulse - g / scale, mu))
    return np.linalg.norm(step, axis=-1).max(axis=-1, initial=0.0)


def cone_kkt_error(A: Array, b: Array, mu: Array, lam: Array) -> Array:
    """The exact cone's natural map.

    The largest over contacts of |a lam_n - max(0, a lam_n - w_n)| and a |lam_t - P(lam_t - w_t / a)|, w = A lam + b,
    with P the projection on the disk of radius mu max(lam_n, 0).

    Args:
        A: (*b, 3 n, 3 n) [1/kg].
        b: (*b, 3 n) [m/s].
        mu: (*b, n).
        lam: (*b, 3 n) [N s].

    Returns:
        (*b) [m/s].
    """
    w, scale, impulse = by_contact(_velocity(A, b, lam)), contact_scale(A), by_contact(lam)
    reach = scale[..., None] * impulse[..., 1:] - w[..., 1:]
    radius, length = mu * scale * np.maximum(impulse[..., 0], 0.0), np.linalg.norm(reach, axis=-1)
    part = np.where(length > radius, radius / np.where(length > 0, length, 1.0), 1.0)
    tangent = np.linalg.norm(scale[..., None] * impulse[..., 1:] - part[..., None] * reach, axis=-1)
    normal = np.abs(np.minimum(scale * impulse[..., 0], w[..., 0]))
    return np.maximum(normal, tangent).max(axis=-1, initial=0.0)


def lcp_kkt_error(A: Array, b: Array, mu: Array, beta: Array, gamma: Array, lam_n: Array) -> Array:
    """The polyhedral problem's complementarity error.

    The largest over contacts and directions of |min(a lam_n, w_n)|, |min(a beta_j, d_j . w_t + gamma)| and
    |min(gamma, a (mu lam_n - sum beta))|, w = A lam + b.

    Args:
        A: (*b, 3 n, 3 n) [1/kg].
        b: (*b, 3 n) [m/s].
        mu: (*b, n).
        beta: (*b, n, k) [N s].
        gamma: (*b, n) [m/s].
        lam_n: (*b, n) [N s].

    Returns:
        (*b) [m/s].
    """
    directions = tangent_directions(beta.shape[-1])
    tangent = beta @ directions
    lam = np.concatenate([lam_n, tangent.reshape(*tangent.shape[:-2], -1)], axis=-1)
    w, scale = by_contact(_velocity(A, b, lam)), contact_scale(A)
    slip = np.abs(np.minimum(scale[..., None] * beta, w[..., 1:] @ directions.T + gamma[..., None])).max(axis=-1)
    normal = np.abs(np.minimum(scale * lam_n, w[..., 0]))
    cone = np.abs(np.minimum(gamma, scale * (mu * lam_n - beta.sum(axis=-1))))
    return np.maximum(np.maximum(normal, slip), cone).max(axis=-1, initial=0.0)


def _velocity(A: Array, b: Array, lam: Array) -> Array:
    return np.einsum("...ij,...j->...i", A, lam) + b


def tangent_directions(k: int) -> Array:
    """Unit vectors evenly around the tangent plane, the first along t1.

    Args:
        k: how many.

    Returns:
        (k, 2).

    Raises:
        InputError: k is odd or below 4.
    """
    if k < 4 or k % 2:
        raise InputError(f"{k} friction directions; expected an even number of at least 4")
    angle = 2 * np.pi * np.arange(k) / k
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)
