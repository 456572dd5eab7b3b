"""The learned acceleration in the time stepper is that of its formula."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from tossid.physics import LearnedAcceleration
from tossid.physics.network import make_network, network, tanh


@numba.njit
def evaluated(k_res, f, hidden, out):  # type: ignore[no-untyped-def]
    """What only kernels may call."""
    network(k_res, f, hidden, out)


@numba.njit
def of_each(x, out):  # type: ignore[no-untyped-def]
    for i in range(len(x)):
        out[i] = tanh(x[i])


@pytest.mark.parametrize("hidden", [1, 6, 8, 19])
def test_two_hidden_layers_and_a_linear_part(hidden: int) -> None:
    rng = np.random.default_rng(0)
    shapes = ((6, 9), (hidden, 9), (hidden,), (hidden, hidden), (hidden,), (6, hidden))
    k = LearnedAcceleration(*(rng.normal(size=shape) for shape in shapes))
    f, out = rng.normal(size=9), np.empty(6)
    evaluated(make_network(k), f, np.zeros((2, hidden)), out)
    expected = k.linear @ f + k.W2 @ np.tanh(k.W1 @ np.tanh(k.W0 @ f + k.b0) + k.b1)
    np.testing.assert_allclose(out, expected, rtol=1e-13, atol=1e-13)


def test_tanh_is_numpys_to_rounding() -> None:
    x = np.concatenate([np.linspace(-30, 30, 100_001), 10.0 ** -np.linspace(0, 300, 1000), [0.0, np.inf, -np.inf]])
    out = np.empty_like(x)
    of_each(x, out)
    np.testing.assert_allclose(out, np.tanh(x), rtol=0, atol=3e-16)
    of_each(np.array([np.nan]), out[:1])
    assert np.isnan(out[0])
