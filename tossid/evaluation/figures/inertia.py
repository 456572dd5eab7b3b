"""The inertia study: from wrong starts to learned inertia and centre of mass."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullLocator
from numpy.typing import NDArray

from tossid.evaluation.figures.cells import Cell, chosen, models_in, value_of
from tossid.evaluation.figures.studies import log2_axis
from tossid.evaluation.figures.style import INK, MUTED, footnote, halo, key_row, look, new_figure, panel_grid, styled
from tossid.settings.figures import FigureSettings

Array = NDArray[np.float64]

_GREEN = "#dcefe4"


@styled
def inertia_study(cells: Sequence[Cell], *, settings: FigureSettings = FigureSettings()) -> Figure:
    """For each parameterisation: the error each start had (open) and the error that was learned (filled).

    Upper row: relative error of the inertia against the start's scale. Lower row: error of the centre of mass against
    the start's offset, or against the scale too where all starts have one offset. The band of starts that reached the
    truth is marked, and these starts are counted.

    Args:
        cells: Dictionaries with `parameterisation`, `seed`, `inertia_scale` (start: learned from scale times the truth)
            [1], `com_offset_m` (start) [m], and what was learned: `inertia_error_rel` [1], `com_error_m` [m], each a
            number or {"mean", "ci95"}.
        settings: Up to which error a start has reached the truth.

    Returns:
        The figure.

    Raises:
        InputError: There are no cells.
    """
    reached_inertia, reached_com = 100 * settings.reached_inertia, 1e3 * settings.reached_com_m
    cells = chosen(cells, from_flight=False)
    kinds = models_in(cells, key="parameterisation")
    scales = np.unique([float(c["inertia_scale"]) for c in cells])
    offsets = 1e3 * np.unique([float(c["com_offset_m"]) for c in cells])
    tops = [
        max([reached_inertia, *[v for c in cells for v in _inertia(c)[:2] if np.isfinite(v)]]),
        max([reached_com, *[v for c in cells for v in _com(c)[:2] if np.isfinite(v)]]),
    ]
    subtitle = "Every start's error before learning (open) and after (filled)."
    figure = new_figure("From a wrong inertia to the true one", subtitle, height=7.2)
    axes = panel_grid(figure, 2, len(kinds), left=0.8, right=0.25, top=1.55, bottom=0.9, between=0.3, above=0.85)
    entries = [
        (Line2D([], [], ls="none", marker="o", mfc="white", mec=MUTED, ms=5.5), "start"),
        (Line2D([], [], ls="none", marker="o", color=INK, ms=5.5), "learned, with 95 % interval where known"),
        (Line2D([], [], color=_GREEN, lw=8), f"reached the truth ({reached_inertia:g} %, {reached_com:g} mm)"),
    ]
    key_row(figure, entries, y=0.74)
    for j, kind in enumerate(kinds):
        own = [c for c in cells if str(c["parameterisation"]) == kind]
        style = look(kind, others=kinds)
        inertia = np.array([_inertia(c) for c in own])
        com = np.array([_com(c) for c in own])
        both = int(np.sum((inertia[:, 1] <= reached_inertia) & (com[:, 1] <= reached_com)))
        upper, lower = axes[0, j], axes[1, j]
        upper.set_title(f"{style.label}\n{both} of {len(own)} reached", color=style.color, fontsize=9.5)
        log2_axis(upper, scales.tolist(), room=0.5)
        upper.set_xlabel("start: inertia / true inertia [1]")
        _starts(
            upper, np.array([float(c["inertia_scale"]) for c in own]), inertia, reached_inertia, tops[0],
            style.color, log2=True,
        )  # fmt: skip
        start = np.array([float(c["inertia_scale"]) for c in own])
        if len(offsets) > 1:
            step = float(np.diff(offsets).min())
            lower.set_xlim(offsets.min() - 0.5 * step, offsets.max() + 0.5 * step)
            if len(offsets) <= 7:
                lower.set_xticks(offsets, [f"{o:.3g}" for o in offsets])
            lower.set_xlabel("start: offset of centre of mass [mm]")
            start = np.array([1e3 * float(c["com_offset_m"]) for c in own])
        else:
            step = 1.0
            log2_axis(lower, scales.tolist(), room=0.5)
            lower.set_xlabel("start: inertia / true inertia [1]")
        _starts(lower, start, com, reached_com, tops[1], style.color, log2=len(offsets) == 1, step=step)
        upper.set_ylabel("error of the inertia [%]" if j == 0 else "")
        lower.set_ylabel("error of the centre of mass [mm]" if j == 0 else "")
        if j:
            upper.tick_params(labelleft=False)
            lower.tick_params(labelleft=False)
    footnote(figure, "Error axes are linear inside the marked band and logarithmic above it.")
    return figure


def _inertia(cell: Cell) -> tuple[float, float, float, float]:
    """(start, learned, low, high) relative error of the inertia [%]."""
    learned = tuple(100 * v for v in value_of(cell, "inertia_error_rel"))
    return (100 * abs(float(cell["inertia_scale"]) - 1), *learned)  # type: ignore[return-value]


def _com(cell: Cell) -> tuple[float, float, float, float]:
    """(start, learned, low, high) error of the centre of mass [mm]."""
    learned = tuple(1e3 * v for v in value_of(cell, "com_error_m"))
    return (1e3 * abs(float(cell["com_offset_m"])), *learned)  # type: ignore[return-value]


def _starts(
    ax: Axes, x: Array, errors: Array, reached: float, top: float, color: str, *, log2: bool, step: float = 1.0
) -> None:
    """An arrow from each start's error to the learned one, on an axis that is linear inside the band.

    x: (n,) start. errors: (n, 4) start, learned, low, high. Starts of equal x are set side by side.
    """
    ax.set_yscale("symlog", linthresh=reached, linscale=0.6)
    ax.set_ylim(0, max(1.6 * top, 3 * reached))
    ax.axhspan(0, reached, color=_GREEN, lw=0, zorder=0, label="reached")
    beside = np.zeros(len(x))
    for value in np.unique(x):
        members = np.flatnonzero(x == value)
        members = members[np.argsort(errors[members, 0] + 1e-3 * errors[members, 1], kind="stable")]
        beside[members] = np.linspace(-0.3, 0.3, len(members)) if len(members) > 1 else 0.0
    place = x * 2.0**beside if log2 else x + step * beside
    for p, (start, learned, low, high) in zip(place, errors, strict=True):
        if not np.isfinite(learned):
            continue
        ax.plot([p, p], [start, learned], color=color, lw=0.9, alpha=0.45, zorder=2, label="_way")
        ax.plot([p, p], [low, high], color=color, lw=2.4, alpha=0.6, zorder=3, label="_interval")
    ax.plot(place, errors[:, 0], "o", mfc="white", mec=MUTED, mew=1.0, ms=4.5, zorder=3, clip_on=False, label="start")
    ax.plot(place, errors[:, 1], "o", color=color, mec="white", mew=0.5, ms=5.5, zorder=4, label="learned")
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    beyond = [reached * first * 10.0**k for k in range(4) for first in (3, 10)]
    ticks = [0.0, 0.5 * reached, reached, *beyond]
    ax.set_yticks([v for v in ticks if v <= ax.get_ylim()[1]])
    failed = int((~np.isfinite(errors[:, 1])).sum())
    if failed:
        halo(ax.text(0.98, 0.97, f"no result: {failed}", transform=ax.transAxes, ha="right", va="top", fontsize=8.5))
