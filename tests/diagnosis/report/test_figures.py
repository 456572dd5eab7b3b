"""The figures and films of the report can be read, and draw the diagnosis's own numbers."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.diagnosis.by_hand import diagnosis, gap, with_place, without_effects
from tests.diagnosis.report.reports import stepped
from tests.evaluation.figures.reading import assert_legible, words
from tests.models.made import DT
from tossid.diagnosis.findings import Interval, WholeToss
from tossid.diagnosis.report import REPORT_FIGURES, report_figures
from tossid.diagnosis.report.figures import gap_by_part, gap_over_time, whole_tosses
from tossid.diagnosis.report.film import HOLD, SLOWER, STILLS, worst_toss
from tossid.diagnosis.report.localisation_figures import CORNERS, WRENCH, gap_by_corner, wrench_over_state
from tossid.diagnosis.report.order_figures import gap_over_order, toss_excess
from tossid.diagnosis.report.units import place_of
from tossid.diagnosis.result import Diagnosis
from tossid.objects import OBJECT_FILES, ObjectModel, load_object


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
    wild = dict.fromkeys(found.gap.by_phase, Interval(-0.6, -4.3, 4.8))  # as of a gap that is none
    for figure in (*report_figures(found).values(), gap_by_part(replace(found, gap=replace(found.gap, by_phase=wild)))):
        assert_legible(figure)


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


@pytest.mark.parametrize("draw", [whole_tosses, gap_by_part, gap_over_time])
def test_pictures_are_legible(cube: ObjectModel, draw: Callable[[Diagnosis], Figure]) -> None:
    assert_legible(draw(diagnosis(cube, n=60)))
    assert_legible(draw(without_effects(cube, "unexplained", n=6)))


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
    for places in (cube.corner_pos[:4], np.tile(elbow.corner_pos, (3, 1))):
        shares = tuple(replace(made.place.corners[0], place=tuple(place.tolist())) for place in places)
        some = replace(made, findings=(), place=replace(made.place, corners=shares, corners_left=()))
        assert_legible(gap_by_corner(some))


def test_each_toss_has_its_excess_before_and_after_and_changes_are_lines() -> None:
    found = stepped()
    figure = gap_over_order(found)
    assert_legible(figure)
    before, after, *changes = figure.axes[0].lines
    np.testing.assert_allclose(before.get_ydata(), toss_excess(found.gap, 20))
    np.testing.assert_allclose(after.get_ydata(), toss_excess(found.left, 20))
    assert [float(line.get_xdata()[0]) for line in changes] == [9.5, 11.5]
    own = found.gap.frames[found.gap.frames[:, 0] == 3, 3]
    np.testing.assert_allclose(toss_excess(found.gap, 20)[3], own.mean())


def a_slide(n: int = 50) -> WholeToss:
    """A cube, turned by 0.6 rad about the vertical, that slides along x, predicted 4 mm and 1 mm too far along y."""
    measured = np.tile([0.0, 0.0, 0.0524, np.cos(0.3), 0.0, 0.0, np.sin(0.3)], (n, 1))
    measured[:, 0] = np.linspace(0.0, 0.4, n)
    before, after = (measured + np.array([0, off, 0, 0, 0, 0, 0]) for off in (0.004, 0.001))
    return WholeToss("<7>", np.arange(n) * DT, measured, before, after)


def with_film(found: Diagnosis, worst: WholeToss) -> Diagnosis:
    return replace(found, brings=replace(found.brings, worst=worst))


def numbers(path: str) -> np.ndarray:
    return np.array(re.findall(r"-?\d+", path), dtype=float).reshape(-1, 2)


def test_the_film_is_svg_without_a_script_and_says_how_far_off_it_is(cube: ObjectModel) -> None:
    panels = worst_toss(with_film(diagnosis(cube), a_slide()))
    assert [panel.label for panel in panels] == ["before", "after"]
    assert [panel.position_mm for panel in panels] == pytest.approx([4.0, 1.0])
    for panel in panels:
        film, stills = ElementTree.fromstring(panel.moving), ElementTree.fromstring(panel.stills)
        assert film.attrib["aria-label"].startswith("Toss <7>: ")
        moves = film.findall("./path/animate")
        for move in moves:
            times = np.array(move.attrib["keyTimes"].split(";"), dtype=float)
            assert len(times) == len(move.attrib["values"].split(";")) == 50
            assert times[0] == 0.0
            assert (np.diff(times) > 0).all()
            # the last picture stays: until then the film is so much slower than the toss
            length = float(move.attrib["dur"].removesuffix("s"))
            assert length == pytest.approx(SLOWER * 49 * DT + HOLD, abs=0.05)
            assert times[-1] * length == pytest.approx(SLOWER * 49 * DT, abs=0.05)
        assert {path.attrib["class"] for path in film.findall("path") if len(path)} == {
            f"{name} {part}" for name in ("measured", panel.label) for part in ("body", "far", "near")
        }
        assert len(stills.findall("svg")) == STILLS
        assert not stills.findall(".//animate")


def test_a_cube_has_nine_edges_in_front_and_moves_to_the_right(cube: ObjectModel) -> None:
    film = ElementTree.fromstring(worst_toss(with_film(diagnosis(cube), a_slide()))[0].moving)
    near = next(path for path in film.findall("path") if path.attrib["class"] == "measured near")
    values = [numbers(value) for value in near[0].attrib["values"].split(";")]
    assert {len(value) for value in values} == {2 * 9}
    right = np.array([value[:, 0].mean() for value in values])
    assert (np.diff(right) >= 0).all()
    width, height = map(float, film.attrib["viewBox"].split()[2:])
    assert (np.concatenate(values) >= 0).all()
    assert (np.concatenate(values) <= [width, height]).all()


def test_without_changes_there_is_one_prediction_and_without_a_rollout_no_film(cube: ObjectModel) -> None:
    nothing = without_effects(cube, "unexplained")
    assert [panel.label for panel in worst_toss(with_film(nothing, a_slide()))] == ["before"]
    assert worst_toss(nothing) == []


def test_a_prediction_that_leaves_the_picture_does_not_shrink_it(cube: ObjectModel) -> None:
    slide = a_slide()
    far = slide.before.copy()
    far[-1, :3] += 100.0
    film = ElementTree.fromstring(worst_toss(with_film(diagnosis(cube), replace(slide, before=far)))[0].moving)
    body = next(path for path in film.findall("path") if path.attrib["class"] == "measured body")
    assert np.ptp(numbers(body.attrib["d"])[:, 0]) > 50
