"""A search where effects change over the order of recording (the corrections of recordings follow)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tossid.diagnosis.findings import ChangeLeft, Finding
from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.inference.found import Found
from tossid.diagnosis.problem import Problem
from tossid.types import Toss


@dataclass(frozen=True)
class Undone:
    """What a search has found."""

    problem: Problem
    found: Found


def without_changes(problem: Problem, first: Evidence | None = None) -> Undone:
    """Search."""
    return Undone(problem, problem.search().run(first))


def corrections(undone: Undone) -> dict[str, str]:
    """Of the recording."""
    return {}


def changes_left(undone: Undone, recorded: Sequence[Toss]) -> tuple[ChangeLeft, ...] | None:
    """Of what is left."""
    return None


def findings_over_order(undone: Undone, recorded: Sequence[Toss]) -> tuple[Finding, ...]:
    """Of each effect that changes."""
    return ()
