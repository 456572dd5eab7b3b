"""Plain NumPy optimality conditions of the solvers' problems, order [n.., t1 t2 ..]; a solution is what meets them."""

from __future__ import annotations

import numpy as np

from tossid.physics.solvers.problem import Array

ACCEPTED_KKT_ERROR = 1e-8
"""KKT error [m/s] of a solved problem, where it is computed another way than the kernels do."""


def contact_scale(A: Array) -> Array:
    """a_i = trace(A_ii) / 3 [1/kg] of each contact, at least 1e-12 of the largest."""
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
    """Nearest point of the cone |x_t| <= mu x_n, Euclidean."""
    normal, tangent = x[..., 0], np.hypot(x[..., 1], x[..., 2])
    surface = np.maximum((normal + mu * tangent) / (1 + mu * mu), 0.0)
    inside = (normal >= 0) & (tangent <= mu * normal)
    part = mu * surface / np.where(inside | (tangent == 0), 1.0, tangent)
    on_surface = np.stack([surface, part * x[..., 1], part * x[..., 2]], axis=-1)
    return np.where(inside[..., None], x, on_surface)


def cone_qp_kkt_error(A: Array, c: Array, mu: Array, lam: Array) -> Array:
    """The cone programme's natural map: the largest a_i |lam_i - P_i(lam_i - g_i / a_i)|, g = A lam + c.

    P_i is the projection on contact i's cone.
    """
    g, scale, impulse = by_contact(_velocity(A, c, lam)), contact_scale(A)[..., None], by_contact(lam)
    step = scale * (impulse - project_cone(impulse - g / scale, mu))
    return np.linalg.norm(step, axis=-1).max(axis=-1, initial=0.0)


def cone_kkt_error(A: Array, b: Array, mu: Array, lam: Array) -> Array:
    """The exact cone's natural map.

    The largest over contacts of |a lam_n - max(0, a lam_n - w_n)| and a |lam_t - P(lam_t - w_t / a)|, w = A lam + b,
    with P the projection on the disk of radius mu max(lam_n, 0).
    """
    w, scale, impulse = by_contact(_velocity(A, b, lam)), contact_scale(A), by_contact(lam)
    reach = scale[..., None] * impulse[..., 1:] - w[..., 1:]
    radius, length = mu * scale * np.maximum(impulse[..., 0], 0.0), np.linalg.norm(reach, axis=-1)
    part = np.where(length > radius, radius / np.where(length > 0, length, 1.0), 1.0)
    tangent = np.linalg.norm(scale[..., None] * impulse[..., 1:] - part[..., None] * reach, axis=-1)
    normal = np.abs(np.minimum(scale * impulse[..., 0], w[..., 0]))
    return np.maximum(normal, tangent).max(axis=-1, initial=0.0)


def polyhedral_kkt_error(A: Array, b: Array, mu: Array, lam: Array, n_directions: int) -> Array:
    """How far impulses are from the polyhedral cone's law, by maximum dissipation over the polygon.

    The largest over contacts of |min(a lam_n, w_n)|, of how far lam_t is out of the polygon whose corners are
    mu lam_n d_j, and of what dissipation lacks of its maximum there, mu lam_n max_j (-d_j . w_t), over the impulse.
    """
    w, scale, impulse = by_contact(_velocity(A, b, lam)), contact_scale(A), by_contact(lam)
    corners, half = tangent_directions(n_directions), np.pi / n_directions
    turn = np.array([[np.cos(half), np.sin(half)], [-np.sin(half), np.cos(half)]])
    radius = mu * np.maximum(impulse[..., 0], 0.0)
    out = (impulse[..., 1:] @ (corners @ turn).T).max(axis=-1) / np.cos(half) - radius
    most = radius * np.maximum((-w[..., 1:] @ corners.T).max(axis=-1), 0.0)
    lacks = (most + (impulse[..., 1:] * w[..., 1:]).sum(axis=-1)) / np.maximum(radius, 1e-3 / scale)
    normal = np.abs(np.minimum(scale * impulse[..., 0], w[..., 0]))
    return np.maximum(np.maximum(normal, scale * np.maximum(out, 0.0)), np.abs(lacks)).max(axis=-1, initial=0.0)


def _velocity(A: Array, b: Array, lam: Array) -> Array:
    return np.einsum("...ij,...j->...i", A, lam) + b


def tangent_directions(k: int) -> Array:
    """Unit vectors evenly around the tangent plane, the first along t1."""
    angle = 2 * np.pi * np.arange(k) / k
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def project_cones(x: Array, mu: Array) -> Array:
    """Every contact's part of x (3 n,) projected on its friction cone. (3 n,)."""
    projected = project_cone(by_contact(x), mu)
    return np.concatenate([projected[:, 0], projected[:, 1:].ravel()])
