"""The page says what was found, in words first; it needs nothing beside itself; its pictures can be read."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser

from tests.diagnosis.by_hand import diagnosis, without_effects
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.localisation.witnesses import Witness
from tossid.diagnosis.report import report_html, report_pngs
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


def page_of(model: ObjectModel) -> Page:
    next_toss = {"release": None, "reason": "<none>", "between": ["friction", "cohesion"]}
    found = replace(diagnosis(model), next_toss=next_toss)
    return Page(report_html(found, report_pngs(found)))


def test_the_page_is_whole_and_asks_nothing_of_the_network(cube: ObjectModel) -> None:
    found = replace(diagnosis(cube), tosses_of="a & b <c>")
    text = report_html(found, report_pngs(found))
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


def test_sentences_come_first_and_say_all_that_was_found(cube: ObjectModel) -> None:
    page = page_of(cube)
    first = page.text[: page.text.index("Effects found")]
    for piece in (
        "The gap is explained: friction",
        "5.00 standard deviations",
        "noise alone would give 1.00",
        "while sliding (70 %)",
        "mu = 0.3000 (0.2970 to 0.3030), the simulator has 0.180",
        "93 % (85 % to 98 %)",
        "cannot distinguish friction from cohesion",
        "0.60 % of the width instead of",
        "7 % of the gap remains",
    ):
        assert piece in first, piece
    assert "<none>" in page.text


def test_details_hold_every_effect_with_its_smallest_detectable_size(cube: ObjectModel) -> None:
    found = without_effects(cube, "no_gap")
    page = Page(report_html(found, report_pngs(found)))
    for f in found.findings:
        assert f.name in page.text
    assert "g 0.050 m/s²" in page.text
    assert "x 1.0 mm" in page.text  # the step of com_offset is 1e-3 m


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
        "engine": "MuJoCo 4", "n_tosses": 20, "not_in_it": ["magnus"],
        "gap": {"before": {"value": 5.0, "ci95": [4.0, 6.0]}, "after": {"value": 1.5, "ci95": [1.2, 1.8]}},
        "position_error_pct": {w: {"value": 1.0, "ci95": [0.9, 1.1]} for w in ("before", "after")},
        "rotation_error_deg": {w: {"value": 1.0, "ci95": [0.9, 1.1]} for w in ("before", "after")},
        "gap_closed": {"value": 0.9, "ci95": [0.8, 0.95]},
    },
}  # fmt: skip


def test_the_patch_is_on_the_page_with_its_rerun(cube: ObjectModel) -> None:
    page = Page(report_html(replace(diagnosis(cube), patch=PATCH), {}))
    for piece in (
        "As keys of tossid: object.friction 0.18 → 0.3.",
        "geom 'a&b'",
        "approximate",
        "length_scale is an error of the recording, not of the simulator. Correct the data: divide recorded lengths",
        "magnus is not in the patch. Reason: MuJoCo has it for ellipsoids only.",
        "Run in MuJoCo 4 on 20 tosses, the patched model closes 90 % (80 % to 95 %) of the gap",
        "It lacks magnus, which MJCF cannot express.",
        "gap, short windows [standard deviations of noise] 5.00 (4.00 to 6.00) 1.50 (1.20 to 1.80)",
        "<mujoco/>",
    ):
        assert piece in page.text, piece
    assert page.open == []


def test_a_patch_that_was_not_run_says_why(cube: ObjectModel) -> None:
    patched = replace(diagnosis(cube), patch={**PATCH, "rerun": {"problem": "it <diverged>"}})
    page = Page(report_html(patched, {}))
    assert "The patched model was not run in MuJoCo. Reason: it <diverged>." in page.text


def test_witnesses_are_listed_with_where_they_come_from(cube: ObjectModel) -> None:
    said = Witness("friction", "friction", 0.18, 0.3, Interval(0.29, 0.2, 0.4), 7)
    page = Page(report_html(replace(diagnosis(cube), witnesses=(said,)), {}))
    assert "friction 0.180 0.300 0.290 (0.200 to 0.400) 7" in page.text
    made = replace(said, predicted=Interval(0.31, 0.3, 0.32))
    page = Page(report_html(replace(diagnosis(cube), witnesses=(made,)), {}))
    assert "friction 0.180 0.300 0.310 (0.300 to 0.320) 0.290 (0.200 to 0.400) 7" in page.text
    assert "The values come from the same tosses." in page.text
    assert "without a simulator" not in Page(report_html(diagnosis(cube), {})).text
