"""gap.html: one page that a person reads in two minutes. Self-contained: no script, nothing from the network."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

from matplotlib.figure import Figure

from tossid.diagnosis.figures import VERDICTS, gain_per_toss
from tossid.diagnosis.findings import Diagnosis, Finding, Interval
from tossid.diagnosis.words import (
    change,
    closes,
    headline,
    in_units,
    listed,
    next_toss_words,
    parameter,
    percent,
    place_of,
    quantity,
    sentences,
    short,
    stated_values,
    verdict_of,
    where_words,
)

ALT = {
    "gap_where": "Shares of the gap by phase and by channel, before and after.",
    "gap_when": "Misses of every toss over time, before and after, and their mean by phase.",
    "gap_which": "Gain of likelihood by effect, with intervals, coloured by verdict.",
    "gap_wrench": "The residual force or torque over the state that explains it best, in flight and in contact.",
    "gap_corners": "The object's corners, coloured by their share of the gap per frame of contact, and the shares.",
}

_STYLE = """
body { font: 16px/1.5 system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif; color: #26282c;
  max-width: 60rem; margin: 2rem auto 4rem; padding: 0 1.25rem; background: #fff; }
h1 { font-size: 1.6rem; margin: 0 0 .3rem; line-height: 1.25; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .6rem; }
p, li { max-width: 46rem; }
.about { color: #70757d; margin: 0 0 1.2rem; }
.verdict { border-left: .35rem solid #0072b2; background: #f4f7fa; padding: .9rem 1.2rem; margin: 0 0 1.6rem; }
.verdict p { margin: 0 0 .55rem; } .verdict p:last-child { margin: 0; }
img { display: block; width: 100%; height: auto; margin: 1rem 0 1.8rem; }
table { border-collapse: collapse; font-size: .92rem; margin: .4rem 0 1rem; }
th, td { text-align: left; vertical-align: top; padding: .3rem .9rem .3rem 0; border-bottom: 1px solid #e3e5e8; }
th { font-weight: 600; border-bottom: 1.5px solid #9aa0a8; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.nb { white-space: nowrap; }
.dot { display: inline-block; width: .7em; height: .7em; border-radius: 50%; margin-right: .4em; }
details { border-top: 1px solid #e3e5e8; padding: .55rem 0; }
summary { cursor: pointer; font-weight: 600; }
pre { background: #f4f5f7; padding: .8rem; overflow-x: auto; font-size: .8rem; line-height: 1.35; }
.wide { overflow-x: auto; } .note { color: #70757d; font-size: .9rem; }
"""


def report_html(
    diagnosis: Diagnosis,
    figures: Mapping[str, Figure],
    *,
    about: str,
    details: Mapping[str, Figure] | None = None,
    patch: Mapping[str, Any] | None = None,
    next_toss: Mapping[str, Any] | None = None,
    remarks: Sequence[str] = (),
) -> str:
    """The page.

    Args:
        figures: by name (`figures.report_figures`), in the order in which they are read.
        about: which simulator, which tosses.
        details: more of them (`place_figures.place_figures`), for the details.
        patch, next_toss: as in gap.json.
        remarks: what the reader should know beside (tosses left out, say).
    """
    verdict = "".join(f"<p>{escape(text)}</p>" for text in [*sentences(diagnosis), *remarks])
    pictures = "".join(_image(name, figure) for name, figure in figures.items())
    more = {name: _image(name, figure) for name, figure in (details or {}).items()}
    parts = [
        f"<h1>{escape(headline(diagnosis))}</h1>",
        f'<p class="about">{escape(about)}</p>',
        f'<div class="verdict">{verdict}</div>',
        pictures,
        "<h2>What was found</h2>",
        _named_table(diagnosis),
        _next_toss(diagnosis, next_toss),
        _patch(patch),
        "<h2>Details</h2>",
        _section("All effects, and what size would have shown", _all_effects(diagnosis)),
        _section("Rollout errors, step by step", _steps(diagnosis)),
        _section("What the tosses show without a simulator", _witnesses(diagnosis)),
        _section("Where the gap is, in numbers", _where(diagnosis)),
        _section("Which force or torque is missing, and with which state", _wrench(diagnosis, more.get("gap_wrench"))),
        _section("On which corner", _corners(diagnosis, more.get("gap_corners"))),
        _section("The gap by length of prediction", _lengths(diagnosis)),
        _section("How to read this", _reading()),
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(headline(diagnosis))}</title><style>{_STYLE}</style></head>\n<body>\n"
        + "\n".join(part for part in parts if part)
        + "\n</body></html>\n"
    )


def _image(name: str, figure: Figure) -> str:
    return f'<img src="data:image/png;base64,{_png(figure)}" alt="{escape(ALT.get(name, name))}">'


def _png(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return base64.b64encode(buffer.getvalue()).decode()


def _section(title: str, body: str) -> str:
    return f"<details><summary>{escape(title)}</summary>{body}</details>" if body else ""


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: Sequence[int] = ()) -> str:
    """Cells are HTML; head is text. numbers: columns to the right."""

    def cell(tag: str, i: int, text: str) -> str:
        return f"<{tag} class=n>{text}</{tag}>" if i in numbers else f"<{tag}>{text}</{tag}>"

    top = "".join(cell("th", i, escape(text)) for i, text in enumerate(head))
    body = "".join("<tr>" + "".join(cell("td", i, text) for i, text in enumerate(row)) + "</tr>" for row in rows)
    return f'<div class="wide"><table><tr>{top}</tr>{body}</table></div>'


def _dot(finding: Finding) -> str:
    return f'<span class="dot" style="background:{VERDICTS[finding.verdict][1]}"></span>'


def _named_table(diagnosis: Diagnosis) -> str:
    """The effects that are named, and those that they may be instead."""
    shown = [f for f in diagnosis.findings if f.verdict in ("identified", "confusable")]
    if not shown:
        return "<p>No effect of the library is named.</p>"
    rows = []
    for f in shown:
        stated = stated_values(diagnosis, f.name)
        keys = list(f.parameters)
        rows.append(
            [
                f'<span class="nb">{_dot(f)}<b>{escape(f.name)}</b></span>',
                escape(f.says),
                "<br>".join(f"{escape(parameter(k))} = {escape(in_units(k, f.parameters[k]))}" for k in keys),
                "<br>".join(escape(quantity(k, stated[k])) if k in stated else "" for k in keys),
                escape(closes(f.gap_closed)),
                escape(verdict_of(f)),
            ]
        )
    head = ["effect", "what it is", "found (95 % interval)", "simulator has", "closes", "verdict"]
    return _table(head, rows, numbers=[4])


def _next_toss(diagnosis: Diagnosis, found: Mapping[str, Any] | None) -> str:
    if found is None or (found.get("release") is None and not any(f.confusable_with for f in diagnosis.findings)):
        return ""
    first, *rest = next_toss_words(dict(found))
    if not rest:
        return f"<h2>The next toss</h2><p>{escape(first)}</p>"
    items = "".join(f"<li>{escape(text)}</li>" for text in rest[:-1])
    return f"<h2>The next toss</h2><p>{escape(first)}</p><ul>{items}</ul><p>{escape(rest[-1])}</p>"


def _patch(patch: Mapping[str, Any] | None) -> str:
    if not patch or not (patch["changes"] or patch["recording"] or patch["not_expressed"]):
        return ""
    parts = ["<h2>The patch for your simulator</h2>"]
    scalars = {k: v for k, v in patch["keys"].items() if isinstance(v["before"], float)}
    if scalars:
        texts = [f"{k} {v['before']:.4g} → {v['after']:.4g}" for k, v in scalars.items()]
        parts.append(f"<p>In tossid's own terms: {escape(listed(texts))}.</p>")
    if patch["changes"]:
        rows = [
            [
                escape(c["effect"]),
                escape(c["where"]),
                f"<code>{escape(c['attribute'])}</code>",
                escape(c["before"]),
                escape(c["after"]),
                escape(c["note"] if c["note"] else "" if c["exact"] else "approximate"),
            ]
            for c in patch["changes"]
        ]
        parts.append(_table(["effect", "in the MJCF", "attribute", "before", "after", ""], rows))
    parts += [
        f"<p>{escape(name)}: correct the recording, {escape(text)}.</p>" for name, text in patch["recording"].items()
    ]
    parts += [
        f"<p>{escape(name)}: not in the patch: {escape(text)}.</p>" for name, text in patch["not_expressed"].items()
    ]
    run = patch.get("rerun")
    if run and "problem" in run:
        parts.append(f"<p>Not rerun in MuJoCo: {escape(run['problem'])}.</p>")
    elif run:
        parts.append(_rerun(run))
    if patch.get("mjcf"):
        parts.append(_section("The patched MJCF", f"<pre>{escape(patch['mjcf'])}</pre>"))
    return "".join(parts)


def _rerun(run: Mapping[str, Any]) -> str:
    rows = []
    for key, label in (
        ("gap", "gap, short windows [standard deviations of noise]"),
        ("position_error_pct", "rollout, position [% of width]"),
        ("rotation_error_deg", "rollout, rotation [deg]"),
    ):
        cells = []
        for when in ("before", "after"):
            value, (low, high) = run[key][when]["value"], run[key][when]["ci95"]
            cells.append(f"{short(value)} ({short(low)} to {short(high)})")
        rows.append([label, *cells])
    closed = run["gap_closed"]
    text = (
        f"Applied and rerun in {run['engine']} on {run['n_tosses']} tosses, the patch closes "
        f"{percent(closed['value'])} ({percent(closed['ci95'][0])} to {percent(closed['ci95'][1])}) of the gap there."
    )
    if run["not_in_it"]:
        text += f" Without {listed(run['not_in_it'])}, for which MJCF has no word."
    text += " What is left includes what MuJoCo's own contact does otherwise: it is soft, and its friction lifts."
    return f"<p>{escape(text)}</p>" + _table(["in MuJoCo", "before", "after"], rows, numbers=[1, 2])


def _all_effects(diagnosis: Diagnosis) -> str:
    rows = []
    for f in diagnosis.findings:
        value, low, high = gain_per_toss(f)
        tried = f.evidence.get("gain", 0.0) != 0.0
        gain = f"{short(value)} ({short(low)} to {short(high)})" if tried else "screened only"
        sizes = [f"{parameter(k)} {change(k, v)}" for k, v in f.detectable.items()]
        p = f.evidence.get("p_value", 1.0)
        rows.append(
            [
                f'<span class="nb">{_dot(f)}{escape(f.name)}</span>',
                f'<span class="nb">{escape(verdict_of(f))}</span>' if not f.confusable_with else escape(verdict_of(f)),
                escape(gain),
                (f"{p:.2g}" if p >= 1e-4 else "&lt; 0.0001") if tried else "",
                escape(closes(f.gap_closed)) if tried else "",
                escape(", ".join(sizes)) or "none within reason",
            ]
        )
    head = ["effect", "verdict", "gain per toss [nats]", "p", "closes", "smallest change that shows"]
    note = (
        '<p class="note">Gains are of held-out log-likelihood, with 95 % intervals over tosses. A change that would '
        "have shown is one of four standard errors. What a found effect closes of the gap is beyond those before it; "
        "what another closes is alone.</p>"
    )
    return _table(head, rows, numbers=[2, 3, 4]) + note


def _steps(diagnosis: Diagnosis) -> str:
    rows = [
        [
            escape(" + ".join(step.effects)) or "the simulator as it is",
            escape(_span(step.position_error_pct)),
            escape(_span(step.rotation_error_deg)),
        ]
        for step in diagnosis.steps
    ]
    head = ["effects", "position error [% of width]", "rotation error [deg]"]
    note = (
        '<p class="note">Open loop over whole tosses, from first states as flight tells them, at values fitted to '
        "other tosses. Means with 95 % intervals over tosses.</p>"
    )
    return _table(head, rows, numbers=[1, 2]) + note


def _witnesses(diagnosis: Diagnosis) -> str:
    rows = [
        [escape(w.quantity), short(w.stated), short(w.found), escape(_span(w.measured)), str(w.tosses)]
        for w in diagnosis.witnesses
    ]
    head = ["quantity", "the simulator as it is", "with the effects found", "the tosses themselves", "tosses"]
    unseen = diagnosis.steps[0].unseen_position_error_pct is not None
    note = (
        '<p class="note">Impacts of a lone corner between two flights (momentum and its arm against spin, velocities '
        "of the corner before and after) and parabolas through sliding. No window, no contact law and no fit is in "
        f"these; they are of {'unseen tosses' if unseen else 'the same tosses'}. Medians over tosses, 95 % by "
        "bootstrap.</p>"
    )
    return _table(head, rows, numbers=[1, 2, 3, 4]) + note if rows else ""


def _span(value: Interval) -> str:
    return f"{short(value.value)} ({short(value.low)} to {short(value.high)})"


def _where(diagnosis: Diagnosis) -> str:
    rows = [
        [
            escape(share.name),
            f"{percent(share.share.value)}",
            f"{percent(share.share.low)} to {percent(share.share.high)}",
        ]
        for share in (*diagnosis.gap.by_phase, *diagnosis.gap.by_channel)
    ]
    return _table(["phase or channel", "share of the gap", "95 % interval"], rows, numbers=[1, 2])


def _wrench(diagnosis: Diagnosis, image: str | None) -> str:
    if image is None:
        return ""
    parts = [("Before:", diagnosis.place.wrench)]
    if diagnosis.named:
        parts.append((f"With {listed(diagnosis.named)}:", diagnosis.place.wrench_left))
    said = "".join(f"<p>{escape(' '.join([when, *where_words(found)]))}</p>" for when, found in parts if found)
    note = (
        '<p class="note">A force and a torque, constant over each window, that would make up for its misses best '
        "(least squares, first states uncertain). Of all components and states the pair is shown of which the state "
        "explains most on tosses that took no part; it is called clear if signs drawn by toss give as good a best pair "
        "in at most one of a hundred draws. Along the path: along the horizontal velocity.</p>"
    )
    return said + image + note


def _corners(diagnosis: Diagnosis, image: str | None) -> str:
    place = diagnosis.place
    if image is None:
        return "" if not place.wrench else "<p>No gap in contact that could be shared out among the corners.</p>"
    touched = [c for c in place.corners if c.frames]
    first = max(touched, key=lambda c: c.per_frame or 0.0)
    times = first.per_frame or 0.0
    said = (
        f"Per frame, most comes while the corner at {place_of(first.place)} touches: {short(times, 2)} times the mean, "
        f"{percent(first.share.value)} ({percent(first.share.low)} to {percent(first.share.high)}) of the gap in "
        f"contact, in {first.frames} frames."
    )
    if not times * first.share.low > first.share.value:
        said += " That is not clearly more than the other corners have."
    return f"<p>{escape(said)}</p>" + image


def _lengths(diagnosis: Diagnosis) -> str:
    left = {n: rms for n, rms, _ in diagnosis.left.by_length}
    rows = [
        [str(n), short(rms), short(left[n]) if n in left else "", short(floor)]
        for n, rms, floor in diagnosis.gap.by_length
    ]
    head = ["frames predicted", "before", "with the named effects", "noise alone"]
    return _table(head, rows, numbers=[0, 1, 2, 3])


def _reading() -> str:
    texts = (
        "The gap is the root mean square of prediction errors over short windows, in standard deviations of the "
        "measurement's noise. Each window's first state is uncertain, and what that alone explains does not count.",
        "An effect is named if, fitted to seven eighths of the tosses, it predicts the others clearly better, with "
        "all effects of the library counted as tries. Confusable effects predict about equally well.",
        "Not identifiable: these tosses would not show the effect at any plausible size (no spin, no slide).",
    )
    return "".join(f"<p>{escape(text)}</p>" for text in texts)
