"""The figures and films of the report can be read, and draw the diagnosis's own numbers."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.diagnosis.by_hand import STATED, diagnosis, gap, with_place, without_effects
from tests.diagnosis.report.reports import stepped
from tests.evaluation.figures.reading import assert_legible, described
from tests.golden import assert_as_read
from tests.models.made import DT
from tossid.diagnosis.findings import Interval, WholeToss
from tossid.diagnosis.report import report_figures
from tossid.diagnosis.report.film import HOLD, SLOWER, STILLS, worst_toss
from tossid.diagnosis.result import Diagnosis
from tossid.objects import OBJECT_FILES, ObjectModel, load_object


def drawn(cube: ObjectModel) -> dict[str, Diagnosis]:
    """What is hard to draw: many tosses, few, no frames of a toss and no contact, wild shares, other corners."""
    flying, place = gap(1.0, n=20), with_place(cube)
    rows = flying.frames[flying.frames[:, 0] != 3]
    rows[:, 2] = 1
    no_contact = replace(
        without_effects(cube, "no_gap"), gap=replace(flying, frames=rows), left=replace(flying, frames=rows)
    )
    wild = dict.fromkeys(flying.by_phase, Interval(-0.6, -4.3, 4.8))  # as of a gap that is none
    elbow = load_object(OBJECT_FILES / "elbow.xml")

    def of_corners(places: np.ndarray) -> Diagnosis:
        corners = tuple(replace(place.place.corners[0], place=tuple(each.tolist())) for each in places)
        return replace(place, findings=(), place=replace(place.place, corners=corners, wrench_left=(), corners_left=()))

    return {
        "many": diagnosis(cube, n=60),
        "few": without_effects(cube, "unexplained", n=6),
        "no contact": no_contact,
        "wild": replace(no_contact, gap=replace(no_contact.gap, by_phase=wild)),
        "place": place,
        "four corners": of_corners(cube.corner_pos[:4]),
        "links": of_corners(np.tile(elbow.corner_pos, (3, 1))),
        "changes": stepped(),
    }


DRAWN = drawn(STATED.object)


@pytest.mark.parametrize("name", DRAWN)
def test_pictures_show_what_was_read_and_are_legible(name: str) -> None:
    figures = report_figures(DRAWN[name])
    shown = "".join(f"#### {key}\n{described(figure)}" for key, figure in figures.items())
    assert_as_read(Path(__file__).parent / "golden" / f"pictures-{name.replace(' ', '-')}.txt", shown)
    for key, figure in figures.items():
        if key != "gap_recording":  # whose panels share their axes' labels
            assert_legible(figure)


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
