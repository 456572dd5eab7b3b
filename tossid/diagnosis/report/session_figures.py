"""Figures of the recording: what tosses say of their world, and their gap, over order and over place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from tossid.diagnosis.findings import Gap
from tossid.diagnosis.report.figures import AFTER, BEFORE
from tossid.diagnosis.report.order_text import over_order_sentences
from tossid.diagnosis.report.registry import report_figure
from tossid.diagnosis.result import Diagnosis
from tossid.evaluation.figures.sessions import recording_over_order
from tossid.evaluation.figures.style import MUTED, key_row, new_figure, panel_grid, styled
from tossid.motion.sessions import session_words
from tossid.settings.diagnosis.report import ReportSettings


def session_paragraphs(diagnosis: Diagnosis) -> Sequence[str]:
    """A sentence for each session, and the notes on the order of recording.

    Args:
        diagnosis: What was found.
    """
    if diagnosis.order is None:
        return ()
    said = [f"Session {session_words(session)}." for session in diagnosis.order.sessions]
    return [*said, *(f"{note[0].upper()}{note[1:]}." for note in diagnosis.order.notes)]


@report_figure(
    "gap_recording",
    alt="Gravity, resting faces, contact and heights of single tosses, over the order of recording and over place.",
    detail="The recording: sessions, and what changes with place",
    text=session_paragraphs,
    note="Each point is a toss, as it was recorded. Vertical lines divide sessions: changes that at most one in two "
    "hundred random orders of the tosses would show, corrected for the number of quantities.",
    applies=lambda diagnosis: diagnosis.order is not None and len(diagnosis.order.names) > 1,
)
def recording(diagnosis: Diagnosis, settings: ReportSettings) -> Figure:
    """What single tosses say of their recording.

    Args:
        diagnosis: What was found.
        settings: What the figures draw.

    Returns:
        The figure.
    """
    assert diagnosis.order is not None
    return recording_over_order(diagnosis.order)


@report_figure(
    "gap_over_order",
    alt="The gap of single tosses over the order of recording, before and after.",
    detail="The gap over the order of recording",
    text=over_order_sentences,
    note="Each point is a toss: the mean deviance of its rows and channels above the noise floor, with the simulator "
    "as it is and with everything that was found. Vertical lines are changes of an effect.",
    applies=lambda diagnosis: len(diagnosis.tosses) > 1,
)
@styled
def gap_over_order(diagnosis: Diagnosis, settings: ReportSettings) -> Figure:
    """The gap of each toss over the order of recording, before and after.

    Args:
        diagnosis: What was found.
        settings: What the figures draw.

    Returns:
        The figure.
    """
    n = len(diagnosis.tosses)
    figure = new_figure("The gap, toss by toss", "mean deviance above the noise floor", height=3.2)
    ax = panel_grid(figure, 1, 1, left=0.95)[0, 0]
    for color, gap in ((BEFORE, diagnosis.gap), (AFTER, diagnosis.left)):
        ax.plot(np.arange(n), toss_excess(gap, n), ".", color=color, markersize=4)
    ax.set_yscale("symlog", linthresh=1.0)
    steps = [f.over_order for f in diagnosis.findings if f.over_order is not None and f.over_order.form == "steps"]
    starts = {stretch.first for each in steps for stretch in each.stretches[1:]}
    for at in (i for i, name in enumerate(diagnosis.tosses) if name in starts):
        ax.axvline(at - 0.5, color=MUTED, linewidth=1.0)
    ax.set_xlabel("toss, in the order of recording")
    handles = [Line2D([], [], color=color, marker=".", linestyle="") for color in (BEFORE, AFTER)]
    key_row(figure, list(zip(handles, ("before", "after"), strict=True)), y=0.62)
    return figure


@report_figure(
    "gap_over_place",
    alt="The gap of single tosses over the place where they end, before and after.",
    detail="The gap over place",
    note="Each point is a toss where it ends; the darker, the larger its gap (mean deviance above the noise floor, "
    "logarithmic). A patch of dark points is a place at which the recording or the ground is another.",
    applies=lambda diagnosis: len(diagnosis.tosses) > 1,
)
@styled
def gap_over_place(diagnosis: Diagnosis, settings: ReportSettings) -> Figure:
    """The gap of each toss over the place where it ends, before and after.

    Args:
        diagnosis: What was found.
        settings: What the figures draw.

    Returns:
        The figure.
    """
    n, (x, y) = len(diagnosis.tosses), diagnosis.places.T
    sizes = [np.log1p(np.maximum(toss_excess(gap, n), 0.0)) for gap in (diagnosis.gap, diagnosis.left)]
    figure = new_figure("The gap over place", "where each toss ends, as recorded", height=3.6)
    axes = panel_grid(figure, 1, 2, left=0.95, between=0.75)
    top = max(float(size.max(initial=0.0)) for size in sizes) + 1e-9
    for ax, size, title in zip(axes[0], sizes, ("before", "after"), strict=True):
        ax.scatter(x, y, c=size, cmap="viridis_r", vmin=0.0, vmax=top, s=14)
        ax.set_title(title)
        ax.set_aspect("equal", adjustable="datalim")
        ax.set_xlabel("x [m]")
        ax.set_ylabel("y [m]")
    return figure


def toss_excess(gap: Gap, n: int) -> NDArray[np.float64]:
    """(n,) mean deviance of each toss above the noise floor, over its rows and channels.

    Args:
        gap: Of n tosses.
        n: How many.
    """
    toss = gap.frames[:, 0].astype(int)
    rows = np.maximum(np.bincount(toss, minlength=n), 1)
    return np.asarray(np.bincount(toss, weights=gap.frames[:, 3], minlength=n) / rows)
