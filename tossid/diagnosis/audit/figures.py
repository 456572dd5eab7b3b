"""Figures of an audit: the effects that were named for those that were there, and how often rightly."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tossid.diagnosis.audit.cases import OF_LIBRARY, PAIRS, SEVERAL
from tossid.diagnosis.audit.ranks import band, ranks_of
from tossid.diagnosis.audit.scores import calibration
from tossid.evaluation.figures.style import INK, MUTED, footnote, key_row, new_figure, panel_grid, styled
from tossid.settings.diagnosis.audit import ScoreSettings

RIGHT, WRONG, SHADE = "#0072B2", "#D55E00", "#8b9098"
NOTHING = "nothing"
MARKERS = {"lcp": "o", "mujoco": "s", "drake": "^", "bullet": "v", "real": "D"}

Row = Mapping[str, Any]


def audit_figures(rows: Sequence[Row], *, settings: ScoreSettings = ScoreSettings()) -> dict[str, Figure]:
    """The figures of an audit.

    Args:
        rows: Its cases, with `effects`, `class`, `first`, `kind`, `engine`, `displacement` and `right`.
        settings: Groups, wanted share and shading.

    Returns:
        The figures by name.
    """
    figures = {"confusion": confusion(rows)}
    if any(row["displacement"] for row in rows):
        figures["detection"] = detection(rows, settings=settings)
    if any(len(ranks_of(row["parameters"])) for row in rows):
        figures["ranks"] = ranks(rows)
    if any(row["claims"] for row in rows):
        figures["reliability"] = reliability(rows)
    return figures


@styled
def ranks(rows: Sequence[Row]) -> Figure:
    """How far the cumulative distribution of ranks of true values is from that of uniform numbers.

    Args:
        rows: The cases.

    Returns:
        The figure.
    """
    single = [ranks_of(row["parameters"]) for row in rows]
    joint = np.array([each for row in rows for each in row["joint_ranks"]])
    cases, of = sum(len(each) > 0 for each in single), np.concatenate(single)
    figure = new_figure(
        "Audit: are the intervals right?",
        f"true values of {len(of)} parameters of {cases} cases: their rank within what is stated of them",
        height=4.4,
    )
    ax = panel_grid(figure, 1, 1, left=0.9, right=3.0, top=0.9, bottom=1.1)[0, 0]
    half = band(cases)
    ax.axhspan(-half, half, color=SHADE, alpha=0.15, lw=0)
    ax.axhline(0, color=MUTED, lw=1, ls=":")
    keys = []
    for label, values, color in (("single values", of, RIGHT), ("whole effects (random balls)", joint, WRONG)):
        if not len(values):
            continue
        x = np.concatenate([[0.0], np.sort(values), [1.0]])
        share = np.concatenate([[0.0], np.arange(1, len(values) + 1) / len(values), [1.0]])
        ax.step(x, share - x, where="post", color=color, lw=1.6)
        keys.append((Line2D([], [], color=color, lw=1.6), label))
    ax.set_xlim(0, 1)
    ax.set_xlabel("rank: stated probability below the true value")
    ax.set_ylabel("share of ranks below, minus the rank")
    ax.legend(*zip(*keys, strict=True), loc="upper left", bbox_to_anchor=(1.02, 1.0), frameon=False, fontsize=8.5)
    footnote(figure, f"Shaded: where {cases} independent ranks stay with 95 % probability (Kolmogorov).")
    return figure


@styled
def reliability(rows: Sequence[Row]) -> Figure:
    """How often what was stated with a probability was so, over that probability.

    Args:
        rows: The cases.

    Returns:
        The figure.
    """
    stated = [claim for row in rows for claim in row["claims"]]
    figure = new_figure(
        "Audit: are the probabilities right?",
        f"{len(stated)} probabilities of names and of none of the library, in fifths; numbers are how many",
        height=4.4,
    )
    ax = panel_grid(figure, 1, 1, left=0.9, right=3.0, top=0.9, bottom=1.1)[0, 0]
    ax.plot([0, 1], [0, 1], color=MUTED, lw=1, ls=":")
    keys = []
    for name, some, color in (("a name", False, RIGHT), ("none of the library", True, WRONG)):
        found = calibration([claim for claim in stated if (claim["of"] == "none") == some])
        points = [(part["probability"], part["true"], part["of"]) for part in found["reliability"]]
        if not points:
            continue
        x, y, count = zip(*points, strict=True)
        ax.plot(x, y, color=color, marker="o", ms=6, lw=1.2)
        for at in zip(x, y, count, strict=True):
            ax.annotate(str(at[2]), at[:2], textcoords="offset points", xytext=(6, -10), fontsize=8, color=color)
        keys.append((Line2D([], [], color=color, marker="o", ms=6, lw=1.2), f"{name} (Brier {found['brier']:.3f})"))
    ax.set_xlim(-0.03, 1.03)
    ax.set_ylim(-0.03, 1.03)
    ax.set_xlabel("stated probability")
    ax.set_ylabel("share that was so")
    ax.legend(*zip(*keys, strict=True), loc="upper left", bbox_to_anchor=(1.02, 1.0), frameon=False, fontsize=8.5)
    footnote(figure, "On the dotted line probabilities are right.")
    return figure


@styled
def confusion(rows: Sequence[Row]) -> Figure:
    """The confusion matrix: how often each effect was named first, or in the class of the first, for each truth.

    Args:
        rows: The cases.

    Returns:
        The figure.
    """
    truths = list(dict.fromkeys(_truth(row) for row in sorted(rows, key=lambda row: (_rank(row), _truth(row)))))
    seen = {name for row in rows for name in (row["class"] or [NOTHING])}
    names = [t for t in truths if t in seen] + sorted(seen - set(truths))
    first, member = np.zeros((len(truths), len(names))), np.zeros((len(truths), len(names)))
    good = np.zeros_like(first, dtype=bool)
    for row in rows:
        i = truths.index(_truth(row))
        for name in row["class"] or [NOTHING]:
            j = names.index(name)
            head = name == (row["first"] or NOTHING)
            (first if head else member)[i, j] += 1
            good[i, j] |= name in row["effects"] if row["kind"] in (*OF_LIBRARY, "spoilt") else name == NOTHING
    height = 2.6 + 0.26 * len(truths)
    figure = new_figure(
        "Audit: true effects and named effects",
        f"{len(rows)} cases; counts of the effect that a diagnosis names first, and in brackets of those in its class",
        height=height,
    )
    ax = panel_grid(figure, 1, 1, left=2.9, right=0.2, top=0.9, bottom=1.6)[0, 0]
    for i in range(len(truths)):
        for j in range(len(names)):
            if first[i, j] or member[i, j]:
                color = RIGHT if good[i, j] else WRONG
                share = 0.85 if first[i, j] else 0.3
                ax.add_patch(_square(j, i, color, share))
                text = f"{first[i, j]:.0f}" if first[i, j] else f"({member[i, j]:.0f})"
                ax.text(j, i, text, ha="center", va="center", fontsize=9, color="white" if first[i, j] else INK)
    ax.set_xlim(-0.5, len(names) - 0.5)
    ax.set_ylim(len(truths) - 0.5, -0.5)
    ax.set_xticks(range(len(names)), names, rotation=40, ha="right", rotation_mode="anchor", fontsize=8.5)
    ax.set_yticks(range(len(truths)), truths, fontsize=8.5)
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    footnote(figure, "Rows: true effect. Columns: named effect. Blue: right; vermilion: wrong.")
    return figure


def _square(x: float, y: float, color: str, alpha: float) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((x - 0.46, y - 0.44), 0.92, 0.88, color=color, alpha=alpha, lw=0)


def _truth(row: Row) -> str:
    if row["kind"] == "null":
        return NOTHING
    name = " + ".join(row["effects"])
    return {"outside": f"{name} (not in the library)", "without": f"{name} (removed from the library)"}.get(
        row["kind"], name
    )


def _rank(row: Row) -> int:
    return ("effect", "spoilt", *PAIRS, *SEVERAL, "without", "outside", "null").index(row["kind"])


@styled
def detection(rows: Sequence[Row], *, settings: ScoreSettings = ScoreSettings()) -> Figure:
    """Share of right names against the displacement by the effect over the position noise, with the single cases.

    Args:
        rows: The cases.
        settings: Groups, wanted share and shading.

    Returns:
        The figure.
    """
    drawn = [row for row in rows if row["kind"] in OF_LIBRARY and row["displacement"]]
    figure = new_figure(
        "Audit: right names by displacement",
        f"{len(drawn)} cases with effects of the library; of several, the smallest displacement",
        height=4.2,
    )
    ax = panel_grid(figure, 1, 1, left=0.8, top=1.15, bottom=0.95)[0, 0]
    size = np.array([max(min(row["displacement"]), 0.1) for row in drawn])
    right = np.array([bool(row["right"]) for row in drawn])
    ax.set_xscale("log")
    ax.axvspan(*settings.shaded, color=SHADE, alpha=0.12, lw=0)
    rng = np.random.default_rng(0)
    for engine, marker in MARKERS.items():
        for value, color in ((True, RIGHT), (False, WRONG)):
            chosen = np.array([row["engine"] == engine for row in drawn], dtype=bool) & (right == value)
            y = float(value) + rng.uniform(-0.02, 0.02, int(chosen.sum()))
            ax.plot(size[chosen], y, marker, color=color, ms=5, alpha=0.8, ls="none")
    order = np.argsort(size)
    for part in np.array_split(order, min(settings.groups, len(order))) if len(order) else []:
        low, high = wilson(int(right[part].sum()), len(part))
        x = math.exp(float(np.log(size[part]).mean()))
        ax.plot([x, x], [low, high], color=MUTED, lw=1.2)
        ax.plot([size[part].min(), size[part].max()], [right[part].mean()] * 2, color=INK, lw=2.2)
    ax.axhline(settings.right_name, color=MUTED, lw=0.8, ls="--")
    ax.set_ylim(-0.06, 1.06)
    ax.set_xlabel("displacement by the effect (median over a toss) / position noise [1]")
    ax.set_ylabel("share of right names [1]")
    entries: list[tuple[Any, str]] = [
        (Line2D([], [], color=INK, lw=2.2), "share, in groups of equally many cases"),
        (Line2D([], [], color=RIGHT, marker="o", ls="none"), "right"),
        (Line2D([], [], color=WRONG, marker="o", ls="none"), "wrong"),
    ]
    entries += [
        (Line2D([], [], color=MUTED, marker=m, ls="none"), e)
        for e, m in MARKERS.items()
        if any(row["engine"] == e for row in drawn)
    ]
    key_row(figure, entries, y=0.72)
    low, high = settings.shaded
    footnote(
        figure, f"Bars: 95 % intervals (Wilson). Shaded: {low:g} to {high:g} times the noise. Dashed: wanted share."
    )
    return figure


def wilson(count: int, of: int) -> tuple[float, float]:
    """The 95 % interval of a share (Wilson 1927).

    Args:
        count: How many.
        of: Of how many.

    Returns:
        Lower and upper end.
    """
    if of == 0:
        return 0.0, 1.0
    z, p = 1.96, count / of
    middle, half = p + z * z / (2 * of), z * math.sqrt(p * (1 - p) / of + z * z / (4 * of * of))
    return (middle - half) / (1 + z * z / of), (middle + half) / (1 + z * z / of)
