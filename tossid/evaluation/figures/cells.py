"""Cells of a study as series: seeds pooled, each metric against the swept value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.evaluation.figures.style import LOOKS, MUTED, Look, label_ends, look

Array = NDArray[np.float64]
Cell = Mapping[str, Any]


@dataclass(frozen=True)
class Series:
    """One model's metric over a swept value.

    x (n,): the swept values, increasing. mean, low, high (n,): means over seeds of
    the metric and of the ends of its 95 % interval over tosses. points (m, 2): (x, metric) of the single seeds.
    """

    name: str
    x: Array
    mean: Array
    low: Array
    high: Array
    points: Array


def value_of(cell: Cell, key: str) -> tuple[float, float, float]:
    """(mean, low, high) of a metric, which is {"mean", "ci95"} or a bare number; NaN where the cell lacks it."""
    value = cell.get(key)
    if value is None:
        return (float("nan"),) * 3
    if isinstance(value, Mapping):
        mean = float(value["mean"]) if value["mean"] is not None else float("nan")
        ends = value.get("ci95") or (mean, mean)
        low, high = (mean if end is None or not np.isfinite(end) else float(end) for end in ends)
        return mean, low, high
    return (float(value),) * 3


def models_in(cells: Sequence[Cell], *, key: str = "model") -> list[str]:
    """The models of a study: known ones in their usual order, others after them."""
    found = list(dict.fromkeys(str(cell[key]) for cell in cells))
    return [name for name in LOOKS if name in found] + [name for name in found if name not in LOOKS]


def pool(cells: Sequence[Cell], *, model: str, swept: str, metric: str, by: str = "model") -> Series:
    """The series of one model; cells whose metric is missing or not finite take no part."""
    rows = [(float(c[swept]), *value_of(c, metric)) for c in cells if str(c[by]) == model]
    table = np.array([row for row in rows if np.isfinite(row[1])]).reshape(-1, 4)
    x = np.unique(table[:, 0])
    pooled = np.array([table[table[:, 0] == value, 1:].mean(axis=0) for value in x]).reshape(-1, 3)
    return Series(model, x, pooled[:, 0], pooled[:, 1], pooled[:, 2], table[:, :2])


def draw_series(ax: Axes, series: Sequence[Series], *, dodge: float = 0.0, log2: bool = False) -> dict[str, Look]:
    """Lines with interval bars; single seeds as dots where there are several. Names go on with `name_series`.

    dodge: models are moved apart by this much of the x axis (a factor's logarithm to base 2 where log2).
    """
    names = [one.name for one in series]
    looks = {name: look(name, others=names) for name in names}
    for i, one in enumerate(series):
        if not len(one.x):
            continue
        shift = dodge * (i - 0.5 * (len(series) - 1))
        moved = one.x * 2.0**shift if log2 else one.x + shift
        style = looks[one.name]
        bars = ax.errorbar(
            moved,
            one.mean,
            yerr=np.maximum(np.stack([one.mean - one.low, one.high - one.mean]), 0),
            color=style.color,
            marker=style.marker,
            ms=5,
            lw=1.6,
            elinewidth=1.4,
            capsize=2.5,
            zorder=4 + i,
            label=one.name,
        )
        bars.lines[0].set_label(one.name)
        if len(one.points) > len(one.x):
            x = one.points[:, 0] * 2.0**shift if log2 else one.points[:, 0] + shift
            ax.plot(
                x,
                one.points[:, 1],
                "o",
                ms=2.6,
                mfc="white",
                mec=style.color,
                mew=0.6,
                zorder=20,
                label=f"{one.name} seeds",
            )
    return looks


def name_series(ax: Axes, series: Sequence[Series], references: Mapping[str, float] | None = None) -> None:
    """Each line's name at its right end, and those of the reference levels; the limits must be set."""
    looks = {one.name: look(one.name, others=[s.name for s in series]) for one in series}
    ends = [(one.x[-1], one.mean[-1], looks[one.name].label, looks[one.name].color) for one in series if len(one.x)]
    right = ax.get_xlim()[1]
    label_ends(ax, ends + [(right, level, name, MUTED) for name, level in (references or {}).items()])


def limits_from_zero(ax: Axes, series: Sequence[Series], *, also: Sequence[float] = (), room: float = 0.08) -> None:
    """The y axis from zero to the largest finite mean, interval end or given value."""
    values = np.concatenate([np.asarray(also, dtype=float), *[np.r_[s.mean, s.high, s.points[:, 1]] for s in series]])
    values = values[np.isfinite(values)]
    top = values.max() if len(values) else 1.0
    ax.set_ylim(min(0.0, 1.1 * values.min()) if len(values) else 0.0, (top if top > 0 else 1.0) * (1 + room))


def nothing_here(ax: Axes) -> None:
    """Say that no cell has the metric."""
    ax.text(0.5, 0.5, "not recorded", transform=ax.transAxes, ha="center", va="center", style="italic")


def chosen(cells: Sequence[Cell], *, from_flight: bool) -> list[Cell]:
    """The cells; with from_flight, their metrics of rollouts that start from the state estimated over the flight."""
    if not cells:
        raise InputError("no cells to draw")
    if not from_flight:
        return list(cells)
    missing = sum("from_flight" not in cell for cell in cells)
    if missing:
        raise InputError(f"{missing} of {len(cells)} cells have no 'from_flight' metrics")
    return [{**cell, **cell["from_flight"]} for cell in cells]


def how_pooled(cells: Sequence[Cell]) -> str:
    """What bars and dots mean, in a footnote's words."""
    seeds = len({cell.get("seed") for cell in cells})
    text = "Bars: 95 % intervals over held-out tosses"
    if seeds > 1:
        text += f", averaged over the {seeds} seeds, as are the lines. Open dots: single seeds"
    return text + "."
