"""The figures of the residual wrench and of the corners can be read, for any body, and stand among the details."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from tests.diagnosis.by_hand import diagnosis, with_place
from tests.evaluation.figures.reading import assert_legible, words
from tossid.diagnosis.report import REPORT_FIGURES, report_figures, report_html
from tossid.diagnosis.report.localisation_figures import CORNERS, WRENCH, gap_by_corner, wrench_over_state
from tossid.diagnosis.report.units import place_of
from tossid.diagnosis.result import Diagnosis
from tossid.evaluation.figures.style import as_png
from tossid.objects import OBJECT_FILES, ObjectModel, load_object


def details_of(made: Diagnosis) -> dict[str, Figure]:
    headings = (WRENCH, CORNERS)
    return {name: figure for name, figure in report_figures(made).items() if REPORT_FIGURES[name].detail in headings}


def test_the_pictures_of_the_place_are_legible(cube: ObjectModel) -> None:
    made = with_place(cube)
    figures = details_of(made)
    assert list(figures) == ["gap_wrench", "gap_corners"]
    for figure in figures.values():
        assert_legible(figure)
    assert "force along the path [N]" in words(figures["gap_wrench"])
    assert "horizontal speed [m/s]" in words(figures["gap_wrench"])
    assert place_of(cube.corner_pos[0]) in words(figures["gap_corners"])
    alone = replace(made, findings=(), place=replace(made.place, wrench_left=(), corners_left=()))
    assert_legible(wrench_over_state(alone))
    assert_legible(gap_by_corner(alone))


def test_a_body_of_other_corners_is_drawn(cube: ObjectModel) -> None:
    elbow = load_object(OBJECT_FILES / "elbow.xml")
    made = with_place(cube)
    for places in (elbow.corner_pos[:6], cube.corner_pos[:4], np.tile(elbow.corner_pos, (3, 1))):
        shares = tuple(replace(made.place.corners[0], place=tuple(place.tolist())) for place in places)
        some = replace(made, findings=(), place=replace(made.place, corners=shares, corners_left=()))
        assert_legible(gap_by_corner(some))


def test_the_page_has_them_in_its_details(cube: ObjectModel) -> None:
    made = with_place(cube)
    page = report_html(made, {name: as_png(figure) for name, figure in details_of(made).items()})
    assert page.index("The gap by corner of the object") > page.index("Details")
    assert page.count("data:image/png") == 2
    assert "the simulator lacks a force along the path that depends on the horizontal speed" in page
    plain = report_html(diagnosis(cube), {})
    assert "The gap by corner" not in plain


def test_a_diagnosis_without_a_place_has_no_such_figures(cube: ObjectModel) -> None:
    assert details_of(diagnosis(cube)) == {}
