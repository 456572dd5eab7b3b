"""Interior-point method for the cone programme: the way out where the quick moves of `cone_qp` stall.

Primal-dual path following with Nesterov-Todd scaling and Mehrotra's predictor-corrector
(Nesterov & Todd 1997; Andersen, Dahl & Vandenberghe 2003) on

    A x + c = z,   x in K,   z in K,   x o z = 0

with K a product of second-order cones, y = (mu x_n, x_t), or half lines where mu = 0. It needs
ten to twenty factorisations whatever the conditioning of A, and takes no warm start.
"""

from __future__ import annotations

import math

import numpy as np

from tossid.kernels import fused_kernel
from tossid.physics.solvers.blocks import cholesky_solve
from tossid.physics.solvers.problem import Array, contact_rows

MAX_STEPS = 60
"""Newton steps, at most."""
FRACTION_TO_BOUNDARY = 0.99
"""Share of the way to the cones' surface that a step may go."""


def interior_start(A: Array, c: Array, mu: Array) -> Array:
    """The interior-point method's answer to one cone programme, as a warm start.

    Args:
        A: (3 n, 3 n).
        c: (3 n,).
        mu: (n,).

    Returns:
        (3 n,); zero if the method fails.
    """
    n = len(mu)
    rows = np.array([contact_rows(i, n) for i in range(n)], dtype=int).ravel()
    answer, lam = np.zeros(3 * n), np.zeros(3 * n)
    interior_point(np.ascontiguousarray(A[np.ix_(rows, rows)]), c[rows], mu, n, answer)
    if np.isfinite(answer).all():
        lam[rows] = answer
    return lam


@fused_kernel
def interior_point(A, c, mu, m, lam):  # type: ignore[no-untyped-def]
    r"""Put a nearly optimal, feasible impulse into lam (contact-major, m contacts).

    With W the scaling of `nt_scaling` and r = A x + c - z, each step solves (A + W^-2) dx = rhs and has
    dz = r + A dx. The predictor has rhs = -r - z, the corrector -r + W^-1 (s \ (sigma gap e - s o s - W^-1 dx o W dz)),
    s = W z, sigma = (1 - longest step)^3.

    Returns:
        (duality gap x . z per contact, largest |A x + c - z|), both on the problem's own scale.
    """
    # Unknowns: (mu x_n, x_t) of a contact with friction, x_n of one without; A and c scaled to about 1.
    start = np.empty(m + 1, dtype=np.int64)
    size = 0
    for i in range(m):
        start[i] = size
        size += 3 if mu[i] > 0.0 else 1
    start[m] = size
    origin, weight = np.empty(size, dtype=np.int64), np.ones(size)
    stiffness, load = 1e-300, 1e-300
    for i in range(m):
        for t in range(start[i + 1] - start[i]):
            v = start[i] + t
            origin[v] = 3 * i + t
            if t == 0 and mu[i] > 0.0:
                weight[v] = 1.0 / mu[i]
            load = max(load, abs(c[3 * i + t]) * weight[v])
            stiffness = max(stiffness, A[3 * i + t, 3 * i + t] * weight[v] * weight[v])
    Q, g = np.empty((size, size)), np.empty(size)
    for v in range(size):
        g[v] = c[origin[v]] * weight[v] / load
        for u in range(size):
            Q[v, u] = A[origin[v], origin[u]] * weight[v] * weight[u] / stiffness
    x, z, e = np.zeros(size), np.zeros(size), np.zeros(size)
    for i in range(m):
        x[start[i]], z[start[i]], e[start[i]] = 1.0, 1.0, 1.0
    H = np.empty((size + 1, size))
    scaled, dx, dz, rhs = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    left, right, wbar = np.empty(size), np.empty(size), np.empty(size)
    beta = np.empty(m)
    residual = Q @ x + g - z
    gap = 1.0
    for _ in range(MAX_STEPS):
        nt_scaling(x, z, start, m, wbar, beta)
        apply_scaling(wbar, beta, start, m, z, scaled, False)
        for predicted in range(2):
            if predicted == 0:
                for v in range(size):
                    rhs[v] = -residual[v] - z[v]
            else:
                # second-order term and centring: rhs = -residual + W^-1 (scaled \ (sigma gap e - scaled o scaled - ..))
                apply_scaling(wbar, beta, start, m, dx, left, True)
                apply_scaling(wbar, beta, start, m, dz, right, False)
                part = min(longest_step(x, dx, start, m), longest_step(z, dz, start, m))
                centre = (1.0 - part) ** 3 * gap
                solve_jordan(scaled, left, right, e, centre, start, m)
                apply_scaling(wbar, beta, start, m, left, rhs, True)
                for v in range(size):
                    rhs[v] -= residual[v]
            for v in range(size):
                for u in range(size):
                    H[v, u] = Q[v, u]
            add_inverse_square(wbar, beta, start, m, H)
            for v in range(size):
                H[size, v] = rhs[v]
            cholesky_solve(H, 0, size, size)
            for v in range(size):
                dx[v] = H[size, v]
            for v in range(size):
                dz[v] = residual[v]
                for u in range(size):
                    dz[v] += Q[v, u] * dx[u]
        total = 0.0
        for v in range(size):
            total += abs(dx[v]) + abs(dz[v])
        if not total < math.inf:
            break
        part = min(1.0, FRACTION_TO_BOUNDARY * min(longest_step(x, dx, start, m), longest_step(z, dz, start, m)))
        if part < 1e-10:
            break
        worst, gap = 0.0, 0.0
        for v in range(size):
            x[v] += part * dx[v]
            z[v] += part * dz[v]
        for v in range(size):
            residual[v] = g[v] - z[v]
            for u in range(size):
                residual[v] += Q[v, u] * x[u]
            worst = max(worst, abs(residual[v]))
            gap += x[v] * z[v]
        gap /= m
        if worst < 1e-13 and gap < 1e-15:
            break
    for j in range(3 * m):
        lam[j] = 0.0
    for v in range(size):
        lam[origin[v]] = x[v] * weight[v] * load / stiffness
    return gap, np.abs(residual).max()


@fused_kernel
def nt_scaling(x, z, start, m, wbar, beta):  # type: ignore[no-untyped-def]
    """Scaling point of each cone: W = beta (2 v v^T - J), W^2 = beta^2 (2 wbar wbar^T - J), W z = W^-1 x."""
    for i in range(m):
        k = start[i]
        if start[i + 1] - k == 1:
            wbar[k], beta[i] = 1.0, math.sqrt(x[k] / z[k])
            continue
        reach, push = math.sqrt(x[k + 1] ** 2 + x[k + 2] ** 2), math.sqrt(z[k + 1] ** 2 + z[k + 2] ** 2)
        xx = math.sqrt(max((x[k] - reach) * (x[k] + reach), 1e-16 * x[k] * x[k]))
        zz = math.sqrt(max((z[k] - push) * (z[k] + push), 1e-16 * z[k] * z[k]))
        dot = (x[k] * z[k] + x[k + 1] * z[k + 1] + x[k + 2] * z[k + 2]) / (xx * zz)
        half = 0.5 / math.sqrt(0.5 * (1.0 + dot))
        wbar[k] = half * (x[k] / xx + z[k] / zz)
        wbar[k + 1] = half * (x[k + 1] / xx - z[k + 1] / zz)
        wbar[k + 2] = half * (x[k + 2] / xx - z[k + 2] / zz)
        beta[i] = math.sqrt(xx / zz)


@fused_kernel
def apply_scaling(wbar, beta, start, m, a, out, inverse):  # type: ignore[no-untyped-def]
    """out = W a, or W^-1 a."""
    for i in range(m):
        k = start[i]
        b = 1.0 / beta[i] if inverse else beta[i]
        if start[i + 1] - k == 1:
            out[k] = b * a[k]
            continue
        sign = -1.0 if inverse else 1.0
        norm = 1.0 / math.sqrt(2.0 * (wbar[k] + 1.0))
        v0, v1, v2 = norm * (wbar[k] + 1.0), sign * norm * wbar[k + 1], sign * norm * wbar[k + 2]
        dot = 2.0 * (v0 * a[k] + v1 * a[k + 1] + v2 * a[k + 2])
        out[k], out[k + 1], out[k + 2] = (
            b * (dot * v0 - a[k]),
            b * (dot * v1 + a[k + 1]),
            b * (dot * v2 + a[k + 2]),
        )


@fused_kernel
def add_inverse_square(wbar, beta, start, m, H):  # type: ignore[no-untyped-def]
    """H += W^-2."""
    for i in range(m):
        k = start[i]
        b = 1.0 / (beta[i] * beta[i])
        if start[i + 1] - k == 1:
            H[k, k] += b
            continue
        w0, w1, w2 = wbar[k], -wbar[k + 1], -wbar[k + 2]
        H[k, k] += b * (2.0 * w0 * w0 - 1.0)
        H[k + 1, k + 1] += b * (2.0 * w1 * w1 + 1.0)
        H[k + 2, k + 2] += b * (2.0 * w2 * w2 + 1.0)
        for first, second, value in ((0, 1, w0 * w1), (0, 2, w0 * w2), (1, 2, w1 * w2)):
            H[k + first, k + second] += 2.0 * b * value
            H[k + second, k + first] += 2.0 * b * value


@fused_kernel
def solve_jordan(scaled, left, right, e, centre, start, m):  # type: ignore[no-untyped-def]
    """left = the y with scaled o y = centre e - scaled o scaled - left o right, in each cone's Jordan algebra."""
    for i in range(m):
        k = start[i]
        if start[i + 1] - k == 1:
            left[k] = (centre - scaled[k] * scaled[k] - left[k] * right[k]) / scaled[k]
            continue
        s0, s1, s2 = scaled[k], scaled[k + 1], scaled[k + 2]
        a0, a1, a2 = left[k], left[k + 1], left[k + 2]
        b0, b1, b2 = right[k], right[k + 1], right[k + 2]
        r0 = centre - (s0 * s0 + s1 * s1 + s2 * s2) - (a0 * b0 + a1 * b1 + a2 * b2)
        r1 = -2.0 * s0 * s1 - (a0 * b1 + b0 * a1)
        r2 = -2.0 * s0 * s2 - (a0 * b2 + b0 * a2)
        reach = math.sqrt(s1 * s1 + s2 * s2)
        det = max((s0 - reach) * (s0 + reach), 1e-16 * s0 * s0)
        y0 = (s0 * r0 - s1 * r1 - s2 * r2) / det
        left[k], left[k + 1], left[k + 2] = y0, (r1 - y0 * s1) / s0, (r2 - y0 * s2) / s0


@fused_kernel
def longest_step(x, d, start, m):  # type: ignore[no-untyped-def]
    """The largest part of the step d, at most 1e3, that keeps x in its cones."""
    part = 1e3
    for i in range(m):
        k = start[i]
        if x[k] + part * d[k] < 0.0:
            part = -x[k] / d[k]
        if start[i + 1] - k == 1:
            continue
        a = d[k] ** 2 - d[k + 1] ** 2 - d[k + 2] ** 2
        b = x[k] * d[k] - x[k + 1] * d[k + 1] - x[k + 2] * d[k + 2]
        c = max(x[k] ** 2 - x[k + 1] ** 2 - x[k + 2] ** 2, 0.0)
        if a * part * part + 2.0 * b * part + c < 0.0:
            root = -b + math.sqrt(max(b * b - a * c, 0.0))
            if root > 0.0:
                part = min(part, c / root)
    return part
