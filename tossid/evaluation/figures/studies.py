"""Studies: metrics over the given gravity or the number of tosses, and starts of the inertia."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.evaluation.figures.style import (
    LOOKS,
    MUTED,
    SMALL,
    footnote,
    halo,
    key_row,
    label_ends,
    look,
    new_figure,
    panel_grid,
    sample,
    styled,
)
from tossid.objects import GRAVITY

Array = NDArray[np.float64]
Cell = Mapping[str, Any]
"""One training and its evaluation: `model`, `seed`, the swept value, and metrics as {"mean", "ci95"} or numbers."""

METRICS = {
    "gravity_ms2": ("Gravity recovered", "gravity [m/s²]"),
    "penetration_mm": ("Penetration", "penetration [mm]"),
    "rotation_error_deg": ("Rotation error", "rotation error [deg]"),
    "position_error_pct": ("Position error", "position error [% of width]"),
}
"""The metrics of an evaluation: panel title, axis label."""
NONE = float("nan")


def value_of(cell: Cell, key: str) -> tuple[float, float, float]:
    """A metric of a cell with the ends of its 95 % interval; NaN where the cell lacks it."""
    value = cell.get(key)
    if not isinstance(value, Mapping):
        return (NONE if value is None else float(value),) * 3
    mean = NONE if value["mean"] is None else float(value["mean"])
    low, high = (
        mean if end is None or not np.isfinite(end) else float(end) for end in value.get("ci95") or (mean,) * 2
    )
    return mean, low, high


def models_in(cells: Sequence[Cell], *, key: str = "model") -> list[str]:
    """What cells name by a key, their models: known ones in their usual order, others after them."""
    found = list(dict.fromkeys(str(cell[key]) for cell in cells))
    return [name for name in LOOKS if name in found] + [name for name in found if name not in LOOKS]


@dataclass(frozen=True)
class Series:
    """One model's metric over a swept value.

    Attributes:
        name: The model.
        x: The swept values (n,), increasing.
        mean: Means of the metric over seeds (n,).
        low: Means over seeds of the lower end of its 95 % interval over tosses (n,).
        high: The same of the upper end (n,).
        points: Swept value and metric of the single seeds (m, 2).
    """

    name: str
    x: Array
    mean: Array
    low: Array
    high: Array
    points: Array


def pool(cells: Sequence[Cell], *, model: str, swept: str, metric: str) -> Series:
    """The series of one model; cells whose metric is missing or not finite take no part.

    Args:
        cells: The cells of all models.
        model: The model's name.
        swept: Key of the swept value.
        metric: Key of the metric.
    """
    rows = [(float(c[swept]), *value_of(c, metric)) for c in cells if str(c["model"]) == model]
    table = np.array([row for row in rows if np.isfinite(row[1])]).reshape(-1, 4)
    x = np.unique(table[:, 0])
    pooled = np.array([table[table[:, 0] == value, 1:].mean(axis=0) for value in x]).reshape(-1, 3)
    mean, low, high = pooled.T
    return Series(model, x, mean, low, high, table[:, :2])


def _chosen(cells: Sequence[Cell], *, from_flight: bool) -> list[Cell]:
    """The cells, with the metrics of rollouts from the first state, or from the state estimated over the flight."""
    if not cells:
        raise InputError("no cells to draw")
    missing = sum("from_flight" not in cell for cell in cells)
    if from_flight and missing:
        raise InputError(f"{missing} of {len(cells)} cells have no 'from_flight' metrics")
    return [{**cell, **cell["from_flight"]} if from_flight else cell for cell in cells]


@styled
def gravity_sweep(
    cells: Sequence[Cell], *, measured_penetration_mm: float | None = None, from_flight: bool = False
) -> Figure:
    """The four metrics against the gravity that the given model has (Bianchini and Posa 2023, Figure 4).

    Args:
        cells: Cells with `gravity` (the given model's [m/s²]).
        measured_penetration_mm: Penetration of the measured motions themselves, as a reference [mm].
        from_flight: Whether to draw the metrics under each cell's `from_flight`.

    Raises:
        InputError: There are no cells, or some lack the metrics.
    """
    cells = [{**cell, "share": float(cell["gravity"]) / GRAVITY} for cell in _chosen(cells, from_flight=from_flight)]
    models = models_in(cells)
    found = {metric: [pool(cells, model=name, swept="share", metric=metric) for name in models] for metric in METRICS}
    # gravity recovered per gravity given: 1 where the wrong gravity stays, 0 where it is repaired
    slopes = {s.name: np.polyfit(GRAVITY * s.x, s.mean, 1)[0] for s in found["gravity_ms2"] if len(s.x) > 1}
    words = [f"{look(name, others=models).label} {round(slope, 2) + 0.0:.2f}" for name, slope in slopes.items()]
    shares = np.unique([cell["share"] for cell in cells])
    subtitle = f"Rollouts on held-out tosses by models that were given {shares.min():.2g} to {shares.max():.2g} times "
    subtitle += "the true gravity."
    if words:
        repaired = ",  ".join(words).replace("-", "−")
        subtitle += f"\nGravity recovered per gravity given (1: no repair, 0: full repair): {repaired}"
    figure = new_figure("Wrong gravity given: who repairs it?", subtitle, height=7.4)
    axes = panel_grid(figure, 2, 2, left=0.7, right=1.0, top=1.35, bottom=0.95, between=1.5, above=0.85)
    span, top = max(float(np.ptp(shares)), 0.1), float(shares.max())
    for ax, (metric, series) in zip(axes.flat, found.items(), strict=True):
        ax.set_xlabel("given gravity / 9.81 m/s² [1]")
        ax.set_xlim(shares.min() - 0.05 * span, top + 0.05 * span)
        references: dict[str, float] = {}
        if metric == "penetration_mm" and measured_penetration_mm is not None:
            references["measured"] = measured_penetration_mm
        if metric == "gravity_ms2":
            references["true 9.81"] = GRAVITY
            ax.plot([0, top], [0, top * GRAVITY], color=MUTED, lw=1.1, ls=":", zorder=2, label="no repair")
            at, form = (0.3 * top, 0.3 * top * GRAVITY), {"textcoords": "offset points", "va": "top"}
            halo(ax.annotate("no repair", at, (8, -8), color=MUTED, fontsize=SMALL, **form))
        _limits_from_zero(
            ax, series, also=[*references.values(), *([GRAVITY * top] if metric == "gravity_ms2" else [])]
        )
        _panel(ax, metric, series, references, dodge=0.008 * span)
    footnote(figure, _how_pooled(cells))
    return figure


@styled
def data_efficiency(cells: Sequence[Cell], *, swept: str = "n_tosses", from_flight: bool = False) -> Figure:
    """Metrics against the number of training tosses, on a base-2 logarithmic axis.

    Args:
        cells: Cells with the number of training tosses under `swept`.
        swept: Key of the number of training tosses.
        from_flight: Whether to draw the metrics under each cell's `from_flight`.

    Raises:
        InputError: There are no cells, or some lack the metrics.
    """
    cells = _chosen(cells, from_flight=from_flight)
    counts = np.unique([float(cell[swept]) for cell in cells])
    subtitle = "Rollouts on held-out tosses, after training on more and more tosses."
    figure = new_figure("How many tosses does it take?", subtitle, height=7.0)
    axes = panel_grid(figure, 2, 2, left=0.7, right=1.0, top=1.1, bottom=0.95, between=1.5, above=0.85)
    order = ("position_error_pct", "rotation_error_deg", "penetration_mm", "gravity_ms2")
    for ax, metric in zip(axes.flat, order, strict=True):
        series = [pool(cells, model=model, swept=swept, metric=metric) for model in models_in(cells)]
        ax.set_xlabel("training tosses [count]")
        _log2_axis(ax, counts.tolist())
        references = {"true 9.81": GRAVITY} if metric == "gravity_ms2" else {}
        if references:  # around the truth, as wide as what is drawn
            values = _drawn(series, ("mean", "low", "high"), also=[GRAVITY])
            room = max(0.12 * float(np.ptp(values)), 0.02 * GRAVITY)
            ax.set_ylim(values.min() - room, values.max() + room)
        else:
            _limits_from_zero(ax, series)
        _panel(ax, metric, series, references, dodge=0.06, log2=True)
    footnote(figure, _how_pooled(cells))
    return figure


def _panel(
    ax: Axes, metric: str, series: Sequence[Series], references: dict[str, float], *, dodge: float, log2: bool = False
) -> None:
    """A metric's lines with interval bars, single seeds as dots, reference levels, and names at the right ends.

    The axes' limits are set. Models are moved apart along x by `dodge`; where `log2`, by 2 to the power of it.
    """
    title, label = METRICS[metric]
    ax.set_title(title)
    ax.set_ylabel(label)
    for name, level in references.items():
        ax.axhline(level, color=MUTED, lw=1.1, ls="--", zorder=2, label=name)
    names = [one.name for one in series]
    ends = []
    for i, one in enumerate(series):
        if not len(one.x):
            continue
        style = look(one.name, others=names)
        shift = dodge * (i - 0.5 * (len(series) - 1))
        x, seeds = (at * 2.0**shift if log2 else at + shift for at in (one.x, one.points[:, 0]))
        bars = np.maximum(np.stack([one.mean - one.low, one.high - one.mean]), 0)
        form: dict[str, Any] = {"marker": style.marker, "ms": 5, "lw": 1.6, "elinewidth": 1.4, "capsize": 2.5}
        drawn = ax.errorbar(x, one.mean, yerr=bars, color=style.color, zorder=4 + i, label=one.name, **form)
        drawn.lines[0].set_label(one.name)
        if len(one.points) > len(one.x):
            form = {"ms": 2.6, "mfc": "white", "mec": style.color, "mew": 0.6, "zorder": 20}
            ax.plot(seeds, one.points[:, 1], "o", label=f"{one.name} seeds", **form)
        ends.append((float(one.x[-1]), float(one.mean[-1]), style.label, style.color))
    if not ends:
        ax.text(0.5, 0.5, "not recorded", transform=ax.transAxes, ha="center", va="center", style="italic")
    right = ax.get_xlim()[1]
    label_ends(ax, ends + [(right, level, name, MUTED) for name, level in references.items()])


def _drawn(series: Sequence[Series], parts: Sequence[str], *, also: Sequence[float] = ()) -> Array:
    """All finite values of series, and others."""
    values = np.concatenate([np.asarray(also, dtype=float), *[getattr(s, part) for s in series for part in parts]])
    values = np.concatenate([values, *[s.points[:, 1] for s in series]])
    return values[np.isfinite(values)]


def _limits_from_zero(ax: Axes, series: Sequence[Series], *, also: Sequence[float] = ()) -> None:
    """The y axis from zero to the largest finite mean, interval end or given value."""
    values = _drawn(series, ("mean", "high"), also=also)
    top = values.max(initial=0.0) or 1.0
    ax.set_ylim(min(0.0, 1.1 * values.min(initial=0.0)), 1.08 * top)


def _how_pooled(cells: Sequence[Cell]) -> str:
    seeds = len({cell.get("seed") for cell in cells})
    text = "Bars: 95 % intervals over held-out tosses"
    if seeds > 1:
        text += f", averaged over the {seeds} seeds, as are the lines. Open dots: single seeds"
    return text + "."


def _log2_axis(ax: Axes, values: Sequence[float], *, room: float = 0.3) -> None:
    """Make the x axis logarithmic to base 2, with a tick at every value and free room [powers of 2] at the ends."""
    ax.set_xscale("log", base=2)
    ax.set_xlim(min(values) * 2.0**-room, max(values) * 2.0**room)
    ax.xaxis.set_major_locator(FixedLocator(list(values)))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter(lambda value, _: f"{value:g}")


REACHED_INERTIA_PCT, REACHED_COM_MM = 5.0, 1.0
"""Errors of the inertia and of the centre of mass below which a start has reached the truth."""
REACHED_COLOR = "#dcefe4"


@styled
def inertia_study(cells: Sequence[Cell]) -> Figure:
    """For each parameterisation: the error each start had (open) and the error that was learned (filled).

    Upper row: relative error of the inertia against the start's scale. Lower row: error of the centre of mass against
    the start's offset, or against the scale too where all starts have one offset. The band of starts that reached the
    truth is marked, and these starts are counted.

    Args:
        cells: Dictionaries with `parameterisation`, `seed`, `inertia_scale` (start: learned from scale times the truth)
            [1], `com_offset_m` (start) [m], and what was learned: `inertia_error_rel` [1], `com_error_m` [m], each a
            number or {"mean", "ci95"}.

    Raises:
        InputError: There are no cells.
    """
    cells = _chosen(cells, from_flight=False)
    kinds = models_in(cells, key="parameterisation")
    reached = (REACHED_INERTIA_PCT, REACHED_COM_MM)
    # (cells, 4) start, learned, low, high: relative error of the inertia [%], error of the centre of mass [mm]
    inertia = 100 * np.array([(abs(c["inertia_scale"] - 1), *value_of(c, "inertia_error_rel")) for c in cells])
    com = 1e3 * np.array([(abs(c["com_offset_m"]), *value_of(c, "com_error_m")) for c in cells])
    scale = np.array([float(c["inertia_scale"]) for c in cells])
    offset = 1e3 * np.array([float(c["com_offset_m"]) for c in cells])
    offsets = np.unique(offset)
    tops = [max(least, float(np.nanmax(errors[:, :2]))) for least, errors in zip(reached, (inertia, com), strict=True)]
    subtitle = "Every start's error before learning (open) and after (filled)."
    figure = new_figure("From a wrong inertia to the true one", subtitle, height=7.2)
    axes = panel_grid(figure, 2, len(kinds), left=0.8, right=0.25, top=1.55, bottom=0.9, between=0.3, above=0.85)
    entries = [
        (sample(MUTED, marker="o", mfc="white", ms=5.5), "start"),
        (sample(marker="o", ms=5.5), "learned, with 95 % interval where known"),
        (sample(REACHED_COLOR, lw=8), f"reached the truth ({reached[0]:g} %, {reached[1]:g} mm)"),
    ]
    key_row(figure, entries, y=0.74)
    for (upper, lower), kind in zip(axes.T, kinds, strict=True):
        own = np.array([str(c["parameterisation"]) == kind for c in cells])
        style = look(kind, others=kinds)
        both = int(np.sum((inertia[own, 1] <= reached[0]) & (com[own, 1] <= reached[1])))
        upper.set_title(f"{style.label}\n{both} of {own.sum()} reached", color=style.color, fontsize=9.5)
        for ax in (upper, lower):
            _log2_axis(ax, np.unique(scale).tolist(), room=0.5)
            ax.set_xlabel("start: inertia / true inertia [1]")
        _starts(upper, scale[own], inertia[own], reached[0], tops[0], style.color)
        if len(offsets) > 1:
            step = float(np.diff(offsets).min())
            lower.set_xscale("linear")
            lower.set_xlim(offsets.min() - 0.5 * step, offsets.max() + 0.5 * step)
            if len(offsets) <= 7:
                lower.set_xticks(offsets, [f"{o:.3g}" for o in offsets])
            lower.set_xlabel("start: offset of centre of mass [mm]")
            _starts(lower, offset[own], com[own], reached[1], tops[1], style.color, step=step)
        else:
            _starts(lower, scale[own], com[own], reached[1], tops[1], style.color)
        for ax, label in ((upper, "error of the inertia [%]"), (lower, "error of the centre of mass [mm]")):
            first = kind == kinds[0]
            ax.set_ylabel(label if first else "")
            ax.tick_params(labelleft=first)
    footnote(figure, "Error axes are linear inside the marked band and logarithmic above it.")
    return figure


def _starts(
    ax: Axes, x: Array, errors: Array, reached: float, top: float, color: str, *, step: float | None = None
) -> None:
    """An arrow from each start's error to the learned one, on an axis that is linear inside the band.

    x: (n,) start. errors: (n, 4) start, learned, low, high. Starts of equal x are set side by side: by shares of `step`
    on a linear axis, by powers of 2 on a logarithmic one.
    """
    ax.set_yscale("symlog", linthresh=reached, linscale=0.6)
    ax.set_ylim(0, max(1.6 * top, 3 * reached))
    ax.axhspan(0, reached, color=REACHED_COLOR, lw=0, zorder=0, label="reached")
    shift = np.zeros(len(x))
    for value in np.unique(x):
        members = np.flatnonzero(x == value)
        members = members[np.argsort(errors[members, 0] + 1e-3 * errors[members, 1], kind="stable")]
        shift[members] = np.linspace(-0.3, 0.3, len(members)) if len(members) > 1 else 0.0
    place = x * 2.0**shift if step is None else x + step * shift
    for p, (start, learned, low, high) in zip(place, errors, strict=True):
        if np.isfinite(learned):
            ax.plot([p, p], [start, learned], color=color, lw=0.9, alpha=0.45, zorder=2, label="_way")
            ax.plot([p, p], [low, high], color=color, lw=2.4, alpha=0.6, zorder=3, label="_interval")
    ax.plot(place, errors[:, 0], "o", mfc="white", mec=MUTED, mew=1.0, ms=4.5, zorder=3, clip_on=False, label="start")
    ax.plot(place, errors[:, 1], "o", color=color, mec="white", mew=0.5, ms=5.5, zorder=4, label="learned")
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    ticks = [0.0, 0.5 * reached, reached, *(reached * first * 10.0**k for k in range(4) for first in (3, 10))]
    ax.set_yticks([v for v in ticks if v <= ax.get_ylim()[1]])
    failed = int((~np.isfinite(errors[:, 1])).sum())
    if failed:
        halo(ax.text(0.98, 0.97, f"no result: {failed}", transform=ax.transAxes, ha="right", va="top", fontsize=SMALL))
