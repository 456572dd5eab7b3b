"""A diagnosis as HTML: gap.html and a notebook's cell, without scripts and without anything from the network.

The templates hold the page and its sentences; this module gathers what they show.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from tossid.diagnosis.findings import FOUND, Interval
from tossid.diagnosis.report import units, words
from tossid.diagnosis.report.card import ENGINES, card_of
from tossid.diagnosis.report.film import SLOWER, worst_toss
from tossid.diagnosis.report.registry import REPORT_FIGURES
from tossid.diagnosis.result import Diagnosis
from tossid.motion.sessions import session_words

COLORS = {
    "identified": "#009E73",
    "confusable": "#C28E00",
    "candidate": "#7B4B94",
    "not_supported": "#b4b9c0",
    "not_identifiable": "#e3e5e8",
}
"""Of each verdict of an effect; the page writes the verdict beside its colour."""

_TEMPLATES = Environment(
    loader=PackageLoader("tossid.diagnosis.report"), autoescape=True, trim_blocks=True, undefined=StrictUndefined
)
_TEMPLATES.filters |= {
    "unbroken": lambda text: re.sub(r"(?<=\d) (?=(?!to\b)[^\W\d_]|%)", "\u00a0", text),  # a number and its unit
    "listed": units.listed,
    "percent": units.percent,
    "percent_span": units.percent_span,
    "place": units.place_of,
    "session": session_words,
    "short": units.short,
    "size_of_change": units.size_of_change,
    "span": units.span,
    "quantity": units.quantity,
    "parameter": units.parameter,
    "state": lambda name: words.state_words(name)[0],
    "wrench": words.wrench_words,
    "likelier": words.times_likelier,
    "release": words.release_words,
    "over_order": words.over_order_words,
    "estimates": words.estimates,
    "stated": lambda key, finding: words.stated_words(finding.name, key, finding.stated[key]),
    "interval": lambda json: Interval(json["value"], *json["ci95"]),
}


def report_html(diagnosis: Diagnosis, figures: Mapping[str, bytes]) -> str:
    """The page as HTML.

    Args:
        diagnosis: What was found.
        figures: PNGs by name (of `report_figures`), in the order in which they are read.
    """
    return _TEMPLATES.get_template("gap.html.j2").render(_content(diagnosis, figures))


def report_notebook(diagnosis: Diagnosis, figures: Mapping[str, bytes]) -> str:
    """The same content for a cell of a notebook, with its own style, which does not reach the rest of the notebook.

    Args:
        diagnosis: What was found.
        figures: As `report_html` takes them.
    """
    return _TEMPLATES.get_template("body.html.j2").render(_content(diagnosis, figures))


def _content(diagnosis: Diagnosis, figures: Mapping[str, bytes]) -> dict[str, Any]:
    """What the templates show."""
    sections: dict[str, list[dict[str, str]]] = {}
    for name, png in figures.items():
        known = REPORT_FIGURES.get(name)
        shown = {"png": base64.b64encode(png).decode(), "alt": known.alt if known else name}
        sections.setdefault(known.detail if known else "", []).append({**shown, "note": known.note if known else ""})
    verdicts = dict.fromkeys(finding.verdict for finding in diagnosis.findings)
    corners = [corner for corner in diagnosis.place.corners if corner.frames]
    return {
        "d": diagnosis,
        "card": card_of(diagnosis),
        "film": worst_toss(diagnosis),
        "slower": SLOWER,
        "figures": sections.pop("", []),
        "sections": sections,
        "engine": ENGINES[diagnosis.brings.engine],
        "shown": [f for f in diagnosis.findings if f.verdict in FOUND],
        "hidden": [f.name for f in diagnosis.findings if f.verdict == "not_identifiable"],
        "colors": COLORS,
        "verdicts": [verdict for verdict in COLORS if verdict in verdicts],
        "worst_corner": max(corners, key=lambda corner: corner.per_frame or 0.0, default=None),
        "patch": _patch(diagnosis.patch),
    }


def _patch(patch: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """gap.json's "patch" as far as it changes anything."""
    if not patch or not (patch["changes"] or patch["recording"] or patch["not_expressed"]):
        return None
    keys = [
        f"{key} {values['before']:.4g} → {values['after']:.4g}"
        for key, values in patch["keys"].items()
        if isinstance(values["before"], float)
    ]
    run = patch.get("rerun") or {}
    return {**patch, "keys": keys, "problem": run.get("problem"), "rerun": run if "engine" in run else None}
