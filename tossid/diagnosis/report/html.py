"""A diagnosis as HTML: gap.html and a notebook's cell, without scripts and without anything from the network.

The templates hold the page; this module gathers what they show.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from tossid.diagnosis.findings import Finding, Interval
from tossid.diagnosis.localisation.witnesses import Witness
from tossid.diagnosis.report.figures import VERDICTS, gain_per_toss
from tossid.diagnosis.report.localisation_text import next_toss_words
from tossid.diagnosis.report.registry import REPORT_FIGURES
from tossid.diagnosis.report.text import headline, sentences, stated_values, verdict_of
from tossid.diagnosis.report.units import (
    change,
    closed_share,
    in_units,
    listed,
    parameter,
    percent,
    percent_span,
    quantity,
    short,
    span,
)
from tossid.diagnosis.result import Diagnosis

_TEMPLATES = Environment(
    loader=PackageLoader("tossid.diagnosis.report"), autoescape=True, trim_blocks=True, undefined=StrictUndefined
)


def report_html(diagnosis: Diagnosis, figures: Mapping[str, bytes]) -> str:
    """The page.

    Args:
        diagnosis: What was found.
        figures: PNGs by name (of `report_figures`), in the order in which they are read; those that are registered
            with a heading of their own stand among the details.

    Returns:
        The page as HTML.
    """
    return _TEMPLATES.get_template("gap.html.j2").render(_content(diagnosis, figures))


def report_notebook(diagnosis: Diagnosis, figures: Mapping[str, bytes]) -> str:
    """The same content for a cell of a notebook: effects and main figures first, everything else folded away.

    Args:
        diagnosis: What was found.
        figures: As `report_html` takes them.

    Returns:
        A piece of HTML with its own style, which does not reach the rest of the notebook.
    """
    return _TEMPLATES.get_template("notebook.html.j2").render(_content(diagnosis, figures))


def _content(diagnosis: Diagnosis, figures: Mapping[str, bytes]) -> dict[str, Any]:
    """What the templates show."""
    drawn = [_figure(name, png, diagnosis) for name, png in figures.items()]
    place = diagnosis.steps[0].unseen_position_error_pct
    return {
        "headline": headline(diagnosis),
        "about": _about(diagnosis),
        "sentences": [*sentences(diagnosis), *diagnosis.remarks],
        "figures": [figure for figure in drawn if not figure["detail"]],
        "details": [figure for figure in drawn if figure["detail"]],
        "named": [_named(diagnosis, f) for f in diagnosis.findings if f.headline],
        "next_toss": _next_toss(diagnosis),
        "patch": _patch(diagnosis.patch),
        "effects": [_effect(f) for f in diagnosis.findings],
        "steps": [
            [
                " + ".join(step.effects) or "the simulator as it is",
                span(step.position_error_pct),
                span(step.rotation_error_deg),
            ]
            for step in diagnosis.steps
        ],
        "witnesses": [_witness(each) for each in diagnosis.witnesses],
        "witnesses_from": "the same tosses" if place is None else "tosses that were not used for the fit",
        "shares": [
            [share.name, percent(share.share.value), f"{percent(share.share.low)} to {percent(share.share.high)}"]
            for share in (*diagnosis.gap.by_phase, *diagnosis.gap.by_channel)
        ],
        "lengths": _lengths(diagnosis),
    }


def _about(diagnosis: Diagnosis) -> str:
    """Which simulator, and which tosses."""
    simulator = "" if diagnosis.simulator is None else f"Simulator: {diagnosis.simulator.about}. "
    return f"{simulator}Tosses: {diagnosis.n_tosses}" + (f" of {diagnosis.tosses_of}." if diagnosis.tosses_of else ".")


def _witness(said: Witness) -> list[str | int]:
    """A row of the table of witnesses."""
    made = "" if said.predicted is None else span(said.predicted)
    return [said.quantity, short(said.stated), short(said.found), made, span(said.measured), said.tosses]


def _figure(name: str, png: bytes, diagnosis: Diagnosis) -> dict[str, Any]:
    known = REPORT_FIGURES.get(name)
    return {
        "png": base64.b64encode(png).decode(),
        "alt": known.alt if known else name,
        "detail": known.detail if known else "",
        "text": known.text(diagnosis) if known else (),
        "note": known.note if known else "",
    }


def _named(diagnosis: Diagnosis, finding: Finding) -> dict[str, Any]:
    """An effect that is named, or that may be the cause in place of a named one."""
    stated = stated_values(diagnosis, finding.name)
    return {
        "name": finding.name,
        "color": VERDICTS[finding.verdict][1],
        "says": finding.says,
        "estimates": [f"{parameter(k)} = {in_units(k, value)}" for k, value in finding.parameters.items()],
        "stated": [quantity(k, stated[k]) if k in stated else "" for k in finding.parameters],
        "closes": closed_share(finding.gap_closed),
        "verdict": verdict_of(finding),
    }


def _effect(finding: Finding) -> dict[str, Any]:
    gain = Interval(*gain_per_toss(finding))
    fitted = finding.evidence.get("gain", 0.0) != 0.0
    p = finding.evidence.get("p_value", 1.0)
    sizes = [f"{parameter(k)} {change(k, size)}" for k, size in finding.detectable.items()]
    return {
        "name": finding.name,
        "color": VERDICTS[finding.verdict][1],
        "verdict": verdict_of(finding),
        "alone": not finding.confusable_with,
        "gain": span(gain) if fitted else "screened only",
        "p": (f"{p:.2g}" if p >= 1e-4 else "< 0.0001") if fitted else "",
        "closes": closed_share(finding.gap_closed) if fitted else "",
        "detectable": ", ".join(sizes) or "none of plausible size",
    }


def _next_toss(diagnosis: Diagnosis) -> list[str]:
    found = diagnosis.next_toss
    if found is None or (found.get("release") is None and not any(f.confusable_with for f in diagnosis.findings)):
        return []
    return next_toss_words(found)


def _patch(patch: Mapping[str, Any] | None) -> dict[str, Any] | None:
    if not patch or not (patch["changes"] or patch["recording"] or patch["not_expressed"]):
        return None
    scalars = [
        f"{key} {values['before']:.4g} → {values['after']:.4g}"
        for key, values in patch["keys"].items()
        if isinstance(values["before"], float)
    ]
    run = patch.get("rerun") or {}
    problem = run.get("problem")
    return {**patch, "scalars": listed(scalars), "problem": problem, "rerun": None if problem else _rerun(run)}


def _rerun(run: Mapping[str, Any]) -> dict[str, Any] | None:
    if not run:
        return None
    labels = {
        "gap": "gap, short windows [standard deviations of noise]",
        "position_error_pct": "rollout, position [% of width]",
        "rotation_error_deg": "rollout, rotation [deg]",
    }
    rows = [
        [label, *(span(_interval(run[key][when])) for when in ("before", "after"))] for key, label in labels.items()
    ]
    return {
        **run,
        "closes": percent_span(_interval(run["gap_closed"])),
        "lacks": listed(run["not_in_it"]),
        "rows": rows,
    }


def _interval(value: Mapping[str, Any]) -> Interval:
    return Interval(value["value"], *value["ci95"])


def _lengths(diagnosis: Diagnosis) -> list[list[str]]:
    left = {n: rms for n, rms, _ in diagnosis.left.by_length}
    return [
        [str(n), short(rms), short(left[n]) if n in left else "", short(floor)]
        for n, rms, floor in diagnosis.gap.by_length
    ]
