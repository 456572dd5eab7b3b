"""The learned acceleration in the time stepper is that of its formula, and of the plain kernel."""

from __future__ import annotations

import numba
import numpy as np

from tossid.physics import LearnedAcceleration
from tossid.physics.network import network


@numba.njit
def evaluated(k_res, f, hidden, out):  # type: ignore[no-untyped-def]
    """What only kernels may call."""
    network(k_res, f, hidden, out)


def test_two_hidden_layers_and_a_linear_part() -> None:
    rng = np.random.default_rng(0)
    shapes = ((6, 9), (8, 9), (8,), (8, 8), (8,), (6, 8))
    k = LearnedAcceleration(*(rng.normal(size=shape) for shape in shapes))
    f, out = rng.normal(size=9), np.empty(6)
    evaluated(k, f, np.zeros((2, 8)), out)
    expected = k.linear @ f + k.W2 @ np.tanh(k.W1 @ np.tanh(k.W0 @ f + k.b0) + k.b1)
    np.testing.assert_allclose(out, expected, rtol=1e-13)
