"""How long work reports to its caller: steps done, findings in words, and problems."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Progress:
    """One report of work that is under way."""

    stage: str
    """what is being done ("detect", "track", ...)"""
    done: int = 0
    """steps done since the last report of this stage"""
    total: int | None = None
    """steps in all, None where unknown"""
    unit: str = ""
    """what is counted ("images", "poses", ...)"""
    message: str = ""
    """a finding in words; no steps are counted then"""
    is_problem: bool = False
    """whether the message is one that a person should not miss"""


Callback = Callable[[Progress], None]


class IngestWarning(UserWarning):
    """A recording has a problem, and was ingested all the same."""


class Reporter:
    """Passes reports on to a callback and collects the problems.

    Attributes:
        problems: Messages that a person should not miss, in order.
    """

    def __init__(self, callback: Callback | None = None) -> None:
        """Report to a callback.

        Args:
            callback: Takes every report. None: problems become Python warnings, everything else is dropped.
        """
        self.problems: list[str] = []
        self._callback = callback

    def counter(self, stage: str, total: int | None, unit: str) -> Callable[[int], None]:
        """A function that reports steps of a stage.

        Args:
            stage: What is being done.
            total: Steps in all, None where unknown.
            unit: What is counted.

        Returns:
            Takes the number of steps done since its last call.
        """

        def advance(done: int = 1) -> None:
            if self._callback is not None:
                self._callback(Progress(stage, done, total, unit))

        advance(0)
        return advance

    def message(self, stage: str, text: str) -> None:
        """Report a finding in words."""
        if self._callback is not None:
            self._callback(Progress(stage, message=text))

    def problem(self, stage: str, text: str) -> None:
        """Report what a person should not miss."""
        self.problems.append(text)
        if self._callback is not None:
            self._callback(Progress(stage, message=text, is_problem=True))
        else:
            warnings.warn(text, IngestWarning, stacklevel=3)
