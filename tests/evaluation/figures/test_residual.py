"""Accelerations over a toss add up, and what the data do not separate is hatched."""

from __future__ import annotations

import numpy as np
import pytest

from tests.evaluation.figures.reading import assert_legible, line, words
from tossid.evaluation.figures import Accelerations, residual_over_toss


def accelerations() -> dict[str, np.ndarray]:
    n = 80
    contact = np.where(np.arange(n) >= 50, 9.81, 0.0)
    contact[30] = 250.0
    given, residual = np.full(n, -4.0), np.full(n, -5.81)
    return {
        "t": np.arange(n) / 148,
        "given": given,
        "residual": residual,
        "contact": contact,
        "measured": given + residual + contact + 0.5,
        "separable": np.arange(n) < 50,
    }


def test_accelerations_add_up_and_what_is_not_separable_is_hatched() -> None:
    parts = accelerations()
    figure = residual_over_toss(Accelerations(**parts))
    given, residual, contact, total = figure.axes
    for ax, name in ((given, "given"), (residual, "residual"), (contact, "contact"), (total, "measured")):
        np.testing.assert_array_equal(line(ax, name).get_data(), [parts["t"], parts[name]])
    np.testing.assert_allclose(line(total, "sum").get_ydata(), parts["measured"] - 0.5)
    assert line(given, "true").get_ydata()[0] == -9.81
    for ax in figure.axes:
        (span,) = [p for p in ax.patches if p.get_hatch()]
        assert span.get_x() == pytest.approx(49.5 / 148)
        low, high = ax.get_ylim()
        drawn = np.concatenate([one.get_ydata() for one in ax.lines if len(one.get_ydata()) == 80])
        assert low < drawn.min() <= drawn.max() < high
    for ax in (residual, contact):
        assert "not separable" in [text.get_text() for text in ax.texts]
    assert "given −4.00, with the learned part −9.81, measured −9.31" in words(figure)
    assert_legible(figure)


def test_nothing_is_hatched_where_all_is_separable() -> None:
    parts = accelerations()
    parts["separable"] = np.ones(80, dtype=bool)
    figure = residual_over_toss(Accelerations(**parts))
    assert not [p for ax in figure.axes for p in ax.patches if p.get_hatch()]
    assert "not separable" not in words(figure)
