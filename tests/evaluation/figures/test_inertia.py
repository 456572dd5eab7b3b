"""The inertia study counts the starts that reached the truth."""

from __future__ import annotations

import numpy as np

from tests.evaluation.figures.reading import assert_legible, line, lines, words
from tossid.evaluation.figures import inertia_study


def test_the_inertia_study_counts_who_reached_the_truth() -> None:
    starts = [(s, o) for s in (0.25, 0.5, 1.0, 2.0, 4.0) for o in (0.0, 0.002, 0.005, 0.01)]
    cells = [
        {
            "parameterisation": kind,
            "seed": 0,
            "inertia_scale": s,
            "com_offset_m": o,
            "inertia_error_rel": {"mean": error, "ci95": [0.9 * error, 1.2 * error]},
            "com_error_m": 0.5e-3 if o < 0.01 else 2e-3,
        }
        for kind, error in (("log-Cholesky", 0.01), ("principal moments", 0.3))
        for s, o in starts
    ]
    cells[0]["inertia_error_rel"] = float("nan")
    figure = inertia_study(cells)
    assert len(figure.axes) == 4
    assert "log-Cholesky\n14 of 20 reached" in words(figure)
    assert "principal moments\n0 of 20 reached" in words(figure)
    assert "no result: 1" in words(figure)
    upper, _, lower, _ = figure.axes
    np.testing.assert_allclose(line(upper, "learned").get_ydata()[1:], 1.0)
    np.testing.assert_allclose(line(upper, "start").get_ydata(), [100 * abs(s - 1) for s, _ in starts])
    np.testing.assert_allclose(np.log2(line(upper, "start").get_xdata()), [np.log2(s) for s, _ in starts], atol=0.31)
    np.testing.assert_allclose(line(lower, "start").get_ydata(), [1e3 * o for _, o in starts])
    (band,) = [p for p in upper.patches if p.get_label() == "reached"]
    assert (band.get_y(), band.get_height()) == (0, 5)
    intervals = [one.get_ydata() for one in lines(upper, "_interval")]
    np.testing.assert_allclose(intervals, np.tile([0.9, 1.2], (19, 1)))
    assert_legible(figure)


def test_one_offset_is_drawn_over_the_scales() -> None:
    common = {"parameterisation": "direct", "com_offset_m": 0.01, "inertia_error_rel": 0.02}
    found = ((0.25, 1e-4), (1.0, 2e-4), (4.0, 3e-4))
    cells = [{**common, "inertia_scale": scale, "com_error_m": error} for scale, error in found]
    _, lower = inertia_study(cells).axes
    assert lower.get_xlabel() == "start: inertia / true inertia [1]"
    np.testing.assert_allclose(line(lower, "learned").get_xdata(), [0.25, 1, 4])
    np.testing.assert_allclose(line(lower, "learned").get_ydata(), [0.1, 0.2, 0.3])
    np.testing.assert_allclose(line(lower, "start").get_ydata(), 10.0)
