"""Cholesky's factorisation of a small matrix and its triangular solves, S = L L^T.

The inverse of the factor's diagonal stands on L's diagonal: solves then multiply.
"""

from __future__ import annotations

import math

from tossid.kernels import fused_inlined_kernel, fused_lean_kernel


@fused_inlined_kernel
def cholesky(L, n):  # type: ignore[no-untyped-def]
    """The lower triangle of S (n, n) in L becomes that of its factor; False where S is not positive definite."""
    for i in range(n):
        for j in range(i):
            s = L[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            L[i, j] = s * L[j, j]
        s = L[i, i]
        for k in range(i):
            s -= L[i, k] * L[i, k]
        if not s > 0.0:
            return False
        L[i, i] = 1.0 / math.sqrt(s)
    return True


@fused_inlined_kernel
def forward_substitute(L, x, n):  # type: ignore[no-untyped-def]
    """x (n,) <- L^-1 x."""
    for i in range(n):
        s = x[i]
        for k in range(i):
            s -= L[i, k] * x[k]
        x[i] = s * L[i, i]


@fused_inlined_kernel
def back_substitute(L, x, n):  # type: ignore[no-untyped-def]
    """x (n,) <- L^-T x."""
    for i in range(n - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, n):
            s -= L[k, i] * x[k]
        x[i] = s * L[i, i]


@fused_lean_kernel
def solve_rates(L, x, n):  # type: ignore[no-untyped-def]
    """x (n,) <- S^-1 x."""
    forward_substitute(L, x, n)
    back_substitute(L, x, n)
