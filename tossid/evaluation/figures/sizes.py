"""What size costs: processor time and memory against the size of the input."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from tossid.evaluation.figures.style import new_figure, panel_grid, styled
from tossid.settings.figures import FigureSettings

Cost = tuple[float, float, float]
"""Size, CPU time [s], memory [GiB]."""

COLORS = ("#0072B2", "#009E73", "#D55E00", "#CC79A7", "#C28E00")


@styled
def costs_of_size(
    panels: Mapping[str, Mapping[str, Sequence[Cost]]], *, settings: FigureSettings = FigureSettings()
) -> Figure:
    """CPU time above memory, a column for each kind of size; all axes are logarithmic, so a slope of one is linear.

    Args:
        panels: By the name of the size's axis: costs by command, in order of size.
        settings: Where the axis of memory begins.

    Returns:
        The figure.
    """
    figure = new_figure(
        "What size costs", "each command in a process of its own; its largest process's memory", height=6.4
    )
    axes = panel_grid(figure, 2, len(panels), left=0.85, between=1.0)
    plain = FuncFormatter(lambda value, _: f"{value:g}")
    for column, (title, commands) in enumerate(panels.items()):
        for row, unit in enumerate(("CPU time [s]", "memory [GiB]")):
            ax = axes[row, column]
            for color, (name, costs) in zip(COLORS, commands.items(), strict=False):
                ax.plot([c[0] for c in costs], [c[row + 1] for c in costs], "o-", color=color, label=name)
            ax.set(xscale="log", xlabel=title)
            ax.set_xticks(sorted({c[0] for costs in commands.values() for c in costs}))
            ax.set_ylabel(unit)
            ax.set_yscale("log")
            top = max(c[row + 1] for costs in commands.values() for c in costs)
            if row == 0:
                ax.set_ylim(top=50 * top)
                ax.legend(ncols=2)
            else:
                ax.set_ylim(settings.least_gib, 1.5 * max(top, 1.0))
                ax.set_yticks([2.0**k for k in range(-3, 8) if settings.least_gib <= 2.0**k <= 1.5 * max(top, 1.0)])
            for axis in (ax.xaxis, ax.yaxis):
                axis.set_major_formatter(plain)
                axis.set_minor_formatter(NullFormatter())
    return figure
