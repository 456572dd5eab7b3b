"""A figure that is registered from outside stands on the page, where it said, and nothing of the package is edited."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from matplotlib.figure import Figure

from tests.diagnosis.by_hand import diagnosis
from tossid.diagnosis.report import REPORT_FIGURES, report_figure, report_figures, report_html, report_pngs
from tossid.diagnosis.result import Diagnosis
from tossid.evaluation.figures.style import new_figure
from tossid.objects import ObjectModel


@pytest.fixture(autouse=True)
def _registry(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    kept = dict(REPORT_FIGURES)
    yield
    REPORT_FIGURES.clear()
    REPORT_FIGURES.update(kept)


def toy(diagnosis: Diagnosis) -> Figure:
    return new_figure("Toy", "One function, one line.", height=2.0)


def test_a_figure_from_outside_is_on_the_page(cube: ObjectModel) -> None:
    report_figure("toy", alt="A toy & its <words>.")(toy)
    found = diagnosis(cube)
    figures = report_figures(found)
    assert list(figures) == ["gap_tosses", "gap_where", "gap_when", "toy"]
    page = report_html(found, report_pngs(found))
    assert 'alt="A toy &amp; its &lt;words&gt;."' in page
    assert page.index("A toy") < page.index("<h2>Details</h2>")


def test_a_detail_has_its_heading_and_its_note(cube: ObjectModel) -> None:
    report_figure("toy", alt="", detail="A toy detail", note="A note.")(toy)
    found = diagnosis(cube)
    page = report_html(found, report_pngs(found))
    detail = page[page.index("<summary>A toy detail</summary>") :]
    assert page.index("A toy detail") > page.index("<h2>Details</h2>")
    for piece in ("data:image/png;base64,", "A note."):
        assert piece in detail[: detail.index("</details>")]


def test_a_figure_that_does_not_apply_is_left_out(cube: ObjectModel) -> None:
    report_figure("toy", alt="toy", applies=lambda d: d.verdict == "no_gap")(toy)
    assert "toy" not in report_figures(diagnosis(cube))


def test_figures_of_one_heading_stand_together(cube: ObjectModel) -> None:
    report_figure("toy", alt="A toy", detail="Where the gap is")(toy)
    found = diagnosis(cube)
    page = report_html(found, report_pngs(found))
    detail = page[page.index("<summary>Where the gap is</summary>") :]
    assert detail[: detail.index("</details>")].count("data:image/png") == 3
