"""What a diagnosis knows while it is under way: reported as it becomes known, and kept for one that is interrupted."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.inference.fitting import Fit
from tossid.diagnosis.inference.screening import Screening
from tossid.types import Progress, Toss, silent

if TYPE_CHECKING:
    from tossid.diagnosis.result import Diagnosis

GAP, SEARCH, JUDGED = 0.05, 0.35, 0.85
"""Shares of the whole that are done when the gap is known, the search has ended, and it has been judged."""


class UnderWay:
    """Reports of a diagnosis that is under way. To call it reports progress.

    Attributes:
        stage: What is under way.
        tosses: That are searched.
        first: Evidence of the simulator as it is stated; None before the gap is known.
        present: With the effects that have joined; None before a round has ended.
        suspects: Names of effects that may join, with their gains of log-likelihood by one step.
        since: When the gap became known (`time.perf_counter`).
        answer: What has been concluded; None before.
        progress: Called with what is under way, and the share that is done.
    """

    def __init__(self, progress: Progress = silent, news: Callable[[str], None] | None = None) -> None:
        """Reports to a person.

        Args:
            progress: Called with what is under way, and the share that is done.
            news: Called with a line on what has become known.
        """
        self.stage, self.since = "", 0.0
        self.tosses: tuple[Toss, ...] = ()
        self.first: Evidence | None = None
        self.present: Fit | None = None
        self.suspects: tuple[tuple[str, float], ...] = ()
        self.answer: Diagnosis | None = None
        self.progress, self._news, self._last = progress, news, ""

    def __call__(self, what: str, share: float) -> None:
        """Report what is under way.

        Args:
            what: In a few words.
            share: Of the whole that is done.
        """
        self.stage = what
        self.progress(what, share)

    def known(self, tosses: Sequence[Toss], first: Evidence, line: str) -> None:
        """The gap is known.

        Args:
            tosses: That are searched.
            first: Evidence of the simulator as it is stated.
            line: How large the gap is, in words.
        """
        self.tosses, self.first, self.since = tuple(tosses), first, time.perf_counter()
        self.say(line)

    def watched(self, present: Fit, screening: Screening) -> None:
        """A round of the search has screened what may join.

        Args:
            present: The hypothesis so far.
            screening: The library beside it.
        """
        if self.first is None:
            return
        likely = tuple((c.name, c.total) for c in screening.candidates if c.total > 0)
        if present.n == len(self.tosses):
            self.present, self.suspects = present, likely
        found = [
            f"{effect.name} ({', '.join(f'{name} {x:.3g}' for name, x in effect.named(values).items())})"
            for effect, values in present.hypothesis.items()
        ]
        if found:
            self.say(f"found so far: {', '.join(found)}")
        if likely:
            self.say(f"next suspect: {likely[0][0]}")

    def say(self, line: str) -> None:
        """Report a line of news, unless it was the last one already.

        Args:
            line: What has become known.
        """
        if self._news is not None and line != self._last:
            self._last = line
            self._news(line)
