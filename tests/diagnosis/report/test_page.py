"""The page says what it said when it was read, has the card first and needs nothing beside itself."""

from __future__ import annotations

import base64
import json
import math
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from html import escape, unescape
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from tests.diagnosis.by_hand import diagnosis, with_place
from tests.diagnosis.report.reports import NO_PATCH, PATCH, reports
from tests.diagnosis.report.test_figures import a_slide, with_film
from tests.golden import assert_as_read
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.report import REPORT_FIGURES, card_of, report_figure, report_html, report_pngs
from tossid.diagnosis.report.units import (
    in_units,
    parameter,
    percent,
    percent_span,
    place_of,
    quantity,
    short,
    size_of_change,
    span,
)
from tossid.diagnosis.report.words import state_words, times_likelier, wrench_words
from tossid.diagnosis.result import Diagnosis
from tossid.diagnosis.simulators import nominal
from tossid.evaluation.figures.style import new_figure
from tossid.objects import ObjectModel

REPORTS = reports()
GOLDEN = Path(__file__).parent / "golden"


def text_of(page: str) -> str:
    """The text in reading order, a line for each paragraph, row or cell; every tag is closed."""
    for tag in set(re.findall(r"</(\w+)>", page)):
        assert len(re.findall(rf"<{tag}\b", page)) == page.count(f"</{tag}>"), tag
    shown = re.sub(r"<style>.*?</style>", "", page, flags=re.DOTALL).replace("\n", " ")
    lines = re.sub(r"</(?:p|li|tr|dt|dd|h\d|summary|pre|figcaption|div)>", "\n", shown)
    words = (" ".join(unescape(re.sub(r"<[^>]*>", " ", line)).split()) for line in lines.split("\n"))
    return "\n".join(line for line in words if line) + "\n"


@pytest.mark.parametrize("name", REPORTS)
def test_the_page_says_what_was_read(name: str) -> None:
    made = REPORTS[name]
    details = [each.name for each in REPORT_FIGURES.values() if each.applies(made)]
    assert_as_read(
        GOLDEN / f"{name.replace(' ', '-')}.txt", text_of(report_html(made, dict.fromkeys(details, b"a picture")))
    )


@pytest.fixture(scope="module")
def pictures(cube: ObjectModel) -> dict[str, bytes]:
    return report_pngs(with_place(cube))


def test_the_page_is_whole_and_asks_nothing_of_the_network(cube: ObjectModel, pictures: dict[str, bytes]) -> None:
    found = replace(with_place(cube), tosses_of="a & b <c>")
    text = report_html(found, pictures)
    assert not re.search(r"https?://|<script|<link|@import|url\(", text)
    shown = [each for each in REPORT_FIGURES.values() if each.applies(found)]
    assert [each.name for each in shown] == ["gap_tosses", "gap_where", "gap_when", "gap_wrench", "gap_corners"]
    pictures = re.findall(r'<img [^>]*src="data:image/png;base64,([^"]*)"', text)
    assert len(pictures) == text.count("<img") == len(shown)
    assert all(base64.b64decode(data).startswith(b"\x89PNG") for data in pictures)
    assert {unescape(alt) for alt in re.findall(r'alt="([^"]*)"', text)} == {each.alt for each in shown}
    assert 'name="viewport"' in text  # a phone's width


def test_the_card_comes_first_and_the_rest_is_folded(cube: ObjectModel) -> None:
    found = diagnosis(cube)
    page, said = report_html(found, {}), card_of(found)
    first, details = text_of(page).split("Details", 1)[0].replace("\u00a0", " "), page.split("<h2>Details</h2>")[1]
    for line in (said.headline, *said.rows, *(line for lines in said.rows.values() for line in lines)):
        assert line in " ".join(first.split()), line
    assert details.count("<details>") == 4
    assert "details-content" in page  # they open in print


def test_no_interval_is_one_value_and_nothing_is_unknown() -> None:
    text = text_of(report_html(REPORTS["by place"], {}))
    assert not re.search(r"([\d.]+) ?[^ ]* \(\1 to \1\)|unknown|nan", text)


NAN, INF, DEGREE = float("nan"), float("inf"), math.pi / 180


@pytest.mark.parametrize(
    ("found", "text"),
    [
        (quantity("stiffness_npm", 33000.0), "33\u202f000 N/m"),
        (quantity("delay_s", 0.003), "3 ms"),
        (quantity("x_m", -3.6e-15), "0 mm"),  # what rounding leaves of zero
        (in_units("y_rad", Interval(DEGREE, DEGREE / 2, 1.5 * DEGREE)), "1.0 deg (0.5 to 1.5)"),
        (in_units("e", Interval(0.25, 0.2, 0.3), level="95 %: "), "0.25 (95 %: 0.20 to 0.30)"),
        (short(-3.6e-15), "0"),
        (short(NAN), "unknown"),
        (short(1.5e-7), "1.50e−07"),
        (percent(-0.001), "0 %"),
        (percent(INF), "unknown"),
        (span(Interval(-3.6e-15, -0.1, 0.1)), "0.00 (−0.10 to 0.10)"),
        (span(Interval(7.1, 7.1 - 1e-12, 7.1)), "7.10"),
        (span(Interval(7.1, -INF, INF)), "7.10"),
        (percent_span(Interval(0.0, 0.0, 0.0)), "0 %"),
        (percent_span(Interval(1.2, 0.9, 1.4)), "100 % (90 % to 100 %)"),  # no more than all of it is closed
        (parameter("x_m"), "x"),
        (size_of_change("scale_rel", 0.031), "3.1 %"),
        (place_of((0.0524, -0.0524, 0.0)), "(+52, −52, 0) mm"),
        (state_words("joint_1_rate"), ("joint 1's rate", "rad/s")),
        (state_words("joint_1"), ("joint 1's angle", "rad")),
        (wrench_words("torque_joint_1"), "torque in joint 1"),
        (times_likelier(math.sqrt(2 * math.log(50.0))), "50 times"),
        (times_likelier(12.3), "more than a million times"),
    ],
)
def test_numbers_and_names_are_a_persons(found: object, text: object) -> None:
    assert found == text


# ---------------------------------------------------------------- figures of a user's own


@pytest.fixture
def registry() -> Iterator[None]:
    kept = dict(REPORT_FIGURES)
    yield
    REPORT_FIGURES.clear()
    REPORT_FIGURES.update(kept)


def toy(diagnosis: Diagnosis) -> Figure:
    return new_figure("Toy", "One function, one line.", height=2.0)


@pytest.mark.usefixtures("registry")
def test_a_figure_from_outside_is_on_the_page_where_it_says(cube: ObjectModel) -> None:
    report_figure("toy", alt="A toy & its <words>.")(toy)
    report_figure("detail", alt="", detail="A toy detail", note="A note.")(toy)
    report_figure("among others", alt="", detail="Where the gap is")(toy)
    report_figure("of no gap", alt="", applies=lambda d: d.verdict == "no_gap")(toy)
    found = diagnosis(cube)
    drawn = [name for name, each in REPORT_FIGURES.items() if each.applies(found)]
    assert drawn == ["gap_tosses", "gap_where", "gap_when", "toy", "detail", "among others"]
    page = report_html(found, dict.fromkeys(drawn, b"a picture"))
    assert 'alt="A toy &amp; its &lt;words&gt;."' in page
    assert page.index("A toy &amp;") < page.index("<h2>Details</h2>") < page.index("<summary>A toy detail</summary>")
    detail, where = (page.split(f"<summary>{name}</summary>")[1] for name in ("A toy detail", "Where the gap is"))
    assert "data:image/png;base64," in detail[: detail.index("</details>")]
    assert "A note." in detail[: detail.index("</details>")]
    assert where[: where.index("</details>")].count("data:image/png") == 3


# ---------------------------------------------------------------- a result shows and saves itself


def test_a_notebook_shows_the_card_figures_and_tables_in_its_own_style(cube: ObjectModel) -> None:
    found = with_place(cube)
    assert repr(found) == str(card_of(found))
    assert "  Change        friction: mu 0.18 → 0.3000 (95 %: 0.2970 to 0.3030)" in repr(found).splitlines()
    html = found._repr_html_()
    first, rest = html.split("<details", 1)
    assert "friction: mu 0.18 → 0.3000 (95\u00a0%: 0.2970 to 0.3030)" in first
    assert (first.count("data:image/png"), rest.count("data:image/png")) == (1, 4)
    assert "All effects" in html
    style = re.sub(r"@media [^{]*\{", "", html[html.index("<style>") + 7 : html.index("</style>")])
    selectors = [each for rule in style.split("}") if rule.strip() for each in rule.split("{")[0].split(",")]
    assert all(each.strip().startswith(".tossid-gap") for each in selectors)
    assert not re.search(r"<html|https?://|<script|<link|@import|url\(", html)


def test_a_saved_report_is_whole(cube: ObjectModel, tmp_path: Path) -> None:
    made = replace(
        diagnosis(cube),
        simulator=nominal(cube),
        tosses_of="mine.h5, test split",
        data={"object": "cube"},
        next_toss={"release": None, "reason": "none is needed"},
        patch={**NO_PATCH, "mjcf": "<mujoco/>"},
        remarks=("Tosses left out: one.",),
    )
    folder = made.save(tmp_path / "new" / "gap")
    saved = json.loads((folder / "gap.json").read_text())
    assert saved["schema"] == "tossid.gap/1"
    assert saved["explanation"]["effects"] == ["friction"]
    assert saved["simulator"] == {"sim": "nominal", "about": "the stated 'cube', rigid", "run": None, "reads": ""}
    assert (saved["data"], saved["remarks"]) == ({"object": "cube"}, ["Tosses left out: one."])
    assert (folder / "patched.xml").read_text() == "<mujoco/>"
    page = (folder / "gap.html").read_text()
    assert "mine.h5, test split" in page
    figures = {path.stem for path in (folder / "figures").glob("*.png")}
    assert figures == {name for name, each in REPORT_FIGURES.items() if each.applies(made)}
    # what was not computed is not in the JSON
    assert {"next_toss", "patch", "simulator", "data"}.isdisjoint(diagnosis(cube).as_json())


# ---------------------------------------------------------------- in a browser: on a desk, a tablet, a phone and paper


CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

in_browser = pytest.mark.skipif(CHROMIUM is None, reason="no chromium is installed to open the page in")
WIDTHS, HEIGHT = (1280, 800, 400), 800

MEASURE = """
<script>
onload = () => {
  const found = [...document.querySelectorAll("iframe")].map(frame => {
    const page = frame.contentDocument, width = page.documentElement.clientWidth;
    page.querySelectorAll("details").forEach(each => each.open = true);
    const all = [...page.querySelectorAll("body *")].filter(each => !each.closest("style, .wide, pre > *, svg *"));
    const box = each => page.querySelector(each).getBoundingClientRect();
    return {
      width, scroll: page.documentElement.scrollWidth,
      wider: all.filter(each => each.getBoundingClientRect().right > width + 1)
        .map(each => each.outerHTML.slice(0, 60)),
      smallest: Math.min(...all.filter(each => each.textContent.trim() && !each.closest("svg"))
        .map(each => parseFloat(page.defaultView.getComputedStyle(each).fontSize))),
      tables: [...page.querySelectorAll("table")].every(each => each.closest(".wide")),
      film: box("svg[aria-label]").width, card: box(".card").top, changes: box(".card .main").bottom,
      hidden: [...page.querySelectorAll("svg[aria-label]")].filter(each => !each.checkVisibility()).length,
      stills: [...page.querySelectorAll("svg svg")].filter(each => each.checkVisibility()).length,
    };
  });
  document.title = JSON.stringify(found);
};
</script>
"""


@pytest.fixture(scope="module")
def page(cube: ObjectModel, pictures: dict[str, bytes]) -> str:
    found = with_film(replace(with_place(cube), patch={**PATCH, "mjcf": "<mujoco>\n" + 60 * "  <a/>\n"}), a_slide())
    return report_html(found, pictures)


def chromium(folder: Path, *options: str) -> str:
    plain = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={folder / 'own'}"]
    run = subprocess.run([CHROMIUM, *plain, *options], capture_output=True, text=True, timeout=240, check=True)
    return run.stdout


def measured(page: str, tmp_path: Path) -> list[dict[str, Any]]:
    frames = "".join(
        f'<iframe width="{width}" height="{HEIGHT}" style="border: 0" srcdoc="{escape(page)}"></iframe>'
        for width in WIDTHS
    )
    harness = tmp_path / "harness.html"
    harness.write_text(f"<!doctype html><meta charset=utf-8>{MEASURE}{frames}", encoding="utf-8")
    dom = chromium(tmp_path, "--dump-dom", harness.as_uri())
    title = re.search(r"<title>(.*?)</title>", dom, re.DOTALL)
    found: list[dict[str, Any]] = json.loads(unescape(title[1]))
    return found


@in_browser
def test_nothing_is_wider_than_the_page_and_the_card_is_on_the_first_screen(page: str, tmp_path: Path) -> None:
    for width, found in zip(WIDTHS, measured(page, tmp_path), strict=True):
        assert found["width"] == width
        assert found["scroll"] <= width
        assert found["wider"] == []
        assert found["tables"], "every table scrolls within its box"
        assert found["smallest"] >= 12
        assert found["film"] > 0.35 * width or width > 1000
        assert found["card"] < found["changes"] < HEIGHT
        assert (found["hidden"], found["stills"]) == (2, 0), "the stills are for paper"
