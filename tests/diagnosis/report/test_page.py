"""The page has the card first; it needs nothing beside itself; its details hold what is in gap.json, in units."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

from tests.diagnosis.by_hand import diagnosis, with_place, without_effects
from tests.diagnosis.report.test_words import RELEASE
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.learned import LearnedForces, StandsFor
from tossid.diagnosis.localisation.disagreement import SolverDisagreement
from tossid.diagnosis.localisation.noise import MeasuredNoise
from tossid.diagnosis.localisation.witnesses import Witness
from tossid.diagnosis.plane import Plane
from tossid.diagnosis.report import REPORT_FIGURES, card_of, report_html, report_pngs
from tossid.diagnosis.report.card import VERDICTS
from tossid.diagnosis.result import Diagnosis, Interruption, Unseen
from tossid.objects import ObjectModel


class Page(HTMLParser):
    """Tags with their attributes, and the text in reading order, spaces and line breaks as one space."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(text)
        self.text = " ".join(self.text.split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.text += data + " "


def page_of(made: Diagnosis, **changes: Any) -> Page:
    page = Page(report_html(replace(made, **changes), {}))
    assert page.open == []
    return page


def test_the_page_is_whole_and_asks_nothing_of_the_network(cube: ObjectModel) -> None:
    found = replace(with_place(cube), tosses_of="a & b <c>")
    text = report_html(found, report_pngs(found))
    page = Page(text)
    assert page.open == []
    assert not re.search(r"https?://|<script|<link|@import|url\(", text)
    pictures = [attrs for tag, attrs in page.tags if tag == "img"]
    shown = [each for each in REPORT_FIGURES.values() if each.applies(found)]
    assert [each.name for each in shown] == ["gap_tosses", "gap_where", "gap_when", "gap_wrench", "gap_corners"]
    assert {attrs["alt"] for attrs in pictures} == {each.alt for each in shown}
    for attrs in pictures:
        head, _, data = (attrs["src"] or "").partition(",")
        assert head == "data:image/png;base64"
        assert base64.b64decode(data).startswith(b"\x89PNG")
    assert "a & b <c>" in page.text
    assert 'name="viewport"' in text  # a phone's width


def test_the_card_comes_first_and_the_rest_is_folded(cube: ObjectModel) -> None:
    found = diagnosis(cube)
    text = report_html(found, {})
    page = Page(text)
    said = card_of(found)
    first = page.text[: page.text.index("Details")].replace("\u00a0", " ")
    for line in (said.headline, *said.rows, *(line for lines in said.rows.values() for line in lines)):
        assert line in first, line
    details = text[text.index("<h2>Details</h2>") :]
    assert details.count("<details>") == 4
    assert "details-content" in text  # they open in print


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_has_a_page(cube: ObjectModel, verdict: str) -> None:
    interruption = Interruption("the search") if verdict == "incomplete" else None
    for made in (diagnosis(cube), without_effects(cube, "no_gap")):
        page = page_of(made, verdict=verdict, interruption=interruption)
        assert VERDICTS[verdict] in page.text


def test_no_interval_is_one_value_and_nothing_is_unknown(cube: ObjectModel) -> None:
    text = page_of(with_place(cube)).text
    assert not re.search(r"([\d.]+) ?[^ ]* \(\1 to \1\)", text)
    assert "unknown" not in text
    assert "nan" not in text


def test_details_hold_every_effect_with_its_smallest_detectable_size(cube: ObjectModel) -> None:
    found = without_effects(cube, "no_gap")
    page = page_of(found)
    for f in found.findings:
        assert f.name in page.text
    text = page.text.replace("\u00a0", " ")
    assert "g 0.050 m/s²" in text
    assert "x 1.0 mm" in text  # the step of com_offset is 1e-3 m
    assert "not supported : not found, and these tosses would have shown it" in page.text
    assert "candidate :" not in page.text  # which does not occur
    table = page_of(diagnosis(cube)).text.replace("\u00a0", " ")
    assert (
        "confusable, or cohesion, named in 97 % mu 0.3000 (0.2970 to 0.3030) mu 0.18 12 % of the width, 5.2 deg"
        in table
    )
    assert "Not identifiable: magnus." in table


def test_millimetres_stand_beside_standard_deviations(cube: ObjectModel) -> None:
    page = page_of(diagnosis(cube), disagreement=SolverDisagreement(4.0, 0.9, 0.7))
    for piece in (
        "predictions are off by 5.0 (4.5 to 5.5) standard deviations of noise (1.0 mm, 0.50 deg)",
        "1.20 (1.08 to 1.32) standard deviations of noise (0.24 mm, 0.12 deg) are left",
        "close 93 % (85 % to 98 %) of the gap above the noise , on tosses that took no part",
        "a gap of 4.00 standard deviations (in contact up to 0.90 mm and 0.70 deg, in 95 % of windows)",
    ):
        assert piece.replace(" ,", ",") in page.text, piece


def test_whole_tosses_have_their_intervals(cube: ObjectModel) -> None:
    found = diagnosis(cube)
    before, after = found.brings.position_mm()
    page = page_of(found)
    for error in (before, after):
        assert f"{error.value:.3f}"[:4] in page.text
    assert "position error [mm] 13.1 (12.5 to 13.7) 0.314 (0.299 to 0.329)" in page.text


PATCH = {
    "keys": {"object.friction": {"before": 0.18, "after": 0.3}},
    "changes": [
        {"effect": "friction", "where": "geom 'a&b'", "attribute": "friction", "before": "0.18", "after": "0.3",
         "exact": True, "note": ""},
        {"effect": "linear_drag", "where": "option", "attribute": "viscosity", "before": "0", "after": "1",
         "exact": False, "note": ""},
    ],
    "recording": {"length_scale": "divide recorded lengths by 1.01"},
    "not_expressed": {"magnus": "MuJoCo has it for ellipsoids only"},
    "mjcf": "<mujoco/>",
    "rerun": {
        "engine": "MuJoCo 4", "on": "tosses that took part in the fit", "n_tosses": 20, "not_in_it": ["magnus"],
        "position_error_pct": {"before": {"value": 5.8, "ci95": [5.7, 5.9]},
                               "after": {"value": 0.3, "ci95": [0.2, 0.4]}},
        "rotation_error_deg": {w: {"value": 1.0, "ci95": [0.9, 1.1]} for w in ("before", "after")},
    },
}  # fmt: skip


def test_the_patch_is_on_the_page_with_its_rerun(cube: ObjectModel) -> None:
    page = page_of(diagnosis(cube), patch=PATCH)
    for piece in (
        "As keys of tossid: object.friction 0.18 → 0.3.",
        "geom 'a&b'",
        "approximate",
        "length_scale is an error of the recording, not of the simulator. Correct the data: divide recorded lengths",
        "magnus is not in the patch. Reason: MuJoCo has it for ellipsoids only.",
        "run in MuJoCo 4 on 20 tosses that took part in the fit, without magnus, which MJCF cannot express:",
        "position error [% of the width] 5.80 (5.70 to 5.90) 0.30 (0.20 to 0.40)",
        "patched.xml: <mujoco/>",
    ):
        assert piece in page.text, piece


def test_a_patch_that_was_not_run_says_why(cube: ObjectModel) -> None:
    page = page_of(diagnosis(cube), patch={**PATCH, "rerun": {"problem": "it <diverged>"}})
    assert "The patched model was not run in MuJoCo. Reason: it <diverged>." in page.text
    nothing = {"keys": {}, "changes": [], "recording": {}, "not_expressed": {}, "mjcf": None, "rerun": None}
    assert "The patch for your simulator" not in page_of(diagnosis(cube), patch=nothing).text


def test_witnesses_are_listed_beside_those_of_made_tosses(cube: ObjectModel) -> None:
    said = Witness("friction", "friction", 0.18, 0.3, Interval(0.29, 0.2, 0.4), 7, Interval(0.31, 0.3, 0.32), True)
    page = page_of(diagnosis(cube), witnesses=(said,))
    assert "friction 0.180 0.300 0.310 (0.300 to 0.320) 0.29 (0.20 to 0.40) (contradicts) 7" in page.text
    assert "without a simulator" not in page_of(diagnosis(cube)).text


def test_the_next_toss_has_its_whole_recipe(cube: ObjectModel) -> None:
    found = {
        "release": RELEASE,
        "between": ["friction", "cohesion"],
        "separation_sd": 12.3,
        "separation_of_tosses_seen_sd": 2.0,
    }
    page = page_of(diagnosis(cube), next_toss=found)
    for piece in (
        "To tell friction from cohesion, release the object with the lowest corner 12 cm above the ground",
        "position x = 0.30 m, y = -0.20 m",
        "velocity (0, 1.50, −0.500) m/s in the world",
        "spin (8.00, 0, 0) rad/s about the body's axes",
        "joints at (0.500), their rates (2.00) per second",
        "more than a million times likelier by this toss, and 7.4 times by one like those recorded",
    ):
        assert piece in page.text, piece
    page = page_of(diagnosis(cube), next_toss={"release": None, "reason": "<none>"})
    assert "None is proposed: <none>." in page.text


def test_what_a_reader_should_know_beside_is_said(cube: ObjectModel) -> None:
    made = diagnosis(cube)
    page = page_of(
        made,
        noise=MeasuredNoise(1.5, 1.0),
        plane=Plane(np.array([0.0, 1.0, 0.0]), (("com_offset", "y_m"), ("magnus", "c_ns2pm")), ("magnus",)),
        learned=LearnedForces(0.5, 0.0, False, (StandsFor("linear_drag", {"c_nspm": 0.05}, 0.9),), 0.1),
        unseen=Unseen(6, Interval(0.9, 0.8, 0.95), made.brings),
        remarks=("Tosses left out: one.",),
        passes=412.0,
    )
    for piece in (
        "In flight, positions have 1.5 times the noise that the dataset states.",
        "All motion lies in one plane, with the normal (0, 1.0, 0). It cannot show y of com_offset, magnus.",
        "k_res is 0.500 m/s² (root mean square). It stands for linear_drag (c 0.05 N s/m, 90 % of its mean square)",
        "On 6 tosses of the test split, which nothing has seen before, all effects close 90 % (80 % to 95 %)",
        "Tosses left out: one.",
        "your simulator was asked 412 times for each window",
    ):
        assert piece in page.text, piece
    assert "rotations have" not in page.text


def test_the_place_of_the_gap_is_said_before_and_after(cube: ObjectModel) -> None:
    found = with_place(cube)
    page = Page(report_html(found, report_pngs(found)))
    for piece in (
        "Before, in flight: the simulator lacks a force along the path that depends on the horizontal speed.",
        "Before, in contact: no residual force or torque is significant",
        "After, in flight: the simulator lacks a force along the path",
        "4.0 times the mean. It has 50 % (25 % to 100 %) of the gap in contact, in 40 frames.",
    ):
        assert piece in page.text, piece
