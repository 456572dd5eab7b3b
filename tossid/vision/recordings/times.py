"""When frames were taken: from their names, or from a file of times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path

from tossid import budget
from tossid.errors import FileError

TIME_FILES = ("times.txt", "timestamps.txt", "times.csv", "timestamps.csv", "data.csv")
LARGEST_EXPONENT = 30
"""Of a time in powers of ten; larger ones would be written out."""
NANOSECONDS = 10**12
"""Whole numbers from here on are nanoseconds, all else seconds."""


def time_of(text: str) -> int | None:
    """A time stamp as text, in seconds or whole nanoseconds, as nanoseconds; None if it is none."""
    try:
        value = Decimal(text)
    except InvalidOperation:
        return None
    if not math.isfinite(value) or value.adjusted() > LARGEST_EXPONENT:
        return None
    whole = value == value.to_integral_value() and "." not in text
    return int(value) if whole and abs(value) >= NANOSECONDS else round(value * 10**9)


def time_of_name(path: Path) -> int:
    """The time stamp [ns] in an image's name: whole nanoseconds (any whole number), or seconds with a decimal point.

    Raises:
        FileError: it is no time.
    """
    if path.stem.isdecimal():
        return int(path.stem)
    t_ns = time_of(path.stem)
    if t_ns is None:
        names = " or ".join(TIME_FILES[:2])
        raise FileError(
            path, f"is not named like a frame; expected its time stamp in ns, as 0001234567890.jpg, or a {names}"
        )
    return t_ns


def read_times(path: Path) -> list[tuple[str | None, int]]:
    """Lines of a file of times: a time each, alone or with the name of its frame (commas or blanks between).

    Lines that start with `#` are comments. Times are seconds, or whole nanoseconds.

    Returns:
        (name or None, time [ns]) of each line.

    Raises:
        FileError: it cannot be read, or a line holds no time.
    """
    budget.check_claim(path, "bytes of times", budget.regular_size(path), budget.limits().unpacked)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(path, f"cannot be read: {error}") from error
    found: list[tuple[str | None, int]] = []
    for row, line in enumerate(lines, start=1):
        words = line.replace(",", " ").replace(";", " ").split()
        if not words or words[0].startswith("#"):
            continue
        stamps = [time_of(word) for word in words]
        name = next((word for word, stamp in zip(words, stamps, strict=True) if stamp is None), None)
        t_ns = next((stamp for stamp in stamps if stamp is not None), None)
        if t_ns is None:
            raise FileError(path, f"'{line.strip()}' is no time; expected seconds or nanoseconds", row=row)
        found.append((name, t_ns))
    return found


def times_of(path: Path, images: Sequence[Path]) -> list[int]:
    """Time stamps [ns] of images, in their order, from a file that names them, or that has one line for each.

    Raises:
        FileError: an image has no line, or the counts differ.
    """
    lines = read_times(path)
    named = {name: t_ns for name, t_ns in lines if name is not None}
    if named:
        missing = [image.name for image in images if image.name not in named]
        if missing:
            raise FileError(path, f"has no time for {missing[0]} ({len(missing)} of {len(images)} images have none)")
        return [named[image.name] for image in images]
    if len(lines) != len(images):
        raise FileError(path, f"has {len(lines)} times for {len(images)} images; expected one each, in order of names")
    return [t_ns for _, t_ns in lines]
