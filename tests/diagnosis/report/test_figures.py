"""The figures at the top of the report can be read, and draw the diagnosis's own numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import diagnosis, gap, without_effects
from tests.evaluation.figures.reading import assert_legible, words
from tossid.diagnosis.findings import Interval, Share
from tossid.diagnosis.report import report_figures
from tossid.diagnosis.report.figures import evidence, gain_per_toss, gap_by_part, gap_over_time
from tossid.objects import ObjectModel
from tossid.settings.diagnosis.report import ReportSettings

SETTINGS = ReportSettings()


def test_intervals_of_gains_are_students(cube: ObjectModel) -> None:
    rng = np.random.default_rng(0)
    gains = rng.normal(3.0, 5.0, 20)
    from scipy.stats import t, ttest_1samp

    p = float(ttest_1samp(gains, 0, alternative="greater").pvalue)
    found = diagnosis(cube).findings[0]
    found = replace(found, evidence={"gain": float(gains.sum()), "p_value": p, "n_tosses": 20.0})
    mean, low, high = gain_per_toss(found)
    half = float(t.ppf(0.975, 19) * gains.std(ddof=1) / np.sqrt(20))
    np.testing.assert_allclose((mean, low, high), (gains.mean(), gains.mean() - half, gains.mean() + half), rtol=1e-6)


@pytest.mark.parametrize("draw", [gap_by_part, gap_over_time, evidence])
@pytest.mark.parametrize("n", [6, 60])
def test_pictures_are_legible(cube: ObjectModel, draw, n: int) -> None:  # type: ignore[no-untyped-def]
    assert_legible(draw(diagnosis(cube, n=n), SETTINGS))
    assert_legible(draw(without_effects(cube, "unexplained", n=n), SETTINGS))


def test_bars_after_are_on_the_scale_of_the_first_gap(cube: ObjectModel) -> None:
    found = diagnosis(cube)
    figure = gap_by_part(found, SETTINGS)
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
    wild = tuple(Share(s.name, Interval(-0.6, -4.3, 4.8)) for s in found.gap.by_phase)
    found = replace(found, gap=replace(found.gap, by_phase=wild))
    assert_legible(gap_by_part(found, SETTINGS))


def test_the_time_bin_is_a_setting(cube: ObjectModel) -> None:
    found = diagnosis(cube, n=6)
    tables = [
        gap_over_time(found, ReportSettings(time_bin=width)).axes[0].images[0].get_array() for width in (0.02, 0.04)
    ]
    assert tables[0].shape[1] == pytest.approx(2 * tables[1].shape[1], abs=1)
