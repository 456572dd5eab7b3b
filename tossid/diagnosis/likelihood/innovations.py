"""Innovations of windows: kernels that whiten residuals row by row, as a Kalman filter of the first state does.

The covariance of a window's residuals is that of the poses' own errors, plus S P S^T of its first state and of the
other engine's multiple: of 2 K + 1 numbers only. So its Cholesky factor need not be made. After each channel's own
errors are whitened (`Windows.root`), the covariance is 1 + U U^T, with U of 2 K + 1 columns. The entries are taken
one by one in the order of time. Each is predicted from those before it, and divided by its standard deviation. That
is the Cholesky factor applied to the residuals, for a tenth of the work and a third of the memory. The covariance of
the 2 K + 1 numbers is held as a square root (Potter 1963; Bierman, "Factorization Methods for Discrete Sequential
Estimation", 1977).

All arrays are of W windows, of which `index` (n,) has the numbers of those that are asked for.
"""

from __future__ import annotations

import math

import numpy as np

from tossid.kernels import fused_inlined_kernel, fused_kernel

MOST = 1e6
"""Square of a residual beyond which a first state's cost grows no more."""


@fused_kernel
def factorise(index, root, by_state, prior, other, columns, gain, scale, log_det):  # type: ignore[no-untyped-def]
    """The innovations' factors of windows: rows `index` of the last four arguments are written.

    Args:
        index: (n,) windows.
        root: (W, K, L + 1, L + 1) inverse Cholesky factors of each channel's own errors, first pose and rows.
        by_state: (W, K L, 2 K) derivatives of predictions by first states.
        prior: (W, 2 K) standard deviations of first states.
        other: (W, K L) the difference to the other engine.
        columns: (W, K L, 2 K + 1) U.
        gain: (W, K L, 2 K + 1) by which each innovation changes the 2 K + 1 numbers.
        scale: (W, K L) one over each innovation's standard deviation.
        log_det: (W,) of the whole factor.
    """
    K, rows = root.shape[1], root.shape[2] - 1
    R = 2 * K + 1
    A, v = np.empty((R, R)), np.empty(R)
    for w in index:
        total = 0.0
        A[:] = 0.0
        for k in range(R):
            A[k, k] = 1.0
        for row in range(rows):
            for c in range(K):
                i = row * K + c
                u, g = columns[w, i], gain[w, i]
                u[:] = 0.0
                for j in range(row + 1):
                    weight = root[w, c, 1 + row, 1 + j]
                    if weight != 0.0:
                        for k in range(2 * K):
                            u[k] += weight * by_state[w, j * K + c, k]
                        u[2 * K] += weight * other[w, j * K + c]
                for k in range(K):
                    u[k] /= -root[w, k, 0, 0]
                    u[K + k] *= prior[w, K + k]
                # slow errors of the rows go with those of the first pose
                u[c] -= root[w, c, 1 + row, 0] / root[w, c, 0, 0]
                variance = 1.0
                v[:] = 0.0
                for k in range(R):
                    for m in range(R):
                        v[m] += A[k, m] * u[k]
                for k in range(R):
                    variance += v[k] * v[k]
                std = math.sqrt(variance)
                less = std / (1.0 + std)
                for k in range(R):
                    along = 0.0
                    for m in range(R):
                        along += A[k, m] * v[m]
                    along /= variance
                    g[k] = along
                    for m in range(R):
                        A[k, m] -= less * along * v[m]
                scale[w, i] = 1.0 / std
                total += math.log(root[w, c, 1 + row, 1 + row] / std)
        log_det[w] = total


@fused_kernel
def whiten(index, residuals, mean, root, columns, gain, scale, out):  # type: ignore[no-untyped-def]
    """Write the innovations of residuals (n, L, K) of windows into `out`, likewise.

    Args:
        index: (n,) windows.
        residuals: (n, L, K).
        mean: (W, K L) of residuals.
        root: As of `factorise`, like those after it.
        columns: (W, K L, R).
        gain: (W, K L, R).
        scale: (W, K L).
        out: (n, L, K).
    """
    K, rows, R = root.shape[1], root.shape[2] - 1, columns.shape[2]
    state = np.empty(R)
    for b in range(len(index)):
        w = index[b]
        state[:] = 0.0
        for row in range(rows):
            for c in range(K):
                i, own = row * K + c, 0.0
                for j in range(row + 1):
                    own += root[w, c, 1 + row, 1 + j] * (residuals[b, j, c] - mean[w, j * K + c])
                for k in range(R):
                    own -= columns[w, i, k] * state[k]
                for k in range(R):
                    state[k] += gain[w, i, k] * own
                out[b, row, c] = own * scale[w, i]


@fused_inlined_kernel
def _own(root, w, c, row, first, values, b, K):  # type: ignore[no-untyped-def]
    """Channel c's entry `row` (0: the first pose) of the own errors' whitened first deviation and values (n, K L)."""
    total = root[w, c, row, 0] * first
    for j in range(row):
        total += root[w, c, row, 1 + j] * values[b, j * K + c]
    return total


@fused_kernel
def costs(index, residuals, center, other, root, deviation, prior, out):  # type: ignore[no-untyped-def]
    """Write -2 log posterior of first states, with the best multiple of the other engine, into `out` (n,).

    Args:
        index: (n,) windows.
        residuals: (n, K L).
        center: multiple of the other engine's difference that is expected.
        other: (W, K L) that difference.
        root: (W, K, L + 1, L + 1) as of `factorise`.
        deviation: (n, 2 K) recorded first states minus those of the residuals.
        prior: (W, 2 K) as of `factorise`.
        out: (n,).
    """
    K, rows = root.shape[1], root.shape[2]
    for b in range(len(index)):
        w, total, along, length = index[b], 0.0, 0.0, 1.0
        for c in range(K):
            for row in range(rows):
                o = _own(root, w, c, row, 0.0, other, w, K)
                r = _own(root, w, c, row, deviation[b, c], residuals, b, K) - center * o
                total += min(r * r, MOST)
                along += o * r
                length += o * o
        total -= min(along * along / length, MOST)
        for k in range(K, 2 * K):
            total += (deviation[b, k] / prior[w, k]) ** 2
        out[b] = total


@fused_kernel
def gauss_newton(index, residuals, center, other, root, by_state, deviation, prior, damping, out):  # type: ignore[no-untyped-def]
    """Write damped Gauss-Newton steps of first states, beside the other engine's multiple, into `out` (n, 2 K).

    Args:
        index: (n,) windows.
        residuals: As of `costs`, like the next three.
        center: As of `costs`.
        other: (W, K L).
        root: (W, K, L + 1, L + 1).
        by_state: (W, K L, 2 K) derivatives.
        deviation: (n, 2 K) as of `costs`.
        prior: (W, 2 K).
        damping: (n,) Marquardt's.
        out: (n, 2 K).
    """
    K, rows = root.shape[1], root.shape[2]
    R = 2 * K + 1
    H, g, u = np.empty((R, R)), np.empty(R), np.empty(R)
    for b in range(len(index)):
        w = index[b]
        H[:] = 0.0
        g[:] = 0.0
        for c in range(K):
            for row in range(rows):
                u[:] = 0.0
                u[c] = root[w, c, row, 0]
                for j in range(row):
                    weight = root[w, c, row, 1 + j]
                    if weight != 0.0:
                        for k in range(2 * K):
                            u[k] += weight * by_state[w, j * K + c, k]
                        u[2 * K] += weight * other[w, j * K + c]
                r = _own(root, w, c, row, deviation[b, c], residuals, b, K) - center * u[2 * K]
                for k in range(R):
                    g[k] += u[k] * r
                    for m in range(k + 1):
                        H[k, m] += u[k] * u[m]
        for k in range(K, 2 * K):
            H[k, k] += prior[w, k] ** -2.0
            g[k] += deviation[b, k] * prior[w, k] ** -2.0
        H[2 * K, 2 * K] += 1.0
        for k in range(R):
            H[k, k] *= 1.0 + damping[b]
        _solve(H, g)
        for k in range(2 * K):
            out[b, k] = g[k]


@fused_inlined_kernel
def _solve(H, g):  # type: ignore[no-untyped-def]
    """g becomes H^-1 g, of a positive matrix whose lower triangle is given and overwritten by its Cholesky factor."""
    n = len(g)
    for k in range(n):
        for m in range(k):
            for j in range(m):
                H[k, m] -= H[k, j] * H[m, j]
            H[k, m] /= H[m, m]
        for j in range(k):
            H[k, k] -= H[k, j] * H[k, j]
            g[k] -= H[k, j] * g[j]
        H[k, k] = math.sqrt(H[k, k])
        g[k] /= H[k, k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            g[k] -= H[j, k] * g[j]
        g[k] /= H[k, k]
