"""The learned acceleration of a system, in a kernel."""

from __future__ import annotations

import math

from tossid.kernels import lean_kernel


@lean_kernel
def network(k_res, f, hidden, out):  # type: ignore[no-untyped-def]
    """out (n_out,) = W f + W2 tanh(W1 tanh(W0 f + b0) + b1); see `system.LearnedAcceleration`."""
    linear, W0, b0, W1, b1, W2 = k_res
    nf, h, h0, h1 = linear.shape[1], b0.shape[0], hidden[0], hidden[1]
    for i in range(h):
        s = b0[i]
        for j in range(nf):
            s += W0[i, j] * f[j]
        h0[i] = math.tanh(s)
    for i in range(h):
        s = b1[i]
        for j in range(h):
            s += W1[i, j] * h0[j]
        h1[i] = math.tanh(s)
    for i in range(W2.shape[0]):
        s = 0.0
        for j in range(nf):
            s += linear[i, j] * f[j]
        for j in range(h):
            s += W2[i, j] * h1[j]
        out[i] = s
