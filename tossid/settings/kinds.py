"""Kinds of values that settings hold: numbers and pairs with their limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Annotated, TypeVar, get_args, get_origin, get_type_hints

from tossid.errors import ConfigError

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

    def contains(self, value: float) -> bool:
        """Whether a number is within the limits; NaN never is."""
        return (
            value == value
            and (self.low is None or value >= self.low)
            and (self.high is None or value <= self.high)
            and (self.above is None or value > self.above)
        )

    def __str__(self) -> str:
        """The limits in words, such as " above 0 and at most 5"."""
        if self.above is not None:
            text = f" above {self.above:g}"
            return text if self.high is None else f"{text} and at most {self.high:g}"
        if self.low is not None and self.high is not None:
            return f" from {self.low:.10g} to {self.high:.10g}"
        return f" of at least {self.low:g}" if self.low is not None else f" of at most {self.high:g}"


@dataclass(frozen=True, slots=True)
class Registered:
    """Marks a choice among settings that a registry knows.

    Attributes:
        classes: Gives their dataclasses; each has a field `name`, a `Literal` whose value chooses it.
    """

    classes: Callable[[], tuple[type, ...]]


@dataclass(frozen=True, slots=True)
class Except:
    """Marks text that may be anything but one word, which has a meaning of its own."""

    word: str


@dataclass(frozen=True, slots=True)
class Ordered:
    """Marks a pair of limits: the first is not above the second."""


class Checked:
    """Base of settings whose numbers are held against their `Bounds` when they are made, in Python too."""

    def __post_init__(self) -> None:
        """Check them.

        Raises:
            ConfigError: A number is beyond its limits.
        """
        for name, bounds in _bounds_of(type(self)).items():  # type: ignore[arg-type]
            value = getattr(self, name)
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if is_number and not bounds.contains(value):
                raise ConfigError(name, f"{value} is out of range; expected a number{bounds}.")


@cache
def _bounds_of(settings: type) -> dict[str, Bounds]:
    """The limits of the fields that are one number, or a number or something else."""
    found: dict[str, Bounds] = {}
    for name, hint in get_type_hints(settings, include_extras=True).items():
        for part in (hint, *get_args(hint)):
            if get_origin(part) is Annotated:
                limits = (extra for extra in get_args(part)[1:] if isinstance(extra, Bounds))
                found.update((name, bounds) for bounds in limits)
                break
    return found


Positive = Annotated[float, Bounds(above=0)]
NonNegative = Annotated[float, Bounds(low=0)]
Count = Annotated[int, Bounds(low=1)]
Fraction = Annotated[float, Bounds(low=0, high=1)]
Range = Annotated[tuple[float, float], Ordered()]
Span = Annotated[tuple[NonNegative, NonNegative], Ordered()]
Seed = Annotated[int, Bounds(low=0, high=2**32 - 1)]
