"""One contact solved exactly, and small dense factorisations: the innermost kernels.

Scalars go in and out of the block kernels, so that nothing is allocated.
"""

from __future__ import annotations

import math

from tossid.kernels import fused_lean_kernel

OPEN, STICK, SLIP = 0, 1, 2
"""State of a contact."""
MAX_TURNS = 30
"""Newton steps of a slip direction's angle."""
GOOD_PIVOT = 1e-3
"""Share of the largest diagonal entry above which a pivot is taken without a search."""
MAX_DESCENTS = 10
"""Times that `block_qp` leaves a place on the cone's surface that is lowest on the surface only."""
START_ANGLES = 16
"""Directions that the search for a slip direction starts from where the first fails."""


@fused_lean_kernel
def solve_3x3(A, i, g0, g1, g2):  # type: ignore[no-untyped-def]
    """x = -A_ii^-1 g of the 3x3 diagonal block at row i (LDL^T, pivots floored at 1e-14 of the trace)."""
    b00, b10, b20 = A[i, i], A[i + 1, i], A[i + 2, i]
    b11, b21, b22 = A[i + 1, i + 1], A[i + 2, i + 1], A[i + 2, i + 2]
    floor = 1e-14 * (b00 + b11 + b22) + 1e-300
    d0 = max(b00, floor)
    l10, l20 = b10 / d0, b20 / d0
    d1 = max(b11 - l10 * b10, floor)
    l21 = (b21 - l20 * b10) / d1
    d2 = max(b22 - l20 * b20 - l21 * l21 * d1, floor)
    y1 = g1 - l10 * g0
    y2 = g2 - l20 * g0 - l21 * y1
    x2 = -y2 / d2
    x1 = -y1 / d1 - l21 * x2
    return -g0 / d0 - l10 * x1 - l20 * x2, x1, x2


@fused_lean_kernel
def cone_exit(y0, y1, y2, d0, d1, d2, mu):  # type: ignore[no-untyped-def]
    """The largest p <= 1 for which y + p d is inside the cone |y_t| <= mu y_n, which y is in.

    The root of |y_t + p d_t|² = mu² (y_n + p d_n)².
    """
    part = 1.0
    if y0 + d0 < 0.0:
        part = y0 / -d0
    squared = mu * mu
    a = d1 * d1 + d2 * d2 - squared * d0 * d0
    b = y1 * d1 + y2 * d2 - squared * y0 * d0
    c = min(y1 * y1 + y2 * y2 - squared * y0 * y0, 0.0)
    if a * part * part + 2.0 * b * part + c > 0.0:
        root = b + math.sqrt(max(b * b - a * c, 0.0))
        if root > 0.0:
            part = min(part, -c / root)
    return part


@fused_lean_kernel
def block_qp(A, i, g0, g1, g2, mu, u1, u2):  # type: ignore[no-untyped-def]
    """Minimise 1/2 x^T A_ii x + g^T x over the cone |x_t| <= mu x_n. Returns (kind, x_n, x_t1, x_t2).

    On the cone's surface x = s d, d = (1, mu u): s = -g.d / d.B d, and the angle of u is
    found by Newton's method on the angular derivative, from the direction (u1, u2),
    with a decrease of the objective asked of every turn.
    """
    if g0 >= mu * math.sqrt(g1 * g1 + g2 * g2):
        return OPEN, 0.0, 0.0, 0.0
    b00 = A[i, i]
    if mu == 0.0:
        return SLIP, -g0 / max(b00, 1e-300), 0.0, 0.0
    x0, x1, x2 = solve_3x3(A, i, g0, g1, g2)
    if x0 > 0.0 and x1 * x1 + x2 * x2 <= mu * mu * x0 * x0:
        return STICK, x0, x1, x2
    b10, b20 = A[i + 1, i], A[i + 2, i]
    b11, b21, b22 = A[i + 1, i + 1], A[i + 2, i + 1], A[i + 2, i + 2]
    length = math.sqrt(u1 * u1 + u2 * u2)
    if length > 0.0:
        u1, u2 = u1 / length, u2 / length
    if length == 0.0 or g0 + mu * (u1 * g1 + u2 * g2) >= 0.0:
        length = math.sqrt(g1 * g1 + g2 * g2)
        if length == 0.0:
            length = math.sqrt(x1 * x1 + x2 * x2)
            u1, u2 = x1 / length, x2 / length
        else:
            u1, u2 = -g1 / length, -g2 / length
    s = 0.0
    for _ in range(MAX_DESCENTS):
        s, u1, u2, outward = slide_angle(b00, b10, b20, b11, b21, b22, g0, g1, g2, mu, u1, u2)
        if outward >= -1e-12 * (abs(g0) + abs(g1) + abs(g2)):
            break
        # Lowest on the surface only: one gradient step into the cone, then on towards the free
        # minimum x, which lies outside, to another and lower place on the surface.
        step = 1.0 / (b00 + b11 + b22)
        y0, y1, y2 = s, s * mu * u1, s * mu * u2
        d0 = -step * (g0 + b00 * y0 + b10 * y1 + b20 * y2)
        d1 = -step * (g1 + b10 * y0 + b11 * y1 + b21 * y2)
        d2 = -step * (g2 + b20 * y0 + b21 * y1 + b22 * y2)
        part = cone_exit(y0, y1, y2, d0, d1, d2, mu)
        y0, y1, y2 = y0 + part * d0, y1 + part * d1, y2 + part * d2
        if part == 1.0:
            part = cone_exit(y0, y1, y2, x0 - y0, x1 - y1, x2 - y2, mu)
            y1, y2 = y1 + part * (x1 - y1), y2 + part * (x2 - y2)
        length = math.sqrt(y1 * y1 + y2 * y2)
        if length > 0.0:
            u1, u2 = y1 / length, y2 / length
    return SLIP, s, s * mu * u1, s * mu * u2


@fused_lean_kernel
def slide_angle(b00, b10, b20, b11, b21, b22, g0, g1, g2, mu, u1, u2):  # type: ignore[no-untyped-def]
    """A minimum of 1/2 x^T B x + g^T x over the cone's surface x = s (1, mu u), from the direction u.

    Returns (s, u1, u2, outward): outward = -u . w_t is negative if the inside of the cone is lower still.
    """
    best = math.inf
    s, outward = 0.0, 0.0
    v1, v2, turn = u1, u2, 0.0
    for _ in range(MAX_TURNS):
        bd0 = b00 + mu * (b10 * v1 + b20 * v2)
        bd1 = b10 + mu * (b11 * v1 + b21 * v2)
        bd2 = b20 + mu * (b21 * v1 + b22 * v2)
        q = bd0 + mu * (v1 * bd1 + v2 * bd2)
        h = g0 + mu * (v1 * g1 + v2 * g2)
        value = -0.5 * h * h / q
        if h >= 0.0 or value > best + 1e-15 * abs(best):
            turn *= 0.25
            if abs(turn) < 1e-12:
                break
        else:
            best = min(best, value)
            u1, u2, s = v1, v2, -h / q
            w1, w2 = g1 + s * bd1, g2 + s * bd2
            outward = -(u1 * w1 + u2 * w2)
            slope = u1 * w2 - u2 * w1
            cross = u1 * bd2 - u2 * bd1
            ebe = u2 * u2 * b11 - 2.0 * u1 * u2 * b21 + u1 * u1 * b22
            curve = max(outward, 0.0) + s * mu * max(ebe - cross * cross / q, 0.0)
            if abs(slope) <= 1e-15 * (abs(w1) + abs(w2) + s * ebe):
                break
            turn = -slope / max(curve, 1e-3 * s * mu * ebe)
            turn = min(max(turn, -1.0), 1.0)
            if abs(turn) < 1e-14:
                break
        scale = 1.0 / math.sqrt(1.0 + turn * turn)
        v1, v2 = scale * (u1 - turn * u2), scale * (u2 + turn * u1)
    return s, u1, u2, outward


@fused_lean_kernel
def cholesky_solve(V, top, m, x):  # type: ignore[no-untyped-def]
    """Solve H y = V[x] in place by Cholesky; H is the upper triangle of the m rows from V[top], overwritten.

    A pivot that vanishes against its own diagonal (a redundant direction) is given weight, so that a
    singular, consistent system yields a solution: the redundant unknown stays put.
    """
    for j in range(m):
        own = V[top + j, j]
        for k in range(j):
            factor = V[top + k, j]
            for i in range(j, m):
                V[top + j, i] -= V[top + k, i] * factor
            V[x, j] -= factor * V[x, k]
        pivot = V[top + j, j]
        if not pivot > 1e-11 * own:
            pivot = 1e6 * own + 1e-300
        inverse = 1.0 / math.sqrt(pivot)
        V[top + j, j] = inverse
        for i in range(j + 1, m):
            V[top + j, i] *= inverse
        V[x, j] *= inverse
    for j in range(m - 1, -1, -1):
        value = V[x, j]
        for k in range(j + 1, m):
            value -= V[top + j, k] * V[x, k]
        V[x, j] = value * V[top + j, j]


@fused_lean_kernel
def lu_solve(V, top, m, x):  # type: ignore[no-untyped-def]
    """Solve H y = V[x] in place by elimination, rows exchanged where needed; H is the m rows from V[top], overwritten.

    A column without a pivot (below 1e-13 of the largest diagonal entry) leaves its unknown at zero.
    """
    largest = 0.0
    for j in range(m):
        largest = max(largest, abs(V[top + j, j]))
    for j in range(m):
        if not V[top + j, j] > GOOD_PIVOT * largest:
            best, found = abs(V[top + j, j]), j
            for i in range(j + 1, m):
                if abs(V[top + i, j]) > best:
                    best, found = abs(V[top + i, j]), i
            if found != j:
                for k in range(j, m):
                    V[top + j, k], V[top + found, k] = V[top + found, k], V[top + j, k]
                V[x, j], V[x, found] = V[x, found], V[x, j]
            if best <= 1e-13 * largest:
                V[top + j, j] = 0.0
                continue
        inverse = 1.0 / V[top + j, j]
        V[top + j, j] = inverse
        for i in range(j + 1, m):
            factor = V[top + i, j] * inverse
            if factor != 0.0:
                for k in range(j + 1, m):
                    V[top + i, k] -= factor * V[top + j, k]
                V[x, i] -= factor * V[x, j]
    for j in range(m - 1, -1, -1):
        value = V[x, j]
        for k in range(j + 1, m):
            value -= V[top + j, k] * V[x, k]
        V[x, j] = value * V[top + j, j]


@fused_lean_kernel
def block_cone(A, i, g0, g1, g2, mu, u1, u2):  # type: ignore[no-untyped-def]
    """One contact with maximum dissipation: w = A_ii x + g, 0 <= x_n _|_ w_n >= 0, x_t against w_t in the disk.

    Returns (kind, x_n, x_t1, x_t2). Slipping, x = s (1, mu u) with s = -g_n / (A_nn + mu A_nt.u), and
    the angle of u, which must oppose w_t, is the root of u x w_t: Newton's method from the direction
    (u1, u2) or, without one, against the velocity of the frictionless contact.
    """
    if g0 >= 0.0:
        return OPEN, 0.0, 0.0, 0.0
    b00 = max(A[i, i], 1e-300)
    if mu == 0.0:
        return SLIP, -g0 / b00, 0.0, 0.0
    x0, x1, x2 = solve_3x3(A, i, g0, g1, g2)
    if x0 > 0.0 and x1 * x1 + x2 * x2 <= mu * mu * x0 * x0:
        return STICK, x0, x1, x2
    b10, b20 = A[i + 1, i], A[i + 2, i]
    b11, b21, b22 = A[i + 1, i + 1], A[i + 2, i + 1], A[i + 2, i + 2]
    v1, v2 = g1 - b10 * g0 / b00, g2 - b20 * g0 / b00
    length = math.sqrt(u1 * u1 + u2 * u2)
    if length > 0.0:
        u1, u2 = u1 / length, u2 / length
    else:
        length = math.sqrt(v1 * v1 + v2 * v2)
        if length == 0.0:
            return SLIP, -g0 / b00, 0.0, 0.0
        u1, u2 = -v1 / length, -v2 / length
    s, u1, u2, solved = slip_angle(b00, b10, b20, b11, b21, b22, g0, g1, g2, mu, u1, u2)
    if not solved:
        for k in range(START_ANGLES):
            angle = 2.0 * math.pi * k / START_ANGLES
            v1, v2 = math.cos(angle), math.sin(angle)
            t, v1, v2, solved = slip_angle(b00, b10, b20, b11, b21, b22, g0, g1, g2, mu, v1, v2)
            if solved:
                s, u1, u2 = t, v1, v2
                break
    return SLIP, s, s * mu * u1, s * mu * u2


@fused_lean_kernel
def slip_angle(b00, b10, b20, b11, b21, b22, g0, g1, g2, mu, u1, u2):  # type: ignore[no-untyped-def]
    """The slip direction u of `block_cone`, from a guess. Returns (s, u1, u2, solved)."""
    s = 0.0
    for _ in range(MAX_TURNS):
        down = b00 + mu * (b10 * u1 + b20 * u2)
        if down <= 0.0:
            return 0.0, u1, u2, False
        s = -g0 / down
        p1, p2 = b10 + mu * (b11 * u1 + b21 * u2), b20 + mu * (b21 * u1 + b22 * u2)
        w1, w2 = g1 + s * p1, g2 + s * p2
        outward = -(u1 * w1 + u2 * w2)
        slope = u1 * w2 - u2 * w1
        size = abs(g1) + abs(g2) + s * (abs(p1) + abs(p2))
        if abs(slope) <= 1e-14 * size and outward >= -1e-14 * size:
            return s, u1, u2, True
        ds = -s * mu * (u1 * b20 - u2 * b10) / down
        ebe = u2 * u2 * b11 - 2.0 * u1 * u2 * b21 + u1 * u1 * b22
        curve = outward + ds * (u1 * p2 - u2 * p1) + s * mu * ebe
        if curve > 0.0 and abs(slope) < curve:
            turn = -slope / curve
        else:
            turn = math.copysign(0.7, -slope)
        if abs(turn) < 1e-15 and outward >= 0.0:
            return s, u1, u2, True
        scale = 1.0 / math.sqrt(1.0 + turn * turn)
        u1, u2 = scale * (u1 - turn * u2), scale * (u2 + turn * u1)
    return s, u1, u2, False
