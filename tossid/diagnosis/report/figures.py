"""Figures at the top of the report: where the gap is, when the errors occur, and which effect explains them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch as Swatch
from numpy.typing import NDArray
from scipy.stats import t as student

from tossid.diagnosis.findings import FOUND, Finding, Gap, Share
from tossid.diagnosis.report.registry import report_figure
from tossid.diagnosis.result import Diagnosis
from tossid.evaluation.figures.style import (
    GRID,
    INK,
    MUTED,
    footnote,
    key_row,
    new_figure,
    panel_grid,
    styled,
)
from tossid.settings.diagnosis.report import ReportSettings
from tossid.types import Phase

Array = NDArray[np.float64]

BEFORE, AFTER = "#D55E00", "#0072B2"
PHASES = {"flight": "#56B4E9", "impact": "#D55E00", "slide": "#C28E00", "roll": "#009E73", "rest": "#7B4B94"}
VERDICTS = {
    "identified": ("identified", "#009E73"),
    "candidate": ("candidate", "#7B4B94"),
    "confusable": ("confusable", "#C28E00"),
    "not_supported": ("not supported", "#b4b9c0"),
    "not_identifiable": ("not identifiable", "#e3e5e8"),
}
"""Of each verdict of an effect: its words and its colour."""
CHANNELS = {
    "p_x": "position x",
    "p_y": "position y",
    "p_z": "height",
    "r_x": "rotation, body x",
    "r_y": "rotation, body y",
    "r_z": "rotation, body z",
}
"""Channels of the gap, as rows of a figure name them."""


@report_figure("gap_where", alt="Shares of the gap by phase and by channel, before and with the named effects.")
@styled
def gap_by_part(diagnosis: Diagnosis, settings: ReportSettings) -> Figure:
    """The gap above the noise by phase and by channel, before and with the named effects.

    Args:
        diagnosis: What was found.
        settings: What the figure draws.

    Returns:
        The figure.
    """
    before, after = diagnosis.gap, diagnosis.left
    scale = _remaining_share(before, after) if diagnosis.found else None
    figure = new_figure(
        "Where the gap is",
        "Shares of the gap above the noise, for the simulator as it is and with the named effects.",
        height=4.6,
    )
    axes = panel_grid(figure, 1, 2, left=0.7, right=1.0, top=1.25, bottom=0.85, between=2.45)[0]
    groups = (
        ("By phase of the motion", before.by_phase, after.by_phase, lambda name: name),
        ("By channel", before.by_channel, after.by_channel, lambda name: CHANNELS.get(name, name.replace("_", " "))),
    )
    for ax, (name, one, other, words) in zip(axes, groups, strict=True):
        ax.set_title(name)
        _bars(ax, one, other, scale, words, settings.least_share)
    handles = [(Swatch(color=BEFORE), "before")]
    if diagnosis.found:
        handles.append((Swatch(color=AFTER), "with " + ", ".join(diagnosis.found)))
    key_row(figure, handles, y=0.78)
    footnote(
        figure,
        "Thin lines: 95 % intervals over tosses, cut at the ends of the axis. Negative: less than noise alone gives.",
    )
    return figure


def _remaining_share(before: Gap, after: Gap) -> float:
    """What remains of the excess, as a share of the original one."""
    whole = float(before.frames[:, 3].sum()) if len(before.frames) else 0.0
    return float(after.frames[:, 3].sum()) / whole if whole > 0 and len(after.frames) else 0.0


def _bars(
    ax: Axes,
    before: tuple[Share, ...],
    after: tuple[Share, ...],
    scale: float | None,
    words: Callable[[str], str],
    least_share: float,
) -> None:
    names = [share.name for share in before]
    left = {share.name: share for share in after}
    rows = np.arange(len(names))[::-1].astype(float)
    values = [share.share.value for share in before]
    low, high = min(0.0, min(values, default=0.0)), max(values, default=1.0)
    ends = (max(-40.0, 100 * min(low * 1.3, -0.05)), min(140.0, 100 * max(high * 1.35, 0.3)))
    ax.set_xlim(*ends)
    for row, name, share in zip(rows, names, before, strict=True):
        _bar(ax, row + (0.18 if scale is not None else 0.0), share, BEFORE, ends)
        text = f"{100 * share.share.value:.0f}"
        if scale is not None and name in left:
            _bar(ax, row - 0.18, left[name], AFTER, ends, scale=scale, interval=abs(scale) > least_share)
            text += f" → {100 * scale * left[name].share.value + 0.0:.0f}"
        ax.annotate(
            f"{text} %".replace("-0 ", "0 ").replace("-", "−"),
            (1.0, row),
            (6, 0),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            va="center",
            color=INK,
            fontsize=9,
        )
    _name_rows(ax, rows, [words(name) for name in names])
    ax.set_ylim(-0.6, len(names) - 0.4)
    ax.axvline(0, color=MUTED, lw=0.8)
    ax.grid(axis="y", visible=False)
    ax.set_xlabel("share of the original gap [%]")


def _name_rows(ax: Axes, rows: NDArray[Any], names: Sequence[str], *, bold: Sequence[str] = ()) -> None:
    """Names to the left of rows."""
    ax.set_yticks([])
    for row, name in zip(rows, names, strict=True):
        ax.annotate(
            name,
            (0.0, float(row)),
            (-7, 0),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            ha="right",
            va="center",
            fontsize=9,
            weight="bold" if name in bold else "normal",
        )


def _bar(
    ax: Axes,
    row: float,
    share: Share,
    color: str,
    ends: tuple[float, float],
    *,
    scale: float = 1.0,
    interval: bool = True,
) -> None:
    value = 100 * scale * share.share.value
    ax.barh(row, np.clip(value, *ends), height=0.32, color=color, alpha=0.85)
    if interval:
        low, high = np.clip(np.sort(100 * scale * np.array([share.share.low, share.share.high])), *ends)
        ax.plot([low, high], [row, row], color=INK, lw=0.9)


@report_figure("gap_when", alt="Prediction errors of every toss over time, before and after, and their mean by phase.")
@styled
def gap_over_time(diagnosis: Diagnosis, settings: ReportSettings) -> Figure:
    """Every toss over time: the excess of its errors, before and after; below, the mean by phase.

    Args:
        diagnosis: What was found.
        settings: What the figure draws.

    Returns:
        The figure.
    """
    after = diagnosis.found != ()
    n = diagnosis.n_tosses
    tall = float(np.clip(0.055 * n, 1.3, 3.6))
    what = "" if not after else ", before (left) and with the named effects (right)"
    figure = new_figure(
        "When the errors occur",
        f"Top: each row is a toss{what}. Bottom: mean over all tosses, by phase.",
        height=3.45 + tall,
    )
    columns = 2 if after else 1
    axes = panel_grid(
        figure, 2, columns, left=0.75, right=1.15, top=1.15, bottom=0.95, between=0.45, above=0.3, heights=[tall, 1.7]
    )
    gaps = [diagnosis.gap, diagnosis.left][:columns]
    end = max((float(gap.frames[:, 1].max()) for gap in gaps if len(gap.frames)), default=1.0)
    order = _order(diagnosis.gap.frames, n)
    norm = LogNorm(vmin=settings.palest_excess, vmax=max(10.0, _highest(diagnosis.gap.frames)))
    image = None
    highest = 1.0
    for j, gap in enumerate(gaps):
        ax = axes[0, j]
        ax.set_title("with " + ", ".join(diagnosis.found) if j else "before", fontsize=9.5)
        table = _cells(gap.frames, n, end, settings.time_bin)[order]
        image = ax.imshow(
            np.maximum(table, settings.palest_excess),
            aspect="auto",
            norm=norm,
            cmap="YlOrRd",
            origin="lower",
            extent=(0.0, table.shape[1] * settings.time_bin, 0, n),
            interpolation="nearest",
        )
        ax.set_facecolor("#eef0f2")
        ax.grid(visible=False)
        ax.set_xlim(0, end)
        ax.set_yticks([])
        ax.set_xticklabels([])
        ax.tick_params(length=0)
        highest = max(highest, *_by_phase(axes[1, j], gap.frames, n, end, settings), 1.0)
    axes[0, 0].set_ylabel("tosses", labelpad=22)
    for j in range(columns):
        axes[1, j].set_yscale("symlog", linthresh=1.0, linscale=0.5)
        axes[1, j].set_ylim(-0.5, 2.0 * highest)
        axes[1, j].yaxis.set_major_formatter(plain)
        axes[1, j].set_xlim(0, end)
        axes[1, j].set_xlabel("time since release [s]")
        axes[1, j].axhline(0, color=MUTED, lw=0.8)
        if j:
            axes[1, j].set_yticklabels([])
    axes[1, 0].set_ylabel("excess over noise [1]")
    if image is not None:
        w = figure.get_figwidth()
        box = axes[0, -1].get_position()
        bar = figure.add_axes((box.x1 + 0.15 / w, box.y0, 0.13 / w, box.height))
        colors = figure.colorbar(image, cax=bar)
        colors.ax.yaxis.set_major_formatter(plain)
        colors.set_label("excess over noise [1]", fontsize=8.5)
    key_row(figure, [(Swatch(color=color), name) for name, color in PHASES.items()], y=0.72)
    footnote(
        figure,
        "Excess: deviance of a frame's whitened residuals beyond what noise gives; 0: no error. Grey: no frame.",
    )
    return figure


def plain(value: float, _: float) -> str:
    """A tick's label without trailing zeros, with a typographic minus.

    Args:
        value: The tick.

    Returns:
        The label.
    """
    return f"{value:g}".replace("-", "−")


def _highest(frames: Array) -> float:
    return float(np.percentile(frames[:, 3], 99)) if len(frames) else 10.0


def _order(frames: Array, n: int) -> NDArray[np.int64]:
    """Tosses by the time of their first contact."""
    first = np.full(n, np.inf)
    for i in range(n):
        own = frames[frames[:, 0] == i]
        touched = own[(own[:, 2] > Phase.FLIGHT)]
        first[i] = touched[:, 1].min() if len(touched) else np.inf
    return np.argsort(first, kind="stable")


def _cells(frames: Array, n: int, end: float, width: float) -> Array:
    """(n, bins) mean excess; NaN where a toss has no frame."""
    bins = max(1, int(np.ceil(end / width + 1e-9)))
    index = frames[:, 0].astype(int) * bins + np.minimum((frames[:, 1] / width - 1e-9).astype(int), bins - 1)
    count = np.bincount(index, minlength=n * bins)
    total = np.bincount(index, weights=frames[:, 3], minlength=n * bins)
    with np.errstate(invalid="ignore", divide="ignore"):
        return (total / count).reshape(n, bins)


def _by_phase(ax: Axes, frames: Array, n: int, end: float, settings: ReportSettings) -> list[float]:
    """A line for each phase; returns the highest value of each."""
    highest, width = [], 2 * settings.time_bin
    for name, color in PHASES.items():
        own = frames[frames[:, 2] == int(Phase[name.upper()])]
        if not len(own):
            continue
        bins = np.minimum((own[:, 1] / width).astype(int), int(end / width))
        count = np.bincount(bins)
        total = np.bincount(bins, weights=own[:, 3])
        enough = count >= max(3, settings.phase_line_frames * n)
        if not enough.any():
            continue
        x, y = (np.arange(len(count)) + 0.5) * width, np.full(len(count), np.nan)
        y[enough] = total[enough] / count[enough]
        ax.plot(x, np.maximum(y, -0.4), color=color, marker=".", ms=4, lw=1.4, label=name)
        highest.append(float(np.nanmax(y)))
    return highest


@report_figure("gap_which", alt="Gain of log-likelihood by effect, with intervals, coloured by verdict.")
@styled
def evidence(diagnosis: Diagnosis, settings: ReportSettings) -> Figure:
    """Gain of held-out log-likelihood per toss by each effect, with its interval, coloured by verdict.

    Args:
        diagnosis: What was found.
        settings: What the figure draws.

    Returns:
        The figure.
    """
    tried = [f for f in diagnosis.findings if f.evidence.get("gain", 0.0) != 0.0 or f.verdict in FOUND]
    others = [f for f in diagnosis.findings if f not in tried]
    figure = new_figure(
        "Which effect explains it",
        "Gain of log-likelihood on tosses that were not used for the fit, over the simulator without the effect. Each\n"
        "named effect after the first is added to a simulator that has those named before it.",
        height=2.45 + 0.3 * max(len(tried), 2),
    )
    (ax,) = panel_grid(figure, 1, 1, left=1.75, right=1.65, top=1.3, bottom=1.05)[0]
    rows = np.arange(len(tried))[::-1]
    spans = [gain_per_toss(f) for f in tried]
    top = max([high for _, _, high in spans] + [1.0])
    for row, finding, (value, low, high) in zip(rows, tried, spans, strict=True):
        color = VERDICTS[finding.verdict][1]
        ax.plot([max(low, -0.5), high], [row, row], color=color, lw=3, alpha=0.55, solid_capstyle="butt")
        ax.plot([value], [row], "o", color=color, ms=6)
        text = f"{value:.1f}" if abs(value) < 100 else f"{value:.0f}"
        closes = min(finding.gap_closed.value, 1.0)
        ax.annotate(
            f"{text}, closes {100 * closes:.0f} %".replace("-", "−"),
            (1.0, row),
            (8, 0),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            va="center",
            fontsize=8.5,
            color=INK if finding.verdict in FOUND else MUTED,
        )
    ax.set_xscale("symlog", linthresh=1.0, linscale=0.4)
    ax.set_xlim(-0.6, top * 1.6)
    ax.xaxis.set_major_formatter(plain)
    _name_rows(ax, rows, [f.name for f in tried], bold=diagnosis.named)
    ax.set_ylim(-0.7, max(len(tried), 1) - 0.3)
    ax.grid(axis="y", visible=False)
    ax.axvline(0, color=GRID, lw=1.5)
    ax.set_xlabel("gain of log-likelihood per toss [nats]")
    if not tried:
        ax.text(
            0.5,
            0.5,
            "the screening ruled out every effect",
            transform=ax.transAxes,
            ha="center",
            va="center",
            color=MUTED,
        )
    used = dict.fromkeys(f.verdict for f in tried)
    key_row(figure, [(Swatch(color=VERDICTS[v][1]), VERDICTS[v][0]) for v in VERDICTS if v in used], y=0.92)
    note = "Bars: 95 % intervals over tosses. Bold: named."
    if others:
        note += f" Not drawn: {len(others)} effects that the screening ruled out."
    footnote(figure, note)
    return figure


def gain_per_toss(finding: Finding) -> tuple[float, float, float]:
    """Mean gain of log-likelihood per toss, with the lower and upper end of its 95 % interval [nats].

    The interval is Student's over tosses; the spread over tosses follows from the one-sided p-value.

    Args:
        finding: What the tosses say of one effect.

    Returns:
        Mean, lower end, upper end; all equal to the mean where no interval can be given.
    """
    e = finding.evidence
    n = max(int(e.get("n_tosses", 1)), 1)
    mean = float(e.get("gain", 0.0)) / n
    p = float(np.clip(e.get("p_value", 1.0), 1e-300, 1 - 1e-12))
    if n < 3 or mean == 0.0:
        return mean, mean, mean
    statistic = float(student.isf(p, n - 1))
    if statistic * mean <= 0:
        return mean, mean, mean
    half = float(student.ppf(0.975, n - 1)) * mean / statistic
    return mean, mean - half, mean + half
