"""Figures of an audit: what was named for what was there, and how often rightly, against how far the object moved."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tossid.evaluation.figures.style import INK, MUTED, footnote, key_row, new_figure, panel_grid, styled

RIGHT, WRONG, ELSE = "#0072B2", "#D55E00", "#8b9098"
NOTHING = "nothing"
MARKERS = {"lcp": "o", "mujoco": "s", "real": "D"}
BINS = 4

Row = Mapping[str, Any]


def audit_figures(rows: Sequence[Row]) -> dict[str, Figure]:
    """The figures of an audit's rows (`effects`, `class`, `first`, `kind`, `engine`, `displacement`, `right`)."""
    figures = {"confusion": confusion(rows)}
    if any(row["displacement"] for row in rows):
        figures["detection"] = detection(rows)
    return figures


@styled
def confusion(rows: Sequence[Row]) -> Figure:
    """A row for each truth, a column for each name: how often it was named first, or in the first's class."""
    truths = list(dict.fromkeys(_truth(row) for row in sorted(rows, key=lambda row: (_rank(row), _truth(row)))))
    said = {name for row in rows for name in (row["class"] or [NOTHING])}
    names = [t for t in truths if t in said] + sorted(said - set(truths))
    first, member = np.zeros((len(truths), len(names))), np.zeros((len(truths), len(names)))
    good = np.zeros_like(first, dtype=bool)
    for row in rows:
        i = truths.index(_truth(row))
        for name in row["class"] or [NOTHING]:
            j = names.index(name)
            head = name == (row["first"] or NOTHING)
            (first if head else member)[i, j] += 1
            good[i, j] |= name in row["effects"] if row["kind"] in ("effect", "pair", "spoilt") else name == NOTHING
    height = 2.6 + 0.26 * len(truths)
    figure = new_figure(
        "Audit: what was there, and what was named",
        f"{len(rows)} cases; the first name of a diagnosis, and those of its class in brackets",
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
    footnote(figure, "Rows: the truth. Columns: the name. Blue: right; vermilion: wrong.")
    return figure


def _square(x: float, y: float, color: str, alpha: float) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((x - 0.46, y - 0.44), 0.92, 0.88, color=color, alpha=alpha, lw=0)


def _truth(row: Row) -> str:
    if row["kind"] == "null":
        return NOTHING
    name = " + ".join(row["effects"])
    return {"outside": f"{name} (no effect)", "without": f"{name} (taken out)"}.get(row["kind"], name)


def _rank(row: Row) -> int:
    return ("effect", "spoilt", "pair", "without", "outside", "null").index(row["kind"])


@styled
def detection(rows: Sequence[Row]) -> Figure:
    """Share of right names against how far the effect moves the object over the position noise, with the cases."""
    shown = [row for row in rows if row["kind"] in ("effect", "pair") and row["displacement"]]
    figure = new_figure(
        "Audit: right names against the effect's size",
        f"{len(shown)} cases with effects of the library; of a pair, the smaller of the two sizes",
        height=4.2,
    )
    ax = panel_grid(figure, 1, 1, left=0.8, top=1.15, bottom=0.95)[0, 0]
    size = np.array([max(min(row["displacement"]), 0.1) for row in shown])
    right = np.array([bool(row["right"]) for row in shown])
    ax.set_xscale("log")
    ax.axvspan(5, 500, color=ELSE, alpha=0.12, lw=0)
    rng = np.random.default_rng(0)
    for engine, marker in MARKERS.items():
        for value, color in ((True, RIGHT), (False, WRONG)):
            chosen = np.array([row["engine"] == engine for row in shown], dtype=bool) & (right == value)
            y = float(value) + rng.uniform(-0.02, 0.02, int(chosen.sum()))
            ax.plot(size[chosen], y, marker, color=color, ms=5, alpha=0.8, ls="none")
    order = np.argsort(size)
    for part in np.array_split(order, min(BINS, len(order))) if len(order) else []:
        low, high = wilson(int(right[part].sum()), len(part))
        x = math.exp(float(np.log(size[part]).mean()))
        ax.plot([x, x], [low, high], color=MUTED, lw=1.2)
        ax.plot([size[part].min(), size[part].max()], [right[part].mean()] * 2, color=INK, lw=2.2)
    ax.axhline(0.9, color=MUTED, lw=0.8, ls="--")
    ax.set_ylim(-0.06, 1.06)
    ax.set_xlabel("way by which the effect moves the object (median over a toss) / position noise")
    ax.set_ylabel("share of right names")
    entries: list[tuple[Any, str]] = [
        (Line2D([], [], color=INK, lw=2.2), "share, in groups of equal number"),
        (Line2D([], [], color=RIGHT, marker="o", ls="none"), "right"),
        (Line2D([], [], color=WRONG, marker="o", ls="none"), "wrong"),
    ]
    entries += [
        (Line2D([], [], color=MUTED, marker=m, ls="none"), e)
        for e, m in MARKERS.items()
        if any(row["engine"] == e for row in shown)
    ]
    key_row(figure, entries, y=0.72)
    footnote(figure, "Bars: 95 % intervals (Wilson). Shaded: 5 to 500 times the noise. Dashed: what is wanted.")
    return figure


def wilson(count: int, of: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927)."""
    if of == 0:
        return 0.0, 1.0
    z, p = 1.96, count / of
    middle, half = p + z * z / (2 * of), z * math.sqrt(p * (1 - p) / of + z * z / (4 * of * of))
    return (middle - half) / (1 + z * z / of), (middle + half) / (1 + z * z / of)
