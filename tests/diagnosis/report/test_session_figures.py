"""The recording stands in the report where the order of recording was looked at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.diagnosis.by_hand import diagnosis
from tossid.diagnosis.report import report_figures, report_html, report_pngs
from tossid.evaluation.figures import recording_over_order
from tossid.objects import ObjectModel
from tossid.types import RecordingOrder, Session


def order() -> RecordingOrder:
    values = np.random.default_rng(0).normal(size=(30, 3))
    values[:12, :2] += 5
    values[3] = np.nan
    return RecordingOrder(
        (
            Session("0", "11", 12, (0.041, 0.0), (0.001, 0.001), levelled=True),
            Session("12", "29", 18, (0.0, 0.0), (0.001, 0.001), changed={"normal": 0.00175}),
        ),
        "names",
        tuple(map(str, range(30))),
        ("normal_x", "normal_y", "gravity"),
        values,
        np.random.default_rng(1).normal(size=(30, 2)),
        np.tile([1.0, 0.0, 0.0, 0.0], (30, 1)),
        np.zeros(30),
        np.repeat([0, 1], [12, 18]),
        ("times overlap",),
    )


def test_the_page_says_the_sessions(cube: ObjectModel) -> None:
    found = replace(diagnosis(cube), order=order())
    page = report_html(found, report_pngs(found))
    detail = page[page.index("<summary>The recording") :]
    assert "Session 0 to 11 (12 tosses): its world is tilted by 2.35°" in detail
    assert "normal changed before it" in detail
    assert "Times overlap." in detail


def test_without_an_order_there_is_no_such_section(cube: ObjectModel) -> None:
    assert "gap_recording" not in report_figures(diagnosis(cube))


def test_points_lie_where_tosses_do_and_sessions_are_divided() -> None:
    known = order()
    axes = recording_over_order(known).axes
    normal = next(ax for ax in axes if ax.get_ylabel().startswith("resting normal"))
    x, y, divider = normal.lines
    np.testing.assert_array_equal(x.get_ydata(), 180 / np.pi * known.values[:, 0])
    np.testing.assert_array_equal(y.get_ydata(), 180 / np.pi * known.values[:, 1])
    assert list(divider.get_xdata()) == [11.5, 11.5]
