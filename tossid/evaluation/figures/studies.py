"""Studies over cells: given gravity, number of training tosses, starts of the inertia."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from tossid.evaluation.figures.cells import (
    Cell,
    Series,
    chosen,
    draw_series,
    how_pooled,
    limits_from_zero,
    models_in,
    name_series,
    nothing_here,
    pool,
)
from tossid.evaluation.figures.style import MUTED, fixed, footnote, halo, look, new_figure, panel_grid, styled
from tossid.objects import GRAVITY

METRICS = {
    "gravity_ms2": ("Gravity recovered", "gravity [m/s²]"),
    "penetration_mm": ("Penetration", "penetration [mm]"),
    "rotation_error_deg": ("Rotation error", "rotation error [deg]"),
    "position_error_pct": ("Position error", "position error [% of width]"),
}
"""The metrics of an evaluation: panel title, axis label."""


@styled
def gravity_sweep(
    cells: Sequence[Cell],
    *,
    measured_penetration_mm: float | None = None,
    from_flight: bool = False,
) -> Figure:
    """The four metrics against the gravity that the given model has (Bianchini and Posa 2023, Figure 4).

    Args:
        cells: Dictionaries with `model`, `seed`, `gravity` (the given model's [m/s²]) and the metrics of an evaluation
            as {"mean", "ci95"}.
        measured_penetration_mm: Penetration of the measured motions themselves, as a reference [mm].
        from_flight: Whether to draw the metrics under each cell's `from_flight`.

    Returns:
        The figure.

    Raises:
        InputError: There are no cells, or some lack the metrics.
    """
    cells = [{**cell, "_fraction": float(cell["gravity"]) / GRAVITY} for cell in chosen(cells, from_flight=from_flight)]
    models = models_in(cells)
    found = {m: [pool(cells, model=name, swept="_fraction", metric=m) for name in models] for m in METRICS}
    slopes = [
        f"{look(one.name, others=models).label} {fixed(_slope(one))}" for one in found["gravity_ms2"] if len(one.x) > 1
    ]
    shares = np.unique([cell["_fraction"] for cell in cells])
    subtitle = (
        f"Rollouts on held-out tosses by models that were given {shares.min():.2g} to {shares.max():.2g} times "
        "the true gravity."
    )
    if slopes:
        subtitle += f"\nGravity recovered per gravity given (1: no repair, 0: full repair): {',  '.join(slopes)}"
    figure = new_figure("Wrong gravity given: who repairs it?", subtitle, height=7.4)
    axes = panel_grid(figure, 2, 2, left=0.7, right=1.0, top=1.35, bottom=0.95, between=1.5, above=0.85)
    span = max(float(np.ptp(shares)), 0.1)
    for ax, (metric, (name, label)) in zip(axes.flat, METRICS.items(), strict=True):
        series = found[metric]
        ax.set_title(name)
        ax.set_ylabel(label)
        ax.set_xlabel("given gravity / 9.81 m/s² [1]")
        ax.set_xlim(shares.min() - 0.05 * span, shares.max() + 0.05 * span)
        references: dict[str, float] = {}
        if metric == "penetration_mm" and measured_penetration_mm is not None:
            references["measured"] = measured_penetration_mm
        if metric == "gravity_ms2":
            references["true 9.81"] = GRAVITY
            limits_from_zero(ax, series, also=[GRAVITY, GRAVITY * shares.max()])
            _no_repair(ax, float(shares.max()))
        else:
            limits_from_zero(ax, series, also=list(references.values()))
        _finish(ax, series, references, dodge=0.008 * span)
    footnote(figure, how_pooled(cells))
    return figure


def _slope(series: Series) -> float:
    """Gravity recovered per gravity given: 1 where the wrong gravity stays, 0 where it is repaired."""
    return float(np.polyfit(GRAVITY * series.x, series.mean, 1)[0])


def _no_repair(ax: Axes, top: float) -> None:
    """What a model that repairs nothing shows."""
    ax.plot([0, top], [0, top * GRAVITY], color=MUTED, lw=1.1, ls=":", zorder=2, label="no repair")
    at = 0.3 * top
    text = ax.annotate(
        "no repair", (at, at * GRAVITY), (8, -8), textcoords="offset points", color=MUTED, fontsize=8.5, va="top"
    )
    halo(text)


def _finish(
    ax: Axes, series: Sequence[Series], references: dict[str, float], *, dodge: float, log2: bool = False
) -> None:
    """Reference levels, lines and their names, in axes whose limits are set."""
    for name, level in references.items():
        ax.axhline(level, color=MUTED, lw=1.1, ls="--", zorder=2, label=name)
    if any(len(one.x) for one in series):
        draw_series(ax, series, dodge=dodge, log2=log2)
    else:
        nothing_here(ax)
    name_series(ax, series, references)


@styled
def data_efficiency(
    cells: Sequence[Cell],
    *,
    swept: str = "n_tosses",
    from_flight: bool = False,
) -> Figure:
    """Metrics against the number of training tosses, on a base-2 logarithmic axis.

    Args:
        cells: Dictionaries with `model`, `seed`, the number of training tosses under `swept`, and the metrics of an
            evaluation as {"mean", "ci95"}.
        swept: Key of the number of training tosses.
        from_flight: Whether to draw the metrics under each cell's `from_flight`.

    Returns:
        The figure.

    Raises:
        InputError: There are no cells, or some lack the metrics.
    """
    cells = chosen(cells, from_flight=from_flight)
    models = models_in(cells)
    counts = np.unique([float(cell[swept]) for cell in cells])
    subtitle = "Rollouts on held-out tosses, after training on more and more tosses."
    figure = new_figure("How many tosses does it take?", subtitle, height=7.0)
    axes = panel_grid(figure, 2, 2, left=0.7, right=1.0, top=1.1, bottom=0.95, between=1.5, above=0.85)
    order = ("position_error_pct", "rotation_error_deg", "penetration_mm", "gravity_ms2")
    for ax, metric in zip(axes.flat, order, strict=True):
        name, label = METRICS[metric]
        series = [pool(cells, model=model, swept=swept, metric=metric) for model in models]
        ax.set_title(name)
        ax.set_ylabel(label)
        ax.set_xlabel("training tosses [count]")
        log2_axis(ax, counts.tolist())
        references = {"true 9.81": GRAVITY} if metric == "gravity_ms2" else {}
        if references:
            _around(ax, series, GRAVITY)
        else:
            limits_from_zero(ax, series)
        _finish(ax, series, references, dodge=0.06, log2=True)
    footnote(figure, how_pooled(cells))
    return figure


def log2_axis(ax: Axes, values: Sequence[float], *, room: float = 0.3) -> None:
    """Make the x axis logarithmic to base 2, with a tick at every value.

    Args:
        ax: The axes.
        values: The values.
        room: Free room beyond the ends [powers of 2].
    """
    ax.set_xscale("log", base=2)
    ax.set_xlim(min(values) * 2.0**-room, max(values) * 2.0**room)
    ax.xaxis.set_major_locator(FixedLocator(list(values)))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter(lambda value, _: f"{value:g}")


def _around(ax: Axes, series: Sequence[Series], center: float) -> None:
    """The y axis around a true value, as wide as what is drawn."""
    values = np.concatenate([[center], *[np.r_[s.mean, s.low, s.high, s.points[:, 1]] for s in series]])
    values = values[np.isfinite(values)]
    room = max(0.12 * float(np.ptp(values)), 0.02 * abs(center))
    ax.set_ylim(values.min() - room, values.max() + room)
