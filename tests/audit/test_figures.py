"""The figures of an audit hold the cases' shares and ranks."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.audit.figures import audit_figures, ranks, wilson


def test_figures_are_of_what_cases_have() -> None:
    null = {"kind": "null", "engine": "lcp", "displacement": [], "right": True, "parameters": []}
    assert audit_figures([null]) == {}
    right = {**null, "kind": "effect", "displacement": [20.0], "parameters": [{"rank": 0.3}, {"rank": None}]}
    wrong = {**null, "kind": "pair", "engine": "mujoco", "displacement": [3.0, 200.0], "right": False}
    figures = audit_figures([null, right, wrong])
    assert set(figures) == {"detection", "ranks"}
    points = [line.get_xydata() for line in figures["detection"].axes[0].get_lines()]
    assert any(np.allclose(xy[:, 0], [20.0]) and abs(xy[0, 1] - 1) < 0.03 for xy in points if len(xy) == 1)
    assert any(np.allclose(xy[:, 0], [3.0]) and abs(xy[0, 1]) < 0.03 for xy in points if len(xy) == 1)


def test_ranks_are_drawn_as_their_distance_from_uniform_ones() -> None:
    (line,) = ranks([[0.9], [0.1]]).axes[0].get_lines()[1:]
    np.testing.assert_allclose(line.get_xydata(), [[0, 0], [0.1, 0.4], [0.9, 0.1], [1, 0]], atol=1e-12)


def test_wilsons_interval_is_the_published_one() -> None:
    """Newcombe 1998, table I: 81 of 263."""
    assert wilson(81, 263) == (pytest.approx(0.2553, abs=1e-4), pytest.approx(0.3662, abs=1e-4))
