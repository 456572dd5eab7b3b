"""What tosses say of their recording, over the order of recording and over place."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tossid.evaluation.figures.style import MUTED, new_figure, panel_grid, styled
from tossid.types import RecordingOrder

Array = NDArray[np.float64]

X, Y = "#0072B2", "#D55E00"
PANELS = (
    ("fall [°]", ("fall_x", "fall_y"), 180 / np.pi),
    ("resting normal [°]", ("normal_x", "normal_y"), 180 / np.pi),
    ("contact slope [°]", ("slope_x", "slope_y"), 180 / np.pi),
    ("gravity [m/s²]", ("gravity",), 1.0),
    ("resting height [mm]", ("height",), 1e3),
)
"""Label, quantities, and the factor from SI."""


@styled
def recording_over_order(order: RecordingOrder) -> Figure:
    """A row a witness: its components over the order of recording, and over the places where tosses ended, x and y.

    Args:
        order: Of a dataset, with what its tosses say as they were recorded.

    Returns:
        The figure; sessions are divided by vertical lines.
    """
    n = len(order.sessions)
    figure = new_figure(
        "The recording, toss by toss",
        f"{n} session{'s' if n > 1 else ''} in the order of {order.ordered_by}; "
        "components x (blue) and y (red) as recorded, and where the toss ended",
        height=8.6,
    )
    axes = panel_grid(figure, len(PANELS), 3, left=0.95, between=0.55)
    for row, (label, names, factor) in enumerate(PANELS):
        known = [name for name in names if name in order.quantities]
        values = factor * order.values[:, [order.quantities.index(name) for name in known]]
        limits = _limits(values)
        for column, over in enumerate((np.arange(len(order.names), dtype=float), *order.places.T)):
            ax = axes[row, column]
            for color, series in zip((X, Y), values.T, strict=False):
                ax.plot(over, series, ".", color=color, markersize=2.5, alpha=0.6)
            if limits is not None:
                ax.set_ylim(*limits)
            if column == 0:
                ax.set_ylabel(label)
                _divide(ax, order)
            if row == len(PANELS) - 1:
                ax.set_xlabel(("order of recording", "x of the end [m]", "y of the end [m]")[column])
    return figure


def _limits(values: Array) -> tuple[float, float] | None:
    """The middle 96 % of values, with a margin; None where there are none."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return None
    low, high = np.quantile(finite, [0.02, 0.98])
    margin = 0.15 * (high - low) + 1e-6
    return float(low - margin), float(high + margin)


def _divide(ax: Axes, order: RecordingOrder) -> None:
    for at in np.flatnonzero(np.diff(order.session_of)):
        ax.axvline(at + 0.5, color=MUTED, linewidth=1.0)
