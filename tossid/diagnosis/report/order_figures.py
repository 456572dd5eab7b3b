"""Figures over the order of recording: what tosses say of their world, and their gap, over order and over place."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tossid.diagnosis.findings import Gap
from tossid.diagnosis.report.figures import AFTER, BEFORE, colour_key
from tossid.diagnosis.report.registry import report_figure
from tossid.diagnosis.result import Diagnosis
from tossid.evaluation.figures import recording_over_order
from tossid.evaluation.figures.style import MUTED, new_figure, panel_grid, styled

OVER_ORDER = "Over the order of recording"


@report_figure(
    "gap_recording",
    alt="Gravity, resting faces, contact and heights of single tosses, over the order of recording and over place.",
    detail=OVER_ORDER,
    note="Each point is a toss, as it was recorded. Vertical lines divide sessions: changes that at most one in two "
    "hundred random orders of the tosses would show, corrected for the number of quantities.",
    applies=lambda diagnosis: diagnosis.order is not None and len(diagnosis.order.names) > 1,
)
def recording(diagnosis: Diagnosis) -> Figure:
    """What single tosses say of their recording.

    Args:
        diagnosis: What was found.
    """
    assert diagnosis.order is not None
    return recording_over_order(diagnosis.order)


@report_figure(
    "gap_over_order",
    alt="The gap of single tosses over the order of recording, and over the place where they end.",
    detail=OVER_ORDER,
    note="Each point is a toss. Vertical lines are changes of an effect. Where dark points stand together after the "
    "changes, the recording or the ground is another.",
    applies=lambda diagnosis: len(diagnosis.tosses) > 1,
)
@styled
def gap_over_order(diagnosis: Diagnosis) -> Figure:
    """The gap of each toss over the order of recording, before and after, and what is left over the place of its end.

    Args:
        diagnosis: What was found.
    """
    n = len(diagnosis.tosses)
    figure = new_figure("The gap, toss by toss", "Mean excess over noise.", height=3.5)
    ax, place = panel_grid(figure, 1, 2, left=0.95, right=0.35, top=1.1, between=0.9)[0]
    before, after = (toss_excess(gap, n) for gap in (diagnosis.gap, diagnosis.left))
    for color, excess in ((BEFORE, before), (AFTER, after)):
        ax.plot(np.arange(n), excess, ".", color=color, markersize=4)
    ax.set_yscale("symlog", linthresh=1.0)
    ax.yaxis.set_major_formatter("{x:g}")
    steps = [f.over_order for f in diagnosis.findings if f.over_order is not None and f.over_order.form == "steps"]
    starts = {stretch.first for each in steps for stretch in each.stretches[1:]}
    for at in (i for i, name in enumerate(diagnosis.tosses) if name in starts):
        ax.axvline(at - 0.5, color=MUTED, linewidth=1.0)
    ax.set_xlabel("number of the toss [in the order of recording]")
    ax.set_ylabel("excess over noise [1]")
    colour_key(figure, y=0.72)
    place.scatter(*diagnosis.places.T, c=np.log1p(np.maximum(after, 0.0)), cmap="viridis_r", s=14)
    place.set_title("left, where each toss ends")
    place.set_aspect("equal", adjustable="datalim")
    place.set_xlabel("x [m]")
    place.set_ylabel("y [m]")
    return figure


def toss_excess(gap: Gap, n: int) -> NDArray[np.float64]:
    """(n,) mean excess of each toss over the noise floor, over its rows.

    Args:
        gap: Of n tosses.
        n: How many.
    """
    toss = gap.frames[:, 0].astype(int)
    rows = np.maximum(np.bincount(toss, minlength=n), 1)
    return np.asarray(np.bincount(toss, weights=gap.frames[:, 3], minlength=n) / rows)
