"""The figure of an audit: right names by how far the effect moves the object."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.stats import binomtest

from tossid.evaluation.figures.style import INK, MUTED, footnote, key_row, new_figure, panel_grid, styled

RIGHT, WRONG = "#0072B2", "#D55E00"
MARKERS = {"lcp": "o", "mujoco": "s", "drake": "^", "bullet": "v"}
GROUPS = 4
"""Of equally many cases, whose share of right names is drawn over the displacement."""


@styled
def detection(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Share of right names against the displacement by the effect over the position noise, with the single cases.

    Args:
        rows: Cases with effects of the library: their `engine`, `displacement` and whether they are `right`.
    """
    figure = new_figure(
        "Audit: right names by displacement",
        f"{len(rows)} cases with effects of the library; of several, the smallest displacement",
        height=4.2,
    )
    ax = panel_grid(figure, 1, 1, left=0.8, top=1.15, bottom=0.95)[0, 0]
    size = np.array([max(min(row["displacement"]), 0.1) for row in rows])
    right = np.array([bool(row["right"]) for row in rows])
    ax.set_xscale("log")
    rng = np.random.default_rng(0)
    for engine, marker in MARKERS.items():
        for value, color in ((True, RIGHT), (False, WRONG)):
            chosen = np.array([row["engine"] == engine for row in rows], dtype=bool) & (right == value)
            y = float(value) + rng.uniform(-0.02, 0.02, int(chosen.sum()))
            ax.plot(size[chosen], y, marker, color=color, ms=5, alpha=0.8, ls="none")
    for part in np.array_split(np.argsort(size), min(GROUPS, len(rows))):
        low, high = binomtest(int(right[part].sum()), len(part)).proportion_ci(method="wilson")
        middle = math.exp(float(np.log(size[part]).mean()))
        ax.plot([middle, middle], [low, high], color=MUTED, lw=1.2)
        ax.plot([size[part].min(), size[part].max()], [right[part].mean()] * 2, color=INK, lw=2.2)
    ax.set_ylim(-0.06, 1.06)
    ax.set_xlabel("displacement by the effect (median over a toss) / position noise [1]")
    ax.set_ylabel("share of right names [1]")
    entries: list[tuple[Any, str]] = [
        (Line2D([], [], color=INK, lw=2.2), "share, in groups of equally many cases"),
        (Line2D([], [], color=RIGHT, marker="o", ls="none"), "right"),
        (Line2D([], [], color=WRONG, marker="o", ls="none"), "wrong"),
    ]
    there = {row["engine"] for row in rows}
    entries += [
        (Line2D([], [], color=MUTED, marker=m, ls="none"), engine) for engine, m in MARKERS.items() if engine in there
    ]
    key_row(figure, entries, y=0.72)
    footnote(figure, "Bars: 95 % intervals (Wilson).")
    return figure
