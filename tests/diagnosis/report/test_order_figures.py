"""The recording stands in the report where the order of recording was looked at, and the gap over it everywhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.diagnosis.by_hand import diagnosis
from tests.evaluation.figures.reading import assert_legible
from tossid.diagnosis.findings import Interval, OverOrder, Stretch
from tossid.diagnosis.report import report_figures, report_html, report_pngs
from tossid.diagnosis.report.order_figures import gap_over_order, toss_excess
from tossid.diagnosis.result import Diagnosis
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


def stepped(cube: ObjectModel) -> Diagnosis:
    """Friction steps at the tenth of twenty tosses."""
    made = diagnosis(cube)
    stretches = (Stretch("0", "9", 10, {"mu": Interval(0.2, 0.19, 0.21)}), Stretch("10", "19", 10, {}))
    friction = replace(made.findings[0], over_order=OverOrder("steps", stretches, {}, 0.001, undone=False))
    return replace(
        made,
        findings=(friction, *made.findings[1:]),
        tosses=tuple(map(str, range(20))),
        places=np.random.default_rng(0).normal(size=(20, 2)),
    )


def test_the_page_says_the_sessions(cube: ObjectModel) -> None:
    found = replace(stepped(cube), order=order())
    page = report_html(found, report_pngs(found))
    detail = page[page.index("<summary>Over the order of recording") :]
    assert "Session 0 to 11 (12 tosses): its world is tilted by 2.35°" in detail
    assert "normal changed before it" in detail
    assert "Times overlap." in detail
    assert "friction changes: mu 0.200 (0.190 to 0.210) in tosses 0 to 9" in detail


def test_without_names_of_tosses_there_is_no_such_section(cube: ObjectModel) -> None:
    assert not {"gap_recording", "gap_over_order"} & report_figures(diagnosis(cube)).keys()


def test_each_toss_has_its_excess_before_and_after_and_changes_are_lines(cube: ObjectModel) -> None:
    found = stepped(cube)
    figure = gap_over_order(found)
    assert_legible(figure)
    before, after, change = figure.axes[0].lines
    np.testing.assert_allclose(before.get_ydata(), toss_excess(found.gap, 20))
    np.testing.assert_allclose(after.get_ydata(), toss_excess(found.left, 20))
    assert list(change.get_xdata()) == [9.5, 9.5]
    own = found.gap.frames[found.gap.frames[:, 0] == 3, 3]
    np.testing.assert_allclose(toss_excess(found.gap, 20)[3], own.mean())


def test_points_lie_where_tosses_do_and_sessions_are_divided() -> None:
    known = order()
    axes = recording_over_order(known).axes
    normal = next(ax for ax in axes if ax.get_ylabel().startswith("resting normal"))
    x, y, divider = normal.lines
    np.testing.assert_array_equal(x.get_ydata(), 180 / np.pi * known.values[:, 0])
    np.testing.assert_array_equal(y.get_ydata(), 180 / np.pi * known.values[:, 1])
    assert list(divider.get_xdata()) == [11.5, 11.5]
