"""Numbers, parameters and places of a diagnosis in the units that a person reads."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tossid.diagnosis.findings import Interval

_UNITS = {
    "m": ("mm", 1e3),
    "s": ("ms", 1e3),
    "rad": ("deg", 180 / math.pi),
    "rel": ("", 1.0),
    "ms2": ("m/s²", 1.0),
    "ms": ("m/s", 1.0),
    "n": ("N", 1.0),
    "npm": ("N/m", 1.0),
    "nspm": ("N s/m", 1.0),
    "ns2pm2": ("N s²/m²", 1.0),
    "ns2pm": ("N s²/m", 1.0),
    "nms": ("N m s", 1.0),
    "nm": ("N m", 1.0),
    "nmprad": ("N m/rad", 1.0),
    "ps": ("1/s", 1.0),
}
"""Suffix of a parameter's name: the unit in which it is written, and the factor from SI to that unit."""
_ZERO = 1e-9
"""Size below which a number is what rounding leaves of zero."""
_NARROW = 1e-6
"""Width of an interval over its value below which it is one value."""


def listed(words: Sequence[str], last: str = "and") -> str:
    """Words as an enumeration: "a, b and c".

    Args:
        words: What is listed.
        last: The word before the last item.
    """
    return ", ".join(words) if len(words) < 2 else f"{', '.join(words[:-1])} {last} {words[-1]}"


def short(value: float, digits: int = 3) -> str:
    """A number with so many significant digits, without an exponent for everyday sizes; "unknown" if it is not finite.

    Args:
        value: The number.
        digits: Significant digits.
    """
    if not math.isfinite(value):
        return "unknown"
    if abs(value) < _ZERO:
        return "0"
    if 1e-4 <= abs(value) < 1e6:
        return _grouped(value, max(0, digits - 1 - math.floor(math.log10(abs(value)))))
    return f"{value:.{digits - 1}e}".replace("-", "−")


def percent(share: float) -> str:
    """A share in percent; "unknown" if it is not finite.

    Args:
        share: The share, 1 for all.
    """
    return f"{_grouped(100 * share, 0)} %" if math.isfinite(share) else "unknown"


def percent_span(value: Interval) -> str:
    """A share with its interval, none of them over 100 %: "70 % (65 % to 75 %)"; without one that is not known.

    Args:
        value: The share and its interval.
    """
    return _with_ends(*(percent(min(x, 1.0)) for x in (value.value, value.low, value.high)))


def span(value: Interval, unit: str = "", *, level: str = "") -> str:
    """A value with its interval, with two digits of the interval's width: "0.299 (0.297 to 0.301)".

    An interval that is one value, or not known, is left out.

    Args:
        value: The value and its interval.
        unit: Written after the value.
        level: Written before the interval: "95 %: ".
    """
    width = value.high - value.low
    if not (math.isfinite(width) and width > max(_NARROW * abs(value.value), _ZERO)):
        return f"{short(value.value)} {unit}".rstrip()
    decimals = min(max(0, 1 - math.floor(math.log10(width))), 8)
    texts = [_grouped(x, decimals) for x in (value.value, value.low, value.high)]
    return _with_ends(f"{texts[0]} {unit}".rstrip(), *texts[1:], level=level)


def parameter(key: str) -> str:
    """A parameter's name without its unit: "x_m" is "x", "static_mu" is "static mu".

    Args:
        key: The parameter's name in the library.
    """
    head, _, tail = key.rpartition("_")
    return (head if head and tail in _UNITS else key).replace("_", " ")


def unit_of(key: str) -> tuple[str, float]:
    """The unit in which a parameter is written, and the factor from SI to it.

    Args:
        key: The parameter's name in the library.
    """
    return _UNITS.get(key.rpartition("_")[2], ("", 1.0)) if "_" in key else ("", 1.0)


def quantity(key: str, value: float) -> str:
    """A parameter's value in its unit, as somebody has stated it, with at most four digits: "1.5 mm".

    Args:
        key: The parameter's name in the library.
        value: Its value [SI].
    """
    name, factor = unit_of(key)
    text = short(factor * value, 4)
    if "." in text and "e" not in text:
        text = text.rstrip("0").rstrip(".")
    return f"{text} {name}".rstrip()


def in_units(key: str, value: Interval, *, level: str = "") -> str:
    """A parameter's estimate with its interval, in its unit.

    Args:
        key: The parameter's name in the library.
        value: The estimate and its interval [SI].
        level: As `span` takes it.
    """
    name, factor = unit_of(key)
    return span(value.scaled(factor), name, level=level)


def size_of_change(key: str, size: float) -> str:
    """The size of a parameter's change in its unit; of relative parameters in percent.

    Args:
        key: The parameter's name in the library.
        size: The change [SI].
    """
    name, factor = ("%", 100.0) if key.endswith("_rel") else unit_of(key)
    return f"{short(factor * size, 2)} {name}".rstrip()


def place_of(place: Sequence[float]) -> str:
    """A point on a body in millimetres: "(+52, +52, −52) mm".

    Args:
        place: The point (3,) [m].
    """
    millimetres = [round(1e3 * x) for x in place]
    return f"({', '.join(f'{x:+d}' if x else '0' for x in millimetres)}) mm".replace("-", "−")


def _with_ends(value: str, low: str, high: str, *, level: str = "") -> str:
    return value if low == high or "unknown" in (value, low, high) else f"{value} ({level}{low} to {high})"


def _grouped(value: float, decimals: int) -> str:
    """Digits in groups of three, divided by thin spaces; what rounds to zero has no sign."""
    return f"{round(value, decimals) + 0.0:,.{decimals}f}".replace("-", "−").replace(",", "\u202f")
