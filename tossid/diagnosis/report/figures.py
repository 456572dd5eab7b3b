"""Figures of the whole gap: whole tosses before and after, and where and when short windows go wrong."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch as Swatch
from numpy.typing import NDArray

from tossid.diagnosis.findings import FELT_DEG, FELT_PCT, Interval
from tossid.diagnosis.report.registry import report_figure
from tossid.diagnosis.report.units import percent, short
from tossid.diagnosis.result import Diagnosis
from tossid.evaluation.figures.style import INK, MUTED, footnote, key_row, new_figure, panel_grid, styled
from tossid.types import Phase

Array = NDArray[np.float64]

BEFORE, AFTER = "#D55E00", "#0072B2"
CHANNELS = {"p": "position", "r": "rotation, body"}
WHERE = "Where the gap is"
TIME_BIN = 0.02
"""Width of a cell of the figure over time [s]: three frames at 148 Hz."""
PALEST = 0.3
"""Excess of a frame at which colours begin: less is what noise alone often gives."""
SMALLEST = 1e-2
"""Errors below are drawn here [%], [deg]."""


@report_figure(
    "gap_tosses",
    alt="Errors of each whole toss before and after the changes, and their means.",
    applies=lambda diagnosis: diagnosis.brings.n > 0,
)
@styled
def whole_tosses(diagnosis: Diagnosis) -> Figure:
    """Errors of each whole toss, before and after the changes; half as wide as other figures, to be read on a phone.

    Args:
        diagnosis: What was found.
    """
    brings, changed = diagnosis.brings, bool(diagnosis.change)
    both = np.isfinite(brings.before).all(1) & np.isfinite(brings.after).all(1)
    figure = new_figure("Whole tosses", "Each dot is a toss, each bar the mean.", height=3.5, width=5.2)
    axes = panel_grid(figure, 1, 2, left=0.7, right=0.15, top=1.0, bottom=0.75, between=0.85)[0]
    kinds = (
        ("position error [% of width]", FELT_PCT, brings.position_pct()),
        ("rotation error [deg]", FELT_DEG, brings.rotation_deg()),
    )
    for k, (ax, (label, felt, means)) in enumerate(zip(axes, kinds, strict=True)):
        errors = np.maximum(np.stack([brings.before[both, k], brings.after[both, k]])[: 1 + changed], SMALLEST)
        ax.set_yscale("log")
        ax.set_ylim(min(0.8 * errors.min(), 0.6 * felt), max(1.5 * errors.max(), 2 * felt))
        ax.axhspan(SMALLEST / 10, felt, color=MUTED, alpha=0.13, lw=0)
        if changed:
            ax.plot([0, 1], errors, color=MUTED, lw=0.6, alpha=max(0.1, min(0.6, 12 / brings.n)), zorder=1)
        for x, (values, color) in enumerate(zip(errors, (BEFORE, AFTER), strict=False)):
            ax.plot(np.full(len(values), x), values, "o", color=color, ms=4, alpha=0.6)
            ax.plot([x - 0.22, x + 0.22], [max(means[x].value, SMALLEST)] * 2, color=color, lw=3)
            text, below = f"{('before', 'after')[x]}\n{short(means[x].value, 2)}", ax.get_xaxis_transform()
            ax.text(x, -0.04, text, transform=below, ha="center", va="top", color=color, weight="bold")
        ax.set_xlim(-0.5, 0.5 + changed)
        ax.set_xticks([])
        ax.grid(axis="x", visible=False)
        ax.set_ylabel(label)
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter("")
    footnote(figure, f"Grey: less than a person notices ({FELT_PCT} % and {FELT_DEG} deg).")
    return figure


@report_figure("gap_where", alt="Shares of the gap by phase and by channel, before and after.", detail=WHERE)
@styled
def gap_by_part(diagnosis: Diagnosis) -> Figure:
    """The gap above the noise by phase and by channel, before and with the effects that were found.

    Args:
        diagnosis: What was found.
    """
    before, left = diagnosis.gap, diagnosis.left
    excess, rest = (float(gap.frames[:, 3].sum()) for gap in (before, left))
    scale = rest / excess if excess > 0 else 0.0  # the shares of what is left are of what is left
    figure = new_figure(WHERE, "Shares of the gap above the noise in short windows.", height=4.6)
    axes = panel_grid(figure, 1, 2, left=0.7, right=1.0, top=1.25, bottom=0.85, between=2.45)[0]
    for ax, title, ours, theirs in (
        (axes[0], "By phase of the motion", before.by_phase, left.by_phase),
        (axes[1], "By channel", before.by_channel, left.by_channel),
    ):
        ax.set_title(title)
        after = [theirs[name].scaled(scale) for name in ours] if diagnosis.found else ()
        share_rows(ax, [_row(name) for name in ours], list(ours.values()), after)
        ax.set_xlabel("share of the original gap [%]")
    colour_key(figure, y=0.78, after=bool(diagnosis.found))
    footnote(figure, "Thin lines: 95 % intervals over tosses. Negative: less than noise alone gives.")
    return figure


def _row(name: str) -> str:
    """A phase or a channel, as a row of a figure names it."""
    kind, _, axis = name.partition("_")
    return f"{CHANNELS[kind]} {axis}" if kind in CHANNELS else name.replace("_", " ")


def colour_key(figure: Figure, *, y: float, x: float = 0.15, after: bool = True) -> None:
    """Write which colour is before the changes, and which is after them.

    Args:
        figure: The figure.
        y: As of `key_row`.
        x: As of `key_row`.
        after: Whether there is an after.
    """
    handles = [(Swatch(color=BEFORE), "before"), (Swatch(color=AFTER), "after")]
    key_row(figure, handles[: 1 + after], y=y, x=x)


def share_rows(
    ax: Axes, names: Sequence[str], before: Sequence[Interval], after: Sequence[Interval], notes: Sequence[str] = ()
) -> None:
    """Shares of the gap as bars with intervals, one below the other, each with its numbers.

    Args:
        ax: The panel.
        names: Of the rows.
        before: Their shares.
        after: What is left of them; none if empty.
        notes: Of each row, after its numbers; none if empty.
    """
    values = [100 * share.value for share in before]
    ends = (max(-40.0, 1.3 * min(0.0, *values) - 0.05), min(140.0, max(0.3, 1.35 * max(values))))
    for k, row in enumerate(range(len(names) - 1, -1, -1)):
        both = [(before[k], BEFORE, row + 0.18), (after[k], AFTER, row - 0.18)] if after else [(before[k], BEFORE, row)]
        for share, color, at in both:
            ax.barh(at, np.clip(100 * share.value, *ends), height=0.32, color=color, alpha=0.85)
            ax.plot(np.clip([100 * share.low, 100 * share.high], *ends), [at, at], color=INK, lw=0.9)
        numbers = " → ".join(percent(share.value)[:-2] for share, _, _ in both) + " %"
        note = f", {notes[k]}" if notes else ""
        ax.text(1.03, row, numbers + note, transform=ax.get_yaxis_transform(), va="center", fontsize=9)
        ax.text(-0.03, row, names[k], transform=ax.get_yaxis_transform(), va="center", ha="right", fontsize=9)
    ax.set_xlim(*ends)
    ax.set_ylim(-0.6, len(names) - 0.4)
    ax.set_yticks([])
    ax.axvline(0, color=MUTED, lw=0.8)
    ax.grid(axis="y", visible=False)


@report_figure("gap_when", alt="Errors of every toss over time, before and after.", detail=WHERE)
@styled
def gap_over_time(diagnosis: Diagnosis) -> Figure:
    """Every toss over time: the excess of its errors, before and after.

    Args:
        diagnosis: What was found.
    """
    n, gaps = diagnosis.n_tosses, [diagnosis.gap, diagnosis.left][: 1 + bool(diagnosis.found)]
    figure = new_figure(
        "When the errors occur",
        "Each row is a toss, ordered by first contact. Excess: deviance of a frame beyond what noise gives.",
        height=1.95 + float(np.clip(0.055 * n, 1.3, 3.6)),
    )
    axes = panel_grid(figure, 1, len(gaps), left=0.75, right=1.15, top=1.05, bottom=0.9, between=0.45)[0]
    end = max((float(gap.frames[:, 1].max()) for gap in gaps if len(gap.frames)), default=1.0)
    first = gaps[0].frames
    highest = max(10.0, float(np.percentile(first[:, 3], 99))) if len(first) else 10.0
    norm, order = LogNorm(vmin=PALEST, vmax=highest), _order(first, n)
    for ax, gap, title in zip(axes, gaps, ("before", "after"), strict=False):
        ax.set_title(title, fontsize=9.5)
        table = _cells(gap.frames, n, end)[order]
        image = ax.imshow(
            np.maximum(table, PALEST),
            aspect="auto",
            norm=norm,
            cmap="YlOrRd",
            origin="lower",
            extent=(0.0, table.shape[1] * TIME_BIN, 0, n),
            interpolation="nearest",
        )
        ax.set_facecolor("#eef0f2")
        ax.grid(visible=False)
        ax.set_xlim(0, end)
        ax.set_yticks([])
        ax.set_xlabel("time since release [s]")
    axes[0].set_ylabel("tosses", labelpad=22)
    w, box = figure.get_figwidth(), axes[-1].get_position()
    bar = figure.add_axes((box.x1 + 0.15 / w, box.y0, 0.13 / w, box.height))
    colors = figure.colorbar(image, cax=bar)
    colors.ax.yaxis.set_major_formatter("{x:g}")
    colors.set_label("excess over noise [1]", fontsize=8.5)
    footnote(figure, "Palest: no more than noise. Grey: no frame.")
    return figure


def _order(frames: Array, n: int) -> NDArray[np.int64]:
    """Tosses by the time of their first contact."""
    first = np.full(n, np.inf)
    touched = frames[frames[:, 2] > Phase.FLIGHT]
    np.minimum.at(first, touched[:, 0].astype(int), touched[:, 1])
    return np.argsort(first, kind="stable")


def _cells(frames: Array, n: int, end: float) -> Array:
    """(n, bins) mean excess; NaN where a toss has no frame."""
    bins = max(1, int(np.ceil(end / TIME_BIN + 1e-9)))
    index = frames[:, 0].astype(int) * bins + np.minimum((frames[:, 1] / TIME_BIN - 1e-9).astype(int), bins - 1)
    count = np.bincount(index, minlength=n * bins)
    total = np.bincount(index, weights=frames[:, 3], minlength=n * bins)
    with np.errstate(invalid="ignore", divide="ignore"):
        return (total / count).reshape(n, bins)
