"""Forces outside the library are what they say."""

from __future__ import annotations

import numpy as np
import pytest

from tests.audit.throws import throws
from tossid.audit.unknown_forces import push_of


def test_forces_outside_the_library_are_what_they_say() -> None:
    q, v = throws(6)
    cubic = push_of("cubic_drag", {"c_ns3pm3": 0.2}, count=6, seconds=1, seed=0)(0.0, q, v)
    np.testing.assert_allclose(cubic, -0.2 * np.linalg.norm(v[:, :3], axis=1, keepdims=True) ** 2 * v[:, :3])
    telegraph = push_of("telegraph_force", {"x_n": 0.3, "y_n": 0.4, "switches_ps": 20}, count=400, seconds=1, seed=0)
    signs = np.array([telegraph(t, q, v)[:, 0] / 0.3 for t in np.arange(0, 1, 2e-3)])
    np.testing.assert_allclose(np.abs(signs), 1)
    assert (np.diff(signs, axis=0) != 0).sum(0).mean() == pytest.approx(20, rel=0.1)
    pulsing = push_of("pulsing_force", {"x_n": 1.0, "y_n": 0.0, "period_s": 0.1}, count=3, seconds=1, seed=0)
    np.testing.assert_allclose(pulsing(0.02, q, v), pulsing(0.12, q, v), atol=1e-12)
