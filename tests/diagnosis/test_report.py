"""The page says what was found, in words first; it needs nothing beside itself; its pictures can be read."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from tests.diagnosis.by_hand import diagnosis, gap, hypothesis, without_effects
from tests.evaluation.figures.reading import assert_legible, words
from tossid.diagnosis.figures import evidence, gain_per_toss, over_time, report_figures, where_it_lies
from tossid.diagnosis.findings import Interval, Share
from tossid.diagnosis.report import report_html
from tossid.diagnosis.words import headline, in_units, percent, quantity, sentences
from tossid.objects import ObjectModel


class Page(HTMLParser):
    """Tags with their attributes, and the text in reading order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.text += data + " "


def page_of(model: ObjectModel) -> Page:
    found = diagnosis(model)
    next_toss = {"release": None, "reason": "<none>", "between": ["friction", "cohesion"]}
    text = report_html(found, report_figures(found), about="a & b", patch=None, next_toss=next_toss)
    return Page(text)


def test_the_page_is_whole_and_asks_nothing_of_the_network(cube: ObjectModel) -> None:
    found = diagnosis(cube)
    text = report_html(found, report_figures(found), about="Simulator: a & b <c>.")
    page = Page(text)
    assert page.open == []
    assert not re.search(r"https?://|<script|<link|@import|url\(", text)
    pictures = [attrs["src"] for tag, attrs in page.tags if tag == "img"]
    assert len(pictures) == 3
    for source in pictures:
        head, _, data = (source or "").partition(",")
        assert head == "data:image/png;base64"
        assert base64.b64decode(data).startswith(b"\x89PNG")
    assert all(attrs["alt"] for tag, attrs in page.tags if tag == "img")
    assert "a & b <c>" in page.text


def test_words_come_first_and_tell_the_whole_story(cube: ObjectModel) -> None:
    page = page_of(cube)
    first = page.text[: page.text.index("What was found")]
    for piece in (
        "The gap is explained: friction",
        "5.00 standard deviations",
        "noise alone would leave 1.00",
        "while sliding (70 %)",
        "mu = 0.3000 (0.2970 to 0.3030), the simulator has 0.180",
        "93 % (85 % to 98 %)",
        "cannot tell friction from cohesion",
        "0.60 % of the width",
        "Left is 7 %",
    ):
        assert piece in first, piece
    assert "<none>" in page.text


def test_details_hold_every_effect_with_the_size_that_would_have_shown(cube: ObjectModel) -> None:
    found = without_effects(cube, "no_gap")
    page = Page(report_html(found, report_figures(found), about=""))
    for f in found.findings:
        assert f.name in page.text
    assert "g 0.050 m/s²" in page.text
    assert "x 1.0 mm" in page.text  # the step of com_offset is 1e-3 m


@pytest.mark.parametrize(
    ("verdict", "opening", "closing"),
    [
        ("no_gap", "No gap to speak of", "what size of each would have shown"),
        ("unexplained", "The gap is not explained", "no effect of the library explains it"),
    ],
)
def test_nothing_named_is_said_as_such(cube: ObjectModel, verdict: str, opening: str, closing: str) -> None:
    found = without_effects(cube, verdict)
    assert headline(found) == opening
    assert closing in " ".join(sentences(found))


def test_what_is_left_is_said_with_its_place(cube: ObjectModel) -> None:
    left = (Share("impact", Interval(0.3, 0.2, 0.4)),)
    found = replace(diagnosis(cube), verdict="partly_explained", gap_closed=Interval(0.6, 0.5, 0.7), unexplained=left)
    assert "Left is 40 %, clearly so at impacts (30 % of the first gap)" in sentences(found)[-1]


def test_what_is_not_the_same_in_all_tosses_is_said_with_its_size(cube: ObjectModel) -> None:
    found = replace(diagnosis(cube), hypothesis=hypothesis(cube, uniform_force=[0.26, -0.13, 0.0]), named=())
    said = " ".join(sentences(replace(found, unsteady=("uniform_force",))))
    assert "something like uniform_force (x 0.260 N, y −0.130 N, z 0 N for all together), but not the same" in said


def test_an_odd_toss_is_named(cube: ObjectModel) -> None:
    found = diagnosis(cube)
    found = replace(found, gap=replace(found.gap, odd=("007",)))
    assert "Look at toss 007" in sentences(found)[-1]


def test_units_are_a_persons() -> None:
    assert quantity("x_m", 0.0015) == "1.50 mm"
    assert quantity("g_ms2", 9.6) == "9.60 m/s²"
    assert quantity("mu", 0.18) == "0.180"
    assert quantity("stiffness_npm", 33000.0) == "33\u202f000 N/m"
    assert in_units("y_rad", Interval(np.pi / 180, np.pi / 360, np.pi / 120)) == "1.0 deg (0.5 to 1.5)"
    assert in_units("mu", Interval(0.29867, 0.29698, 0.30036)) == "0.2987 (0.2970 to 0.3004)"
    assert percent(-0.001) == "0 %"


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


# ---------------------------------------------------------------- pictures


@pytest.mark.parametrize("draw", [where_it_lies, over_time, evidence])
@pytest.mark.parametrize("n", [6, 60])
def test_pictures_are_legible(cube: ObjectModel, draw, n: int) -> None:  # type: ignore[no-untyped-def]
    assert_legible(draw(diagnosis(cube, n=n)))
    assert_legible(draw(without_effects(cube, "unexplained", n=n)))


def test_bars_after_are_on_the_scale_of_the_first_gap(cube: ObjectModel) -> None:
    found = diagnosis(cube)
    figure = where_it_lies(found)
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
    assert_legible(where_it_lies(found))
