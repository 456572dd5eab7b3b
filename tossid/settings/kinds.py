"""Kinds of values that settings hold: numbers and pairs with their limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, TypeVar

T = TypeVar("T")
ADVANCED = "advanced"
"""Mark, in a field's metadata, of what only Python changes: no key of the command line."""


def advanced(default: T) -> T:
    """A field that only Python changes; the command line neither shows nor stores it.

    Args:
        default: Its value.
    """
    return field(default=default, metadata={ADVANCED: True})


def advanced_part(settings: type[T]) -> T:
    """A field that holds settings of its own, which only Python changes.

    Args:
        settings: Their class; the field's default is all of its defaults.
    """
    return field(default_factory=settings, metadata={ADVANCED: True})


@dataclass(frozen=True, slots=True)
class Bounds:
    """Limits of a number, inclusive; `above`: exclusive lower limit."""

    low: float | None = None
    high: float | None = None
    above: float | None = None


@dataclass(frozen=True, slots=True)
class Registered:
    """Marks a choice among settings that a registry knows.

    Attributes:
        classes: Gives their dataclasses; each has a field `name`, a `Literal` whose value chooses it.
    """

    classes: Callable[[], tuple[type, ...]]


@dataclass(frozen=True, slots=True)
class Ordered:
    """Marks a pair of limits: the first is not above the second."""


Positive = Annotated[float, Bounds(above=0)]
NonNegative = Annotated[float, Bounds(low=0)]
Count = Annotated[int, Bounds(low=1)]
Fraction = Annotated[float, Bounds(low=0, high=1)]
Range = Annotated[tuple[float, float], Ordered()]
Span = Annotated[tuple[NonNegative, NonNegative], Ordered()]
Seed = Annotated[int, Bounds(low=0, high=2**32 - 1)]
