"""What changes over the order of recording is said in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.diagnosis.by_hand import EFFECTS, diagnosis, finding
from tossid.diagnosis.findings import ChangeLeft, Interval, OverOrder, Stretch
from tossid.diagnosis.report import report_figures
from tossid.diagnosis.report.order_text import over_order_sentences
from tossid.diagnosis.report.text import headline
from tossid.diagnosis.result import Diagnosis
from tossid.objects import ObjectModel


def two_recordings(cube: ObjectModel) -> Diagnosis:
    tilts = ((np.radians(2.35), 0.0), (0.0, np.radians(0.1)))
    stretches = tuple(
        Stretch(first, last, n, {"x_rad": Interval(x, x, x), "y_rad": Interval(y, y, y)})
        for (first, last, n), (x, y) in zip((("0", "11", 12), ("12", "19", 8)), tilts, strict=True)
    )
    tilt = finding(
        EFFECTS["world_tilt"], "identified", over_order=OverOrder("steps", stretches, {}, 0.0015, undone=True)
    )
    return replace(
        diagnosis(cube),
        findings=(tilt,),
        named=("world_tilt",),
        tosses=tuple(map(str, range(20))),
        places=np.random.default_rng(0).normal(size=(20, 2)),
        changes_left=(),
    )


def test_two_recordings_in_words(cube: ObjectModel) -> None:
    found = two_recordings(cube)
    (text,) = over_order_sentences(found)
    assert text.startswith(
        "Two recordings: tosses 0 to 11 stand in a world tilted by 2.35 degrees; "
        "tosses 12 to 19 stand in a world tilted by 0.10 degrees (p < 0.0015)."
    )
    assert headline(found) == "The gap is explained: world_tilt, which changes"


def test_a_drift_has_a_rate(cube: ObjectModel) -> None:
    order = OverOrder(
        "drift",
        (Stretch("0", "0", 1, {}), Stretch("19", "19", 1, {})),
        {"mu": Interval(1e-3, 9e-4, 1.1e-3)},
        0.001,
        undone=False,
    )
    found = replace(two_recordings(cube), findings=(finding(EFFECTS["friction"], "identified", over_order=order),))
    (text,) = over_order_sentences(found)
    assert text == "friction drifts from toss 0 to 19: mu by 0.100 (0.0900 to 0.110) per 100 tosses (p < 0.001)."
    assert "drift" in found.findings[0].as_json()


def test_what_no_effect_explains_is_said_too(cube: ObjectModel) -> None:
    found = replace(two_recordings(cube), findings=(), changes_left=(ChangeLeft("7", {"residual": 0.002}),))
    (text,) = over_order_sentences(found)
    assert text.startswith("Something changes from toss 7 on, in the size of the gap (p < 0.002)")


def test_figures_over_order_and_place_show_every_toss(cube: ObjectModel) -> None:
    figures = report_figures(two_recordings(cube))
    (axes,) = figures["gap_over_order"].axes
    before, after, divider = axes.lines
    assert [np.asarray(line.get_xdata()).shape for line in (before, after)] == [(20,), (20,)]
    np.testing.assert_array_equal(np.asarray(divider.get_xdata()), [11.5, 11.5])
    left = figures["gap_over_place"].axes[0].collections[0]
    np.testing.assert_allclose(np.asarray(left.get_offsets(), dtype=float), two_recordings(cube).places)
    assert "gap_over_order" not in report_figures(diagnosis(cube))
