"""Which column of a text file is which part of a pose, by the names that its header gives them.

A name is read word by word: `tx`, `x [mm]`, `p_RS_R_x [m]`, `field.pose.position.x` and `Position X` are all the x of
a position. A unit stands at its end, in brackets or after a separator; without one, times are seconds and lengths
metres.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

EXPECTED = "timestamp tx ty tz qx qy qz qw"
"""The columns of a file that names none."""

_TIMES = {
    1.0: ("s", "sec", "secs", "second", "seconds"),
    1e-3: ("ms", "msec", "msecs", "millis", "millisecond", "milliseconds"),
    1e-6: ("us", "µs", "μs", "usec", "usecs", "micros", "microsecond", "microseconds"),
    1e-9: ("ns", "nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanosecond", "nanoseconds"),
}
_LENGTHS = {
    1.0: ("m", "meter", "meters", "metre", "metres"),
    1e-2: ("cm", "centimeter", "centimeters", "centimetre", "centimetres"),
    1e-3: ("mm", "millimeter", "millimeters", "millimetre", "millimetres"),
}
_SECONDS = {word: size for size, words in _TIMES.items() for word in words}
_METRES = {word: size for size, words in _LENGTHS.items() for word in words}
_TIME = {"t", "time", "times", "timestamp", "timestamps", "stamp", "timestep"}
_POSITION = {"t", "p", "pos", "position", "trans", "translation", "location"}
_QUATERNION = {"q", "quat", "quaternion", "orientation", "rotation", "rot", "attitude"}
_AXES = {"x": "qx", "y": "qy", "z": "qz", "w": "qw", "i": "qx", "j": "qy", "k": "qz", "r": "qw"}
_BESIDE = {"v", "vel", "velocity", "linear", "angular", "twist", "b", "bias", "cov", "covariance", "seq", "frame", "id"}
_BESIDE |= {"index", "error", "residual", "markers", "quality", "child"}
"""Words of columns that stand beside poses: velocities, biases, covariances, numbers and names of frames."""
_PARTS = EXPECTED.split()
_COMPACT = re.compile(r"(t|p|pos|position|trans)([xyz])|(q|quat|quaternion|rot|rotation)([xyzwijkr])")
_WORDS = re.compile(r"[^a-z0-9µμ]+")
_UNIT = re.compile(r"[\[(]([^\])]*)[\])]\s*$")
_TOKENS = re.compile(r"\S+(?:\s*[\[(][^\])]*[\])])?")


class Column(NamedTuple):
    """What a name stands for: a part of a pose ("" for what stands beside poses), its unit in SI, and its stem."""

    part: str
    size: float
    stem: str


@dataclass(frozen=True)
class PoseColumns:
    """Where a row holds a pose.

    Attributes:
        count: Number of columns.
        times: Columns whose sum is the time, each with its unit [s].
        position: Columns of x, y, z.
        length: Their unit [m].
        quaternion: Columns of x, y, z, w.
        named: Whether a header or a person named them.
    """

    count: int
    times: tuple[tuple[int, float], ...]
    position: tuple[int, ...]
    length: float
    quaternion: tuple[int, ...]
    named: bool = True

    @property
    def w_first(self) -> bool:
        """Whether quaternions stand as w x y z."""
        return min(self.quaternion) == self.quaternion[3]


USUAL = PoseColumns(8, ((0, 1.0),), (1, 2, 3), 1.0, (4, 5, 6, 7), named=False)
"""The columns `EXPECTED`."""


def split_names(text: str) -> list[str]:
    """The names in a header, which commas, semicolons or blanks separate; a word with a colon before them is dropped.

    Args:
        text: The line, with or without its mark of a comment.
    """
    text = text.strip().lstrip("#%").strip()
    separator = next((mark for mark in ";,\t" if mark in text), None)
    if separator is not None:
        names = [name.strip().strip("\"'") for name in text.split(separator)]
        while names and not names[-1]:
            names.pop()
        return names
    names = _TOKENS.findall(text)
    return names[1:] if len(names) > 1 and names[0].endswith(":") else names


def is_header(names: Sequence[str], count: int) -> bool:
    """Whether the words of a comment name columns, and are no sentence.

    Args:
        names: Of `split_names`.
        count: Columns of the rows below.
    """
    known = sum(bool((column := column_of(name)) and column.part) for name in names)
    return known >= 3 or (known >= 1 and len(names) == count)


def column_of(name: str) -> Column | None:
    """What a column's name stands for; None if it is not known."""
    bare, unit = name.strip().lower(), ""
    bracket = _UNIT.search(bare)
    if bracket is not None:
        bare, unit = bare[: bracket.start()], bracket[1].strip()
    words = [word for word in _WORDS.split(bare) if word]
    if not words:
        return None
    if not unit and words[-1] in _SECONDS | _METRES and (len(words) > 1 or words[-1] in _SECONDS):
        unit = words.pop()
    if not words or (unit in _SECONDS and words[-1] not in _BESIDE) or words[-1] in _TIME:
        is_time = (not words or words[-1] in _TIME) and (not unit or unit in _SECONDS)
        is_rostopics = words[:1] == ["field"]  # it prints whole nanoseconds
        size = _SECONDS.get(unit, 1e-9 if is_rostopics else 1.0)
        return Column("timestamp", size, " ".join(words)) if is_time else None
    if _BESIDE & set(words):
        return Column("", 1.0, bare)
    compact, before = _COMPACT.fullmatch(words[-1]), set(words[:-1])
    axis, part = words[-1], ""
    if compact is not None:
        part = f"t{compact[2]}" if compact[2] else _AXES[compact[4]]
    elif axis in _AXES and before & _QUATERNION:
        part = _AXES[axis]
    elif axis in ("x", "y", "z") and (not before or before & _POSITION):
        part = f"t{axis}"
    if part.startswith("t") and (not unit or unit in _METRES):
        return Column(part, _METRES.get(unit, 1.0), bare)
    return Column(part, 1.0, bare) if part.startswith("q") and unit in ("", "-", "1") else None


def pose_columns(names: Sequence[str]) -> PoseColumns:
    """The columns of poses, as their names have them.

    Args:
        names: Of `split_names`.

    Returns:
        Where each part of a pose is.

    Raises:
        ValueError: A name is not known, or a part is missing or there twice; says what was expected.
    """
    found: dict[str, list[int]] = {part: [] for part in _PARTS}
    columns = [column_of(name) for name in names]
    unknown = [name for name, column in zip(names, columns, strict=True) if column is None]
    if unknown:
        raise ValueError(f"names columns that are not known ({', '.join(map(repr, unknown))}), expected '{EXPECTED}'")
    known = [column for column in columns if column is not None]
    for at, column in enumerate(known):
        if column.part:
            found[column.part].append(at)
    found["timestamp"] = _times(found["timestamp"], known, names)
    missing = [part for part in _PARTS if not found[part]]
    if missing:
        raise ValueError(f"names no column for {', '.join(missing)}, expected '{EXPECTED}' in any order")
    for part in _PARTS[1:]:
        if len(found[part]) > 1:
            both = " and ".join(repr(names[at]) for at in found[part])
            raise ValueError(f"names two columns that could both be {part} ({both}), expected '{EXPECTED}'")
    position, quaternion = (tuple(found[part][0] for part in parts) for parts in (_PARTS[1:4], _PARTS[4:]))
    lengths = {known[at].size for at in position}
    if len(lengths) > 1:
        raise ValueError("names other units for tx, ty and tz, expected one")
    times = tuple((at, known[at].size) for at in found["timestamp"])
    return PoseColumns(len(names), times, position, lengths.pop(), quaternion)


def _times(at: list[int], columns: Sequence[Column], names: Sequence[str]) -> list[int]:
    """The columns that make the time: one, or whole seconds and nanoseconds; of ROS, the stamp of the message."""
    if len(at) == 2 and {"time", "field header stamp"} == {columns[i].stem for i in at}:
        at = [i for i in at if columns[i].stem != "time"]  # (when the message came in)
    sizes = sorted(columns[i].size for i in at)
    if len(at) < 2 or (sizes == [1e-9, 1.0] and len({columns[i].stem for i in at}) == 1):
        return at
    both = " and ".join(repr(names[i]) for i in at)
    raise ValueError(f"names columns that could each be the time ({both}), expected one, or seconds and nanoseconds")
