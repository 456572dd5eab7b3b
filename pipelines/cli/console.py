"""What a person sees, all of it on standard error: lines, tables, progress."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Protocol

from pipelines.tracking.addresses import redacted
from tossid.html import number_words

if TYPE_CHECKING:
    from rich.console import Console as RichConsole

    from tossid.ingestion.progress import Progress as Report


class Progress(Protocol):
    """Counts work that is under way."""

    def advance(self, count: float = 1, *, note: str = "") -> None:
        """Add `count` done; `note` is shown beside (a loss, say)."""
        ...


class Console:
    """Lines, tables and progress for a person.

    Args:
        quiet: only warnings.
        interval: seconds between plain progress lines where no terminal is there.
    """

    def __init__(self, *, quiet: bool = False, interval: float = 10.0) -> None:
        self.quiet = quiet
        self.interval = interval
        self._rich: RichConsole | None = None

    @property
    def is_terminal(self) -> bool:
        """Whether a person watches, so that progress bars move."""
        return sys.stderr.isatty()

    @property
    def rich(self) -> RichConsole:
        """The rich console behind (for what the methods here do not offer)."""
        if self._rich is None:
            from rich.console import Console as RichConsole

            width = None if self.is_terminal else _WIDE
            self._rich = RichConsole(file=sys.stderr, width=width, highlight=False, soft_wrap=True)
        return self._rich

    def say(self, text: str = "") -> None:
        """One line of news."""
        if not self.quiet:
            self.rich.print(redacted(text), markup=False)

    def warn(self, text: str) -> None:
        """One line that a person should not miss."""
        self.rich.print(f"warning: {redacted(text)}", style="yellow", markup=False)

    def table(self, columns: Sequence[str], rows: Iterable[Sequence[object]], *, title: str = "") -> None:
        """A table; numbers to the right, floats with four digits."""
        if self.quiet:
            return
        from rich import box
        from rich.table import Table
        from rich.text import Text

        rows = [list(row) for row in rows]
        # (a plain string would be read as markup: "[deg]" as a style)
        table = Table(
            title=Text(title) if title else None, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD
        )
        for i, column in enumerate(columns):
            numeric = any(isinstance(row[i], (int, float)) for row in rows)
            words = [word for row in rows for word in _cell(row[i]).split()] if i == 0 else []
            longest = min(_LONGEST_WORD, max(map(len, (*words, *column.split())), default=0))  # names stay whole
            table.add_column(Text(column), justify="right" if numeric else "left", overflow="fold", min_width=longest)
        for row in rows:
            table.add_row(*(Text(redacted(_cell(value))) for value in row))
        self.rich.print(table, soft_wrap=False, crop=False)

    def facts(self, facts: Mapping[str, object], *, title: str = "") -> None:
        """Names and values, one a line."""
        if self.quiet:
            return
        if title:
            self.say(title)
        width = max((len(name) for name in facts), default=0)
        for name, value in facts.items():
            self.say(f"  {name:<{width}}  {_cell(value)}")

    @contextmanager
    def progress(self, what: str, total: float | None = None, *, unit: str = "") -> Iterator[Progress]:
        """Show how far something is: a bar on a terminal, a plain line now and then elsewhere.

        Args:
            what: what is being done ("detect").
            total: how much there is to do, None if unknown.
            unit: of what ("frames").
        """
        if self.is_terminal and not self.quiet:
            from rich import progress as bars

            columns = [
                bars.TextColumn("{task.description}"),
                bars.BarColumn(),
                bars.TextColumn(
                    "{task.completed:.0f}/{task.total:.0f} " + unit if total else "{task.completed:.0f} " + unit
                ),
                bars.TimeRemainingColumn(),
                bars.TextColumn("{task.fields[note]}"),
            ]
            with bars.Progress(*columns, console=self.rich) as bar:
                yield _Bar(bar, bar.add_task(what, total=total, note=""))
        else:
            lines = _Lines(self, what, total, unit)
            yield lines
            lines.close()

    @contextmanager
    def shares(self, what: str) -> Iterator[Callable[[str, float], None]]:
        """A callback for the library that shows what is under way and which share is done, while the block lasts."""
        done = 0.0
        with self.progress(what, 100, unit="%") as bar:

            def report(text: str, share: float) -> None:
                nonlocal done
                bar.advance(100 * share - done, note=text)
                done = 100 * share

            yield report


@contextmanager
def reported(console: Console) -> Iterator[Callable[[Report], None]]:
    """A callback for the library that shows messages as lines and counted steps as progress, while the block lasts.

    Args:
        console: What a person sees.

    Yields:
        Takes a report. The bar of a stage is shown until another stage counts.
    """
    with ExitStack() as shown:
        bars: dict[str, Progress] = {}

        def show(report: Report) -> None:
            if report.message:
                (console.warn if report.is_problem else console.say)(report.message)
                return
            if report.stage not in bars:
                shown.close()  # one bar at a time
                bars.clear()
                bars[report.stage] = shown.enter_context(console.progress(report.stage, report.total, unit=report.unit))
            bars[report.stage].advance(report.done)

        yield show


_LONGEST_WORD = 48
"""Letters of a word of a table that is not wrapped."""
_WIDE = 160
"""Width of a table where no terminal limits it."""


class _Bar:
    def __init__(self, bar: object, task: object) -> None:
        self._bar, self._task = bar, task

    def advance(self, count: float = 1, *, note: str = "") -> None:
        self._bar.update(self._task, advance=count, note=note)  # type: ignore[attr-defined]


class _Lines:
    """A plain line now and then, and one at the end of anything that took as long."""

    def __init__(self, console: Console, what: str, total: float | None, unit: str) -> None:
        self._console, self._what, self._total, self._unit = console, what, total, unit
        self._done = 0.0
        self._start = self._last = time.monotonic()
        self._note = ""

    def advance(self, count: float = 1, *, note: str = "") -> None:
        self._done += count
        self._note = note or self._note
        now = time.monotonic()
        if now - self._last >= self._console.interval:
            self._last = now
            self._console.say(self._line(now))

    def close(self) -> None:
        if self._last > self._start:
            self._console.say(f"{self._what}: done, {self._count()} in {time.monotonic() - self._start:.0f} s")

    def _count(self) -> str:
        of = f" of {self._total:.0f}" if self._total is not None else ""
        return f"{self._done:.0f}{of}{' ' + self._unit if self._unit else ''}"

    def _line(self, now: float) -> str:
        line = f"{self._what}: {self._count()}"
        if self._total and self._done > 0:
            left = (now - self._start) * (self._total - self._done) / self._done
            line += f", about {max(left, 0):.0f} s left"
        return f"{line}, {self._note}" if self._note else line


def _cell(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return number_words(value)
    if isinstance(value, dict):
        return ", ".join(f"{name} {_cell(item)}" for name, item in value.items()) or "-"
    if isinstance(value, (list, tuple)):
        return ", ".join(_cell(item) for item in value) or "-"
    return str(value)
