"""A diagnosis shows itself in a few lines and in a notebook, and saves a whole report."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

from tests.diagnosis.by_hand import diagnosis, with_place, without_effects
from tossid.diagnosis.report import REPORT_FIGURES, card_of
from tossid.diagnosis.simulators import nominal
from tossid.objects import ObjectModel


def test_it_says_what_to_change_and_what_that_brings(cube: ObjectModel) -> None:
    made = diagnosis(cube)
    assert repr(made) == str(card_of(made))
    assert "friction: mu 0.18 → 0.3000" in repr(made)
    assert len(repr(made).splitlines()) <= 10
    assert repr(without_effects(cube, "no_gap")).startswith("No gap beyond the measurement noise\n")


def test_a_notebook_shows_the_card_figures_and_tables(cube: ObjectModel) -> None:
    found = with_place(cube)
    html = found._repr_html_()
    first, rest = html.split("<details", 1)
    assert "friction: mu 0.18 → 0.3000 (95\u00a0%: 0.2970 to 0.3030)" in first
    shown = {name for name, each in REPORT_FIGURES.items() if each.applies(found)}
    folded = {name for name in shown if REPORT_FIGURES[name].detail}
    assert first.count("data:image/png") == len(shown - folded) == 1
    assert rest.count("data:image/png") == len(folded) == 4
    assert "All effects" in html


def test_the_style_of_a_cell_does_not_reach_the_notebook(cube: ObjectModel) -> None:
    html = diagnosis(cube)._repr_html_()
    style = re.sub(r"@media [^{]*\{", "", html[html.index("<style>") + 7 : html.index("</style>")])
    rules = [rule for rule in style.split("}") if rule.strip()]
    assert all(
        selector.strip().startswith(".tossid-gap") for rule in rules for selector in rule.split("{")[0].split(",")
    )
    assert "<html" not in html
    assert not re.search(r"https?://|<script|<link|@import|url\(", html)


def test_a_saved_report_is_whole(cube: ObjectModel, tmp_path: Path) -> None:
    patch = {"mjcf": "<mujoco/>", "keys": {}, "changes": [], "recording": {}, "not_expressed": {}, "rerun": None}
    made = replace(
        diagnosis(cube),
        simulator=nominal(cube),
        tosses_of="mine.h5, test split",
        data={"object": "cube"},
        next_toss={"release": None, "reason": "none is needed"},
        patch=patch,
        remarks=("Tosses left out: one.",),
    )
    folder = made.save(tmp_path / "new" / "gap")
    gap = json.loads((folder / "gap.json").read_text())
    assert gap["schema"] == "tossid.gap/1"
    assert gap["explanation"]["effects"] == ["friction"]
    assert gap["simulator"] == {"sim": "nominal", "about": "the stated 'cube', rigid", "run": None, "reads": ""}
    assert gap["data"] == {"object": "cube"}
    assert gap["remarks"] == ["Tosses left out: one."]
    assert (folder / "patched.xml").read_text() == "<mujoco/>"
    page = (folder / "gap.html").read_text()
    assert "mine.h5, test split" in page
    assert "Tosses left out: one." in page
    figures = {path.stem for path in (folder / "figures").glob("*.png")}
    assert figures == {name for name, each in REPORT_FIGURES.items() if each.applies(made)}


def test_what_was_not_computed_is_not_in_the_json(cube: ObjectModel) -> None:
    assert {"next_toss", "patch", "simulator", "data"}.isdisjoint(diagnosis(cube).as_json())
