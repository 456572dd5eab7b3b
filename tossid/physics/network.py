"""The learned acceleration of a system, in a kernel.

Matrices stand transposed, so that a loop over outputs reads neighbours and is compiled to vector instructions.
The hyperbolic tangent is written out for the same reason: `math.tanh` is a call for each number.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import fused_inlined_kernel, fused_lean_kernel
from tossid.physics.system import LearnedAcceleration

Array = NDArray[np.float64]

FLAT = 20.0
"""Beyond it tanh is 1 in double precision."""
LOG2_E = 1.4426950408889634
LOG_2_HIGH, LOG_2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""Natural logarithm of 2 in two parts; the first has 32 bits: its product with a small whole number is exact."""
WHOLE = 6755399441055744.0
"""1.5 * 2^52: what is added to it is rounded to a whole number, which its last bits then hold."""


class Network(NamedTuple):
    """A `system.LearnedAcceleration` with its matrices transposed.

    Attributes:
        linear: (n_f, n_out) W.
        W0: (n_f, h).
        b0: (h,).
        W1: (h, h).
        b1: (h,).
        W2: (h, n_out).
    """

    linear: Array
    W0: Array
    b0: Array
    W1: Array
    b1: Array
    W2: Array


def make_network(k_res: LearnedAcceleration) -> Network:
    """The learned acceleration as kernels read it.

    Args:
        k_res: of the system.
    """
    return Network(*(np.ascontiguousarray(part.T) for part in k_res))


@fused_inlined_kernel
def tanh(x):  # type: ignore[no-untyped-def]
    """Hyperbolic tangent, (1 - e) / (1 + e) with e = exp(-2 |x|); its error is below 3e-16.

    e is 2^k exp(r) with |r| <= log(2) / 2, and exp(r) is its Taylor polynomial of degree 13.
    """
    z = -2.0 * min(abs(x), FLAT)
    y = z * LOG2_E + WHOLE
    k = y - WHOLE
    r = (z - k * LOG_2_HIGH) - k * LOG_2_LOW
    p = 1.0 / 6227020800.0
    p = p * r + 1.0 / 479001600.0
    p = p * r + 1.0 / 39916800.0
    p = p * r + 1.0 / 3628800.0
    p = p * r + 1.0 / 362880.0
    p = p * r + 1.0 / 40320.0
    p = p * r + 1.0 / 5040.0
    p = p * r + 1.0 / 720.0
    p = p * r + 1.0 / 120.0
    p = p * r + 1.0 / 24.0
    p = p * r + 1.0 / 6.0
    p = p * r + 0.5
    p = p * r + 1.0
    p = p * r + 1.0
    exponent = (np.float64(y).view(np.int64) + 1023) << 52  # the bits of 2^k
    e = p * np.int64(exponent).view(np.float64)
    return math.copysign((1.0 - e) / (1.0 + e), x)


@fused_inlined_kernel
def add_product(W, x, y):  # type: ignore[no-untyped-def]
    """y (m,) += x (n,) W (n, m), four rows at a time: a sum that waits for the one before costs most here."""
    n, m = W.shape
    j = 0
    while j + 4 <= n:
        a, b, c, d = x[j], x[j + 1], x[j + 2], x[j + 3]
        for i in range(m):
            y[i] += (W[j, i] * a + W[j + 1, i] * b) + (W[j + 2, i] * c + W[j + 3, i] * d)
        j += 4
    while j < n:
        a = x[j]
        for i in range(m):
            y[i] += W[j, i] * a
        j += 1


@fused_lean_kernel
def network(k_res, f, hidden, out):  # type: ignore[no-untyped-def]
    """out (n_out,) = W f + W2 tanh(W1 tanh(W0 f + b0) + b1) of a `Network`."""
    h, h0, h1 = k_res.b0.shape[0], hidden[0], hidden[1]
    for i in range(h):
        h0[i] = k_res.b0[i]
    add_product(k_res.W0, f, h0)
    for i in range(h):
        h0[i] = tanh(h0[i])
    for i in range(h):
        h1[i] = k_res.b1[i]
    add_product(k_res.W1, h0, h1)
    for i in range(h):
        h1[i] = tanh(h1[i])
    for i in range(k_res.linear.shape[1]):
        out[i] = 0.0
    add_product(k_res.linear, f, out)
    add_product(k_res.W2, h1, out)
