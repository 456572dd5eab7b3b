"""The figures of a report: each is one function, registered by one line.

    @report_figure("gap_energy", alt="Energy over time, measured and predicted.")
    def energy(diagnosis: Diagnosis, settings: ReportSettings) -> Figure:
        ...

The figure then stands on the page of every diagnosis, and is written beside it as a file.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from matplotlib.figure import Figure

from tossid.diagnosis.result import Diagnosis
from tossid.evaluation.figures.style import as_png
from tossid.settings.diagnosis.report import ReportSettings

Draw = Callable[[Diagnosis, ReportSettings], Figure]
D = TypeVar("D", bound=Draw)


@dataclass(frozen=True)
class ReportFigure:
    """A figure of the report, and how the page presents it."""

    name: str
    """Its name as a file, without a suffix."""
    draw: Draw
    """Draws it."""
    alt: str
    """What it shows, for readers who cannot see it."""
    detail: str
    """Heading of its section among the details; empty for a figure at the top of the page."""
    text: Callable[[Diagnosis], Sequence[str]]
    """Paragraphs over the figure, in its section."""
    note: str
    """How it is read, below the figure, in its section."""
    applies: Callable[[Diagnosis], bool]
    """Whether a diagnosis has anything to draw."""


REPORT_FIGURES: dict[str, ReportFigure] = {}
"""All figures by name, in the order of the page."""


def report_figure(
    name: str,
    *,
    alt: str,
    detail: str = "",
    text: Callable[[Diagnosis], Sequence[str]] = lambda diagnosis: (),
    note: str = "",
    applies: Callable[[Diagnosis], bool] = lambda diagnosis: True,
) -> Callable[[D], D]:
    """A decorator that registers a figure of the report.

    Args:
        name: Its name as a file, without a suffix; a name that is registered already is replaced.
        alt: What it shows, for readers who cannot see it.
        detail: Heading of its section among the details; empty for a figure at the top of the page.
        text: Paragraphs over the figure, in its section.
        note: How it is read, below the figure, in its section.
        applies: Whether a diagnosis has anything to draw.

    Returns:
        The decorator; it leaves the function as it is.
    """

    def register(draw: D) -> D:
        REPORT_FIGURES[name] = ReportFigure(name, draw, alt, detail, text, note, applies)
        return draw

    return register


def report_figures(diagnosis: Diagnosis, *, settings: ReportSettings = ReportSettings()) -> dict[str, Figure]:
    """All registered figures of a diagnosis, by name, in the order of the page.

    Args:
        diagnosis: What was found.
        settings: What the figures draw.

    Returns:
        The figures of which the diagnosis has something to draw.
    """
    return {name: each.draw(diagnosis, settings) for name, each in REPORT_FIGURES.items() if each.applies(diagnosis)}


def report_pngs(diagnosis: Diagnosis, *, settings: ReportSettings = ReportSettings()) -> dict[str, bytes]:
    """What `report_figures` draws, each as the PNG that the page embeds and a folder holds.

    Args:
        diagnosis: What was found.
        settings: What the figures draw.
    """
    return {name: as_png(figure) for name, figure in report_figures(diagnosis, settings=settings).items()}
