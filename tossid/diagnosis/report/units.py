"""Numbers, parameters and places of a diagnosis in the units that a person reads."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tossid.diagnosis.findings import Interval

_UNITS = {
    "m": ("mm", 1e3),
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


def listed(words: Sequence[str], last: str = "and") -> str:
    """Words as an enumeration: "a, b and c".

    Args:
        words: What is listed.
        last: The word before the last item.

    Returns:
        The text; empty for no words.
    """
    return ", ".join(words) if len(words) < 2 else f"{', '.join(words[:-1])} {last} {words[-1]}"


def percent(share: float) -> str:
    """A share in percent, with a typographic minus.

    Args:
        share: The share, 1 for all.

    Returns:
        The text, "unknown" for a value that is not finite.
    """
    return f"{100 * share:.0f} %".replace("-0 %", "0 %").replace("-", "−") if math.isfinite(share) else "unknown"


def closed_share(closed: Interval, value: float | None = None) -> str:
    """A share of the gap that is closed, in percent and at most 100 %.

    Args:
        closed: The share.
        value: One end of its interval, if that is to be written.

    Returns:
        The text.
    """
    return percent(min(closed.value if value is None else value, 1.0))


def short(value: float, digits: int = 3) -> str:
    """A number with so many significant digits, without an exponent for everyday sizes.

    Args:
        value: The number.
        digits: Significant digits.

    Returns:
        The text, "unknown" for a value that is not finite.
    """
    if not math.isfinite(value):
        return "unknown"
    if value == 0 or 1e-4 <= abs(value) < 1e6:
        decimals = max(0, digits - 1 - math.floor(math.log10(abs(value)))) if value else 0
        return _grouped(value, decimals)
    return f"{value:.{digits - 1}e}".replace("-", "−")


def span(value: Interval, digits: int = 3) -> str:
    """A value with its interval: "0.300 (0.297 to 0.303)".

    Args:
        value: The value and its interval.
        digits: Significant digits of each number.

    Returns:
        The text.
    """
    return f"{short(value.value, digits)} ({short(value.low, digits)} to {short(value.high, digits)})"


def percent_span(value: Interval) -> str:
    """A share with its interval: "70 % (65 % to 75 %)".

    Args:
        value: The share and its interval.

    Returns:
        The text.
    """
    return f"{percent(value.value)} ({percent(value.low)} to {percent(value.high)})"


def parameter(key: str) -> str:
    """A parameter's name without its unit: "x_m" is "x", "static_mu" is "static mu".

    Args:
        key: The parameter's name in the library.

    Returns:
        The name in words.
    """
    head, _, tail = key.rpartition("_")
    return (head if head and tail in _UNITS else key).replace("_", " ")


def unit(key: str) -> tuple[str, float]:
    """The unit in which a parameter is written, and the factor from SI to it.

    Args:
        key: The parameter's name in the library.

    Returns:
        The unit, empty for a pure number, and the factor.
    """
    return _UNITS.get(key.rpartition("_")[2], ("", 1.0)) if "_" in key else ("", 1.0)


def quantity(key: str, value: float) -> str:
    """A parameter's value in its unit.

    Args:
        key: The parameter's name in the library.
        value: Its value [SI].

    Returns:
        The text, for example "1.50 mm".
    """
    name, factor = unit(key)
    return f"{short(factor * value)} {name}".rstrip()


def change(key: str, size: float) -> str:
    """The size of a parameter's change in its unit; of relative parameters in percent.

    Args:
        key: The parameter's name in the library.
        size: The change [SI].

    Returns:
        The text.
    """
    name, factor = ("%", 100.0) if key.endswith("_rel") else unit(key)
    return f"{short(factor * size, 2)} {name}".rstrip()


def in_units(key: str, value: Interval) -> str:
    """A parameter's estimate with its interval: "0.299 (0.297 to 0.301)".

    Args:
        key: The parameter's name in the library.
        value: The estimate and its interval [SI].

    Returns:
        The text, with two digits of the interval's width.
    """
    name, factor = unit(key)
    estimate, low, high = (factor * x for x in (value.value, value.low, value.high))
    digits = _decimals(estimate, high - low)
    texts = [_grouped(x, digits) for x in (estimate, low, high)]
    return f"{texts[0]} {name}".rstrip() + f" ({texts[1]} to {texts[2]})"


def place_of(place: Sequence[float]) -> str:
    """A point on a body in millimetres: "(+52, +52, −52) mm".

    Args:
        place: The point (3,) [m].

    Returns:
        The text.
    """
    millimetres = [round(1e3 * x) for x in place]
    return f"({', '.join(f'{x:+d}' if x else '0' for x in millimetres)}) mm".replace("-", "−")


def _grouped(value: float, decimals: int) -> str:
    """Digits in groups of three, divided by thin spaces."""
    return f"{value:,.{decimals}f}".replace("-", "−").replace(",", "\u202f")


def _decimals(value: float, width: float) -> int:
    """Decimals that two digits of an interval's width need."""
    size = width if width > 0 and math.isfinite(width) else abs(value)
    if not size > 0:
        return 0
    return int(min(max(0, 1 - math.floor(math.log10(size))), 8))
