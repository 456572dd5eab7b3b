"""gap.html in a browser: nothing is wider than the page on a desk, a tablet or a phone, and paper has all of it."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.diagnosis.by_hand import with_place
from tests.diagnosis.report.test_film import a_slide, with_film
from tests.diagnosis.report.test_page import PATCH
from tossid.diagnosis.report import report_html, report_pngs
from tossid.diagnosis.report.film import STILLS
from tossid.objects import ObjectModel

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium is installed to open the page in")
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
def page(cube: ObjectModel) -> str:
    found = with_film(replace(with_place(cube), patch={**PATCH, "mjcf": "<mujoco>\n" + 60 * "  <a/>\n"}), a_slide())
    return report_html(found, report_pngs(found))


def chromium(folder: Path, *options: str) -> str:
    assert CHROMIUM is not None
    plain = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={folder / 'own'}"]
    run = subprocess.run([CHROMIUM, *plain, *options], capture_output=True, text=True, timeout=240, check=True)
    return run.stdout


def measured(page: str, tmp_path: Path, *options: str) -> list[dict[str, Any]]:
    frames = "".join(
        f'<iframe width="{width}" height="{HEIGHT}" style="border: 0" srcdoc="{html.escape(page)}"></iframe>'
        for width in WIDTHS
    )
    harness = tmp_path / "harness.html"
    harness.write_text(f"<!doctype html><meta charset=utf-8>{MEASURE}{frames}", encoding="utf-8")
    dom = chromium(tmp_path, *options, "--dump-dom", harness.as_uri())
    title = re.search(r"<title>(.*?)</title>", dom, re.DOTALL)
    assert title is not None
    found: list[dict[str, Any]] = json.loads(html.unescape(title[1]))
    return found


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


def test_readers_who_want_no_motion_see_all_stills(page: str, tmp_path: Path) -> None:
    for found in measured(page, tmp_path, "--force-prefers-reduced-motion"):
        assert (found["hidden"], found["stills"]) == (2, 2 * STILLS)


def test_paper_has_the_details_and_the_patched_file(page: str, tmp_path: Path) -> None:
    def pages(text: str) -> int:
        source, out = tmp_path / "page.html", tmp_path / "page.pdf"
        source.write_text(text, encoding="utf-8")
        chromium(tmp_path, "--no-pdf-header-footer", f"--print-to-pdf={out}", source.as_uri())
        return len(re.findall(rb"/Type /Page\b", out.read_bytes()))

    folded = page.replace("details::details-content", "nothing")
    everything = re.sub(r"<details>", "<details open>", folded)
    assert pages(folded) < pages(everything) == pages(page)
