"""The figures of an audit draw every kind of case."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.diagnosis.audit.figures import audit_figures, ranks, reliability, wilson


def test_the_figures_draw_every_kind() -> None:
    rows = [
        {"kind": kind, "engine": "lcp", "effects": effects, "class": group, "first": group[0] if group else None,
         "displacement": [20.0] * len(effects), "right": right, "claims": [], "parameters": [], "joint_ranks": []}
        for kind, effects, group, right in [
            ("effect", ["friction"], ["friction", "cohesion"], True),
            ("effect", ["magnus"], ["wind"], False),
            ("null", [], [], True),
            ("pair", ["friction", "gravity"], ["gravity"], False),
            ("outside", ["cubic_drag"], [], True),
            ("without", ["inertia"], [], True),
        ]
    ]  # fmt: skip
    figures = audit_figures(rows)
    assert set(figures) == {"confusion", "detection"}
    texts = {text.get_text() for text in figures["confusion"].axes[0].get_yticklabels()}
    assert {"nothing", "friction + gravity"} <= texts
    assert {"cubic_drag (not in the library)", "inertia (removed from the library)"} <= texts
    assert "reliability" not in figures


def test_ranks_are_drawn_as_their_distance_from_uniform_ones() -> None:
    rows = [{"parameters": [{"rank": rank, "led": True}], "joint_ranks": [0.5]} for rank in (0.9, 0.1)]
    single, joint = (line.get_xydata() for line in ranks(rows).axes[0].get_lines()[1:])
    np.testing.assert_allclose(single, [[0, 0], [0.1, 0.4], [0.9, 0.1], [1, 0]], atol=1e-12)
    np.testing.assert_allclose(joint, [[0, 0], [0.5, 0.0], [0.5, 0.5], [1, 0]], atol=1e-12)
    more = [row | {"claims": [], "displacement": [], "effects": [], "kind": "null"} for row in rows]
    assert "ranks" in audit_figures([row | {"class": [], "first": None} for row in more])


def test_reliability_is_drawn_of_stated_probabilities() -> None:
    stated = [{"of": "friction", "probability": p, "true": p > 0.5} for p in (0.1, 0.15, 0.9, 1.0)]
    stated.append({"of": "none", "probability": 0.0, "true": False})
    axes = reliability([{"claims": stated}]).axes[0]
    drawn = [line.get_xydata().tolist() for line in axes.get_lines()[1:]]
    assert drawn == [[[0.125, 0.0], [0.95, 1.0]], [[0.0, 0.0]]]


def test_wilsons_interval_is_the_published_one() -> None:
    """Newcombe 1998, table I: 81 of 263."""
    assert wilson(81, 263) == (pytest.approx(0.2553, abs=1e-4), pytest.approx(0.3662, abs=1e-4))
