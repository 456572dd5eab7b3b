"""When frames were taken: from their names, or from a file of times."""

from __future__ import annotations

import codecs
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tossid import budget
from tossid.errors import FileError

TIME_FILES = ("times.txt", "timestamps.txt", "times.csv", "timestamps.csv", "data.csv")
LARGEST_EXPONENT = 30
"""Of a time in powers of ten; larger ones would be written out."""
NANOSECONDS = 10**12
"""Whole numbers from here on are nanoseconds, all else seconds, where no header names the unit."""
LATEST_NS = 1 << 62
"""No clock shows a time beyond this: it is the year 2116."""
RATES_HZ = (2.0, 10_000.0)
"""Frame rates of cameras that film tosses; others mean that times are in another unit, or no times."""
UNITS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
"""Nanoseconds of each unit of time."""
_SPELLINGS = {
    "s": r"s|sec|secs|seconds?",
    "ms": r"ms|msec|milliseconds?",
    "us": r"us|µs|μs|usec|microseconds?",
    "ns": r"ns|nsec|nanoseconds?",
}
_TIME_COLUMN = re.compile(
    r"(?:t|ts|times?|time_?stamps?|stamps?|(?:pts|pkt_pts|best_effort_timestamp)_time)"
    rf"(?:_?(?P<unit>{'|'.join(_SPELLINGS.values())}))?"
)
_IN_BRACKETS = re.compile(r"[\s_]*[\[(]\s*(\w+)\s*[\])]")
_MKVEXTRACT = re.compile(r"#\s*time(?:stamp|code) format v[24]", re.IGNORECASE)


@dataclass(frozen=True)
class _Header:
    """Which of a file's columns is the time, and its unit; `firm` where it cannot be a mere comment."""

    n_columns: int
    column: int
    unit: str | None
    firm: bool


@dataclass(frozen=True, eq=False)
class TimesFile:
    """A file of times.

    Attributes:
        path: The file.
        names: Name of each line's frame, None where the line has none.
        t_ns: Time of each line [ns].
        unit: In which they were read.
    """

    path: Path
    names: tuple[str | None, ...]
    t_ns: NDArray[np.int64]
    unit: str

    def times(self, n_frames: int, what: str) -> NDArray[np.int64]:
        """The times [ns] of so many frames, one a line.

        Raises:
            FileError: There is another number of lines, or the times are no camera's.
        """
        if len(self.t_ns) != n_frames:
            raise FileError(self.path, f"has {len(self.t_ns)} times for {what}; expected one each")
        check_rate(self.path, self.t_ns, unit=self.unit)
        return self.t_ns


def time_of(text: str) -> int | None:
    """A time stamp [ns] from its text, a number of seconds or whole nanoseconds; None if it is none."""
    value = _number(text)
    return None if value is None else round(value * UNITS[_usual_unit(value)])


def _number(text: str) -> Decimal | None:
    try:
        value = Decimal(text.replace(",", "."))
    except InvalidOperation:
        return None
    return value if math.isfinite(value) and value.adjusted() <= LARGEST_EXPONENT else None


def _usual_unit(value: Decimal) -> str:
    exponent = value.as_tuple().exponent
    return "ns" if isinstance(exponent, int) and exponent >= 0 and abs(value) >= NANOSECONDS else "s"


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


def names_as_times(images: Sequence[Path]) -> NDArray[np.int64]:
    """Time stamps [ns] of images from their names; see `time_of_name`.

    Raises:
        FileError: A name is no time, or one beyond `LATEST_NS`.
    """
    found = np.empty(len(images), dtype=np.int64)
    for i, image in enumerate(images):
        t_ns = time_of_name(image)
        if abs(t_ns) > LATEST_NS:
            raise FileError(image, f"has the time stamp {t_ns} ns, expected at most {LATEST_NS}")
        found[i] = t_ns
    return found


def read_times(path: Path) -> TimesFile:
    """Read a file of times: a line for each frame, with its time alone, or with the name of the frame.

    Columns stand between commas, semicolons, tabs or blanks. A header, as a comment (`#`) or not, may name them and the
    unit (`frame,time [ms]`); that of mkvextract means milliseconds. Without one, times are seconds or whole
    nanoseconds. Times that were rounded to a decimal, and lie on an even grid within that, are put on the grid.

    Returns:
        Names and times of its lines, which `check_rate` has not seen yet.

    Raises:
        FileError: It cannot be read, or a line holds no time, or two numbers of which either may be the time.
    """
    header: _Header | None = None
    names: list[str | None] = []
    values: list[tuple[Decimal, str]] = []
    for row, line in enumerate(_lines(path), start=1):
        if not line:
            continue
        if line.startswith("#") or (not values and header is None and not any(map(_number, _words(line)))):
            found = _header(line)
            header = found or header
            if found or line.startswith("#"):
                continue
        name, value, unit = _entry(path, row, line, header)
        names.append(name)
        values.append((value, unit or _usual_unit(value)))
    t_ns = np.array([round(value * UNITS[unit]) for value, unit in values], dtype=object)
    if len(t_ns) and max(abs(t_ns)) > LATEST_NS:
        raise FileError(path, f"has a time of {max(abs(t_ns))} ns, expected at most {LATEST_NS}")
    finest = min((float(value.as_tuple().exponent) for value, _ in values), default=0.0)
    unit = values[0][1] if values else "s"
    return TimesFile(path, tuple(names), evened(t_ns.astype(np.int64), UNITS[unit] * 10.0**finest), unit)


def _lines(path: Path) -> list[str]:
    budget.check_claim(path, "bytes of times", budget.regular_size(path), budget.limits().unpacked)
    try:
        content = path.read_bytes()
        wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        return [line.strip() for line in content.decode("utf-16" if wide else "utf-8-sig").splitlines()]
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(path, f"cannot be read: {error}") from error


def _words(line: str, n_columns: int | None = None) -> list[str]:
    """A line's columns: between semicolons, else tabs, else commas (not in a file of one column), else blanks."""
    for mark in (";", "\t", ","):
        if mark in line and n_columns != 1:
            return [word.strip().strip('"') for word in line.split(mark)]
    return line.split()


def _header(line: str) -> _Header | None:
    """The columns that a line names, None where it names no time."""
    if _MKVEXTRACT.match(line):
        return _Header(1, 0, "ms", True)
    words = _words(_IN_BRACKETS.sub(r"_\1", line.lstrip("#").strip().lower()))
    found = [(column, match) for column, word in enumerate(words) if (match := _TIME_COLUMN.fullmatch(word))]
    if len(found) != 1:
        return None
    ((column, match),) = found
    unit = match["unit"] and next(unit for unit, names in _SPELLINGS.items() if re.fullmatch(names, match["unit"]))
    return _Header(len(words), column, unit, not line.startswith("#"))


def _entry(path: Path, row: int, line: str, header: _Header | None) -> tuple[str | None, Decimal, str | None]:
    """The name of a line's frame, its time, and the unit that a header states."""
    words = _words(line, header.n_columns if header else None)
    if header is not None and header.firm and len(words) != header.n_columns:
        raise FileError(path, f"'{line}' has {len(words)} columns; its header names {header.n_columns}", row=row)
    if header is None or len(words) != header.n_columns:
        header, words = None, _words(line)
    numbers = [_number(word) for word in words]
    name = next((word for word, number in zip(words, numbers, strict=True) if number is None), None)
    given = [number for number in numbers if number is not None]
    if header is not None:
        given = [number for number in numbers[header.column : header.column + 1] if number is not None]
    if not given:
        raise FileError(path, f"'{line}' is no time; expected seconds or nanoseconds", row=row)
    if len(given) > 1:
        problem = "holds several numbers that may be the time"
        raise FileError(
            path,
            f"'{line}' {problem}; a first line 'frame,time' says which it is (and decimal commas be points)",
            row=row,
        )
    return name, given[0], header.unit if header is not None else None


def times_of(path: Path, images: Sequence[Path]) -> NDArray[np.int64]:
    """Time stamps [ns] of images, in their order, from a file that names them, or that has one line for each.

    Raises:
        FileError: an image has no line, the counts differ, or the times are no camera's.
    """
    file = read_times(path)
    named = {name: t_ns for name, t_ns in zip(file.names, file.t_ns, strict=True) if name is not None}
    if not named:
        return file.times(len(images), f"{len(images)} images, in order of their names")
    missing = [image.name for image in images if image.name not in named]
    if missing:
        raise FileError(path, f"has no time for {missing[0]} ({len(missing)} of {len(images)} images have none)")
    found = np.array([named[image.name] for image in images], dtype=np.int64)
    check_rate(path, found, unit=file.unit)
    return found


def usual_rate(t_ns: NDArray[np.int64]) -> float | None:
    """Frames a second [Hz] of most of a camera's steps of time; None with fewer than two frames."""
    steps = np.diff(np.sort(t_ns)).astype(float)
    usual = steps[np.abs(steps - np.median(steps)) <= 0.6 * np.median(steps)] if len(steps) else steps
    mean = float(usual.mean()) if len(usual) else 0.0
    return 1e9 / mean if mean > 0 else None


def check_rate(path: Path, t_ns: NDArray[np.int64], *, unit: str, named: bool = False) -> None:
    """Refuse times at which no camera takes frames that show a toss.

    Args:
        path: Where they were read.
        t_ns: Times of a camera's frames [ns].
        unit: The unit, one of `UNITS`, in which they were read.
        named: Whether they are names of images; else they stand in a file of times.

    Raises:
        FileError: Their rate is out of `RATES_HZ`; it asks for the unit with which it would not be.
    """
    rate = usual_rate(t_ns)
    slowest, fastest = RATES_HZ
    if rate is None or slowest <= rate <= fastest:
        return
    in_unit = {other: rate * UNITS[unit] / ns for other, ns in UNITS.items()}
    likely = min(in_unit, key=lambda other: abs(np.log(in_unit[other] / 100.0)))
    step = f"its frames are {1 / rate:.4g} s apart, read in {unit}, expected {1 / fastest:g} to {1 / slowest:g} s"
    if named:
        asked = f"; are the images numbered? A {TIME_FILES[0]} beside them says when they were taken"
    elif slowest <= in_unit[likely] <= fastest:
        asked = f"; are the times in {likely}? A first line '# time [{likely}]' says so"
    else:
        asked = ""
    raise FileError(path, f"{step}{asked}")


def evened(t_ns: NDArray[np.int64], tick_ns: float) -> NDArray[np.int64]:
    """Times that were rounded to a coarse unit, put back on the even grid that they were taken on.

    Args:
        t_ns: Times of a camera's frames in order [ns]; frames may be missing.
        tick_ns: The unit to which they were rounded [ns].

    Returns:
        Times on a grid, where one lies within three quarters of the unit from all of them, and the unit is at most half
        a frame; else the same times.
    """
    steps = np.diff(t_ns).astype(float)
    rate = usual_rate(t_ns)
    if len(t_ns) < 3 or rate is None or (steps <= 0).any() or tick_ns > 0.5e9 / rate:
        return t_ns
    period, since = 1e9 / rate, (t_ns - t_ns[0]).astype(float)
    for _ in range(5):
        number = np.concatenate([[0.0], np.cumsum(np.maximum(np.round(steps / period), 1.0))])
        slope, start = np.polyfit(number, since, 1)
        if abs(slope - period) < 1e-9 * period:
            break
        period = float(slope)
    even = start + slope * number
    if np.abs(even - since).max() > 0.75 * tick_ns:
        return t_ns
    return np.asarray(t_ns[0] + np.round(even).astype(np.int64))
