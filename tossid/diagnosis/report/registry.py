"""The figures of a report: each is one function under `report_figure`, on the page of every diagnosis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from matplotlib.figure import Figure

from tossid.diagnosis.result import Diagnosis
from tossid.evaluation.figures.style import as_png

Draw = Callable[[Diagnosis], Figure]
D = TypeVar("D", bound=Draw)


@dataclass(frozen=True)
class ReportFigure:
    """A figure of the report, and how the page presents it.

    Attributes:
        name: Its name as a file, without a suffix.
        draw: Draws it.
        alt: What it shows, for readers who cannot see it.
        detail: Heading of its section among the details; empty for a figure at the top of the page.
        note: How it is read, below the figure.
        applies: Whether a diagnosis has anything to draw.
    """

    name: str
    draw: Draw
    alt: str
    detail: str
    note: str
    applies: Callable[[Diagnosis], bool]


REPORT_FIGURES: dict[str, ReportFigure] = {}
"""All figures by name, in the order of the page."""


def report_figure(
    name: str,
    *,
    alt: str,
    detail: str = "",
    note: str = "",
    applies: Callable[[Diagnosis], bool] = lambda diagnosis: True,
) -> Callable[[D], D]:
    """A decorator that registers a figure of the report, and leaves the function as it is.

    Args:
        name: Its name as a file, without a suffix; a name that is registered already is replaced.
        alt: What it shows, for readers who cannot see it.
        detail: Heading of its section among the details, where figures of the same heading stand together; empty for
            a figure at the top of the page.
        note: How it is read, below the figure.
        applies: Whether a diagnosis has anything to draw.
    """

    def register(draw: D) -> D:
        REPORT_FIGURES[name] = ReportFigure(name, draw, alt, detail, note, applies)
        return draw

    return register


def report_figures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """The registered figures of which a diagnosis has something to draw, by name, in the order of the page.

    Args:
        diagnosis: What was found.
    """
    return {name: each.draw(diagnosis) for name, each in REPORT_FIGURES.items() if each.applies(diagnosis)}


def report_pngs(diagnosis: Diagnosis) -> dict[str, bytes]:
    """What `report_figures` draws, each as the PNG that the page embeds and a folder holds.

    Args:
        diagnosis: What was found.
    """
    return {name: as_png(figure) for name, figure in report_figures(diagnosis).items()}
