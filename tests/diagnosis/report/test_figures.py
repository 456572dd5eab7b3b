"""The figures at the top of the report can be read, and draw the diagnosis's own numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import diagnosis, gap, without_effects
from tests.evaluation.figures.reading import assert_legible, words
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.report import report_figures
from tossid.diagnosis.report.figures import gap_by_part, gap_over_time, whole_tosses
from tossid.objects import ObjectModel


@pytest.mark.parametrize("draw", [whole_tosses, gap_by_part, gap_over_time])
@pytest.mark.parametrize("n", [6, 60])
def test_pictures_are_legible(cube: ObjectModel, draw, n: int) -> None:  # type: ignore[no-untyped-def]
    assert_legible(draw(diagnosis(cube, n=n)))
    assert_legible(draw(without_effects(cube, "unexplained", n=n)))


def test_bars_after_are_on_the_scale_of_the_first_gap(cube: ObjectModel) -> None:
    found = diagnosis(cube)
    figure = gap_by_part(found)
    left = found.left.frames[:, 3].sum() / found.gap.frames[:, 3].sum()
    (ax, _) = figure.axes[:2]
    widths = [patch.get_width() for patch in ax.patches]
    np.testing.assert_allclose(widths[::2], [0, 20, 70, 5, 5], atol=1e-9)
    np.testing.assert_allclose(widths[1::2], [0, 20 * left, 70 * left, 5 * left, 5 * left], atol=1e-9)
    assert f"70 → {70 * left:.0f} %" in words(figure)


def test_tosses_without_frames_or_contact_are_drawn(cube: ObjectModel) -> None:
    found = without_effects(cube, "no_gap")
    flying = gap(1.0, n=20)
    rows = flying.frames.copy()
    rows[:, 2] = 1
    rows = rows[rows[:, 0] != 3]
    found = replace(found, gap=replace(flying, frames=rows), left=replace(flying, frames=rows))
    for figure in report_figures(found).values():
        assert_legible(figure)


def test_shares_that_are_not_known_do_no_harm(cube: ObjectModel) -> None:
    found = without_effects(cube, "no_gap")
    wild = dict.fromkeys(found.gap.by_phase, Interval(-0.6, -4.3, 4.8))
    found = replace(found, gap=replace(found.gap, by_phase=wild))
    assert_legible(gap_by_part(found))


def test_each_whole_toss_is_a_dot_before_and_after(cube: ObjectModel) -> None:
    found = diagnosis(cube)
    figure = whole_tosses(found)
    for k, ax in enumerate(figure.axes[:2]):
        before, after = (line.get_ydata() for line in ax.lines if line.get_marker() == "o")
        np.testing.assert_allclose(before, found.brings.before[:, k])
        np.testing.assert_allclose(after, found.brings.after[:, k])
        assert ax.get_ylim()[0] < after.min() < before.max() < ax.get_ylim()[1]
    assert "before\n12" in words(figure)
    unchanged = whole_tosses(without_effects(cube, "unexplained"))
    assert "after" not in words(unchanged)
