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


def value_of(cell: Cell, key: str) -> tuple[float, float, float]:
    """A metric of a cell with its 95 % interval.

    Args:
        cell: The cell.
        key: The metric; its value is {"mean", "ci95"} or a number.

    Returns:
        Mean, lower and upper end; NaN where the cell lacks the metric.
    """
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
    """The models of a study: known ones in their usual order, others after them.

    Args:
        cells: The cells.
        key: What a cell names its model by.

    Returns:
        The names.
    """
    found = list(dict.fromkeys(str(cell[key]) for cell in cells))
    return [name for name in LOOKS if name in found] + [name for name in found if name not in LOOKS]


def pool(cells: Sequence[Cell], *, model: str, swept: str, metric: str) -> Series:
    """The series of one model; cells whose metric is missing or not finite take no part.

    Args:
        cells: The cells of all models.
        model: The model's name.
        swept: Key of the swept value.
        metric: Key of the metric.

    Returns:
        The series.
    """
    rows = [(float(c[swept]), *value_of(c, metric)) for c in cells if str(c["model"]) == model]
    table = np.array([row for row in rows if np.isfinite(row[1])]).reshape(-1, 4)
    x = np.unique(table[:, 0])
    pooled = np.array([table[table[:, 0] == value, 1:].mean(axis=0) for value in x]).reshape(-1, 3)
    return Series(model, x, pooled[:, 0], pooled[:, 1], pooled[:, 2], table[:, :2])


def draw_series(ax: Axes, series: Sequence[Series], *, dodge: float = 0.0, log2: bool = False) -> dict[str, Look]:
    """Draw lines with interval bars, and single seeds as dots where there are several; `name_series` adds the names.

    Args:
        ax: The axes.
        series: A series for each model.
        dodge: Distance along x by which models are moved apart; where `log2`, the logarithm to base 2 of a factor.
        log2: Whether the x axis is logarithmic.

    Returns:
        The looks by model.
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
    """Write each line's name at its right end, and those of the reference levels.

    Args:
        ax: The axes, with their limits set.
        series: The series that were drawn.
        references: Levels by name.
    """
    looks = {one.name: look(one.name, others=[s.name for s in series]) for one in series}
    ends = [(one.x[-1], one.mean[-1], looks[one.name].label, looks[one.name].color) for one in series if len(one.x)]
    right = ax.get_xlim()[1]
    label_ends(ax, ends + [(right, level, name, MUTED) for name, level in (references or {}).items()])


def limits_from_zero(ax: Axes, series: Sequence[Series], *, also: Sequence[float] = (), room: float = 0.08) -> None:
    """Set the y axis from zero to the largest finite mean, interval end or given value.

    Args:
        ax: The axes.
        series: The series that will be drawn.
        also: Further values that must be inside.
        room: Share of free room above.
    """
    values = np.concatenate([np.asarray(also, dtype=float), *[np.r_[s.mean, s.high, s.points[:, 1]] for s in series]])
    values = values[np.isfinite(values)]
    top = values.max() if len(values) else 1.0
    ax.set_ylim(min(0.0, 1.1 * values.min()) if len(values) else 0.0, (top if top > 0 else 1.0) * (1 + room))


def nothing_here(ax: Axes) -> None:
    """Write into the axes that no cell has the metric.

    Args:
        ax: The axes.
    """
    ax.text(0.5, 0.5, "not recorded", transform=ax.transAxes, ha="center", va="center", style="italic")


def chosen(cells: Sequence[Cell], *, from_flight: bool) -> list[Cell]:
    """The cells, with the metrics of one kind of rollout.

    Args:
        cells: The cells.
        from_flight: Whether the metrics are those of rollouts from the state that is estimated over the flight.

    Returns:
        The cells.

    Raises:
        InputError: There are no cells, or some lack these metrics.
    """
    if not cells:
        raise InputError("no cells to draw")
    if not from_flight:
        return list(cells)
    missing = sum("from_flight" not in cell for cell in cells)
    if missing:
        raise InputError(f"{missing} of {len(cells)} cells have no 'from_flight' metrics")
    return [{**cell, **cell["from_flight"]} for cell in cells]


def how_pooled(cells: Sequence[Cell]) -> str:
    """The footnote that explains bars and dots.

    Args:
        cells: The cells.

    Returns:
        The text.
    """
    seeds = len({cell.get("seed") for cell in cells})
    text = "Bars: 95 % intervals over held-out tosses"
    if seeds > 1:
        text += f", averaged over the {seeds} seeds, as are the lines. Open dots: single seeds"
    return text + "."
