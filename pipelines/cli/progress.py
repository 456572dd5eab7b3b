"""The library's reports of long work, on a person's console."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from pipelines.cli.console import Console
from pipelines.cli.console import Progress as Bar

if TYPE_CHECKING:
    from tossid.ingestion.progress import Progress


@contextmanager
def reported(console: Console) -> Iterator[Callable[[Progress], None]]:
    """A callback for the library that shows messages as lines and counted steps as progress, while the block lasts.

    Args:
        console: What a person sees.

    Yields:
        Takes a report. The bar of a stage is shown until another stage counts.
    """
    with ExitStack() as shown:
        bars: dict[str, Bar] = {}

        def show(report: Progress) -> None:
            if report.message:
                (console.warn if report.is_problem else console.say)(report.message)
                return
            if report.stage not in bars:
                shown.close()  # one bar at a time
                bars.clear()
                bars[report.stage] = shown.enter_context(console.progress(report.stage, report.total, unit=report.unit))
            bars[report.stage].advance(report.done)

        yield show
