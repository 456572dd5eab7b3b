"""Rows of numbers in a tracker's text file, the names that it gives its columns, and rows that hold no pose."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tossid.errors import FileError
from tossid.store.recorded_poses.columns import column_of, is_header, split_names
from tossid.text_files import read_text

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

MAX_FILE = 1 << 28
"""Largest size of a file that is one toss as text [bytes]."""
NO_NUMBER = ("", "nan", "-nan", "+nan", "nan(ind)", "-nan(ind)", "null", "none", "n/a", "na")
"""What trackers write where they have no pose."""
NOT_FINITE, ZERO, REPEATED = "not finite", "of zeros", "the pose before again while it moves"
"""What a row without a pose holds instead."""
_FAR = 0.03
"""Distance to the nearest pose from which on the origin is no place of the object, but stands for none [m],
if it is also so many steps, as they are in the median."""
_STEPS = 3
_MOVING = 0.1
"""Speed above which a tracked pose does not stay the same to the last digit [m/s]."""
_DIGITS = 3
"""Steps smaller than so many last digits of a file are no motion."""


def read_rows(path: Path, form: str) -> tuple[Array, list[int], list[str]]:
    """The numbers of a text file, in columns that commas, semicolons or blanks separate; `#` starts a comment.

    Args:
        path: The file.
        form: What its rows should be, for errors.

    Returns:
        (n, columns) numbers, NaN where a field is empty or says that there is none; the line of each row, from 1; and
        the names that the last line before the numbers gives the columns, none where none does.

    Raises:
        FileError: It is no such file; names the line.
    """
    rows: list[list[str]] = []
    lines: list[int] = []
    comments: list[str] = []
    header: list[str] = []
    for number, line in enumerate(read_text(path, most=MAX_FILE, expected=f"rows of '{form}'").splitlines(), start=1):
        words = _fields(line.split("#", 1)[0])
        if not words:
            if line.strip() and not rows:
                comments.append(line)
            continue
        if rows and len(words) != len(rows[0]):
            raise FileError(path, f"{len(words)} columns, expected {len(rows[0])}: '{form}'", row=f"line {number}")
        if not rows and not header and all(_number(word) is None for word in words):
            header = split_names(line)  # no comment, and no number in it
            continue
        rows.append(words)
        lines.append(number)
    if len(rows) < 2:
        raise FileError(path, f"has {len(rows)} rows of numbers, expected rows of '{form}', at least 2")
    if not any(words[-1] for words in rows):  # a separator at the end of each line
        rows = [words[:-1] for words in rows]
    if not header:
        named = [names for names in map(split_names, comments) if is_header(names, len(rows[0]))]
        named = [names[: len(rows[0])] for names in named]  # (a remark may follow)
        header = named[-1] if named else []
    # (what stands beside poses may be words)
    beside = [(column := column_of(name)) is not None and not column.part for name in header]
    values = np.full((len(rows), len(rows[0])), np.nan)
    for row, words in enumerate(rows):
        for at, word in enumerate(words):
            value = _number(word)
            if value is None and not (len(beside) > at and beside[at]):
                hint = "; decimals have a point, no comma" if "," in word or " " in word else ""
                raise FileError(path, f"'{word}' is none, expected numbers: '{form}'{hint}", row=f"line {lines[row]}")
            values[row, at] = np.nan if value is None else value
    return values, lines, header


def _fields(line: str) -> list[str]:
    """The words of a line, between semicolons, commas or blanks; commas between semicolons are decimal ones."""
    separator = next((mark for mark in ";," if mark in line), None)
    if not line.strip():
        return []
    if separator is None:
        return line.split()
    fields = [field.strip() for field in line.split(separator)]
    return [field.replace(",", ".") for field in fields] if separator == ";" else fields


def _number(word: str) -> float | None:
    """The number that a word is; NaN where it says that there is none; None for any other word."""
    if word.lower() in NO_NUMBER:
        return float("nan")
    try:
        return float(word.replace("_", "?"))
    except ValueError:
        return None


def lost_rows(t: Array, poses: Array) -> tuple[Bools, Counter[str]]:
    """Which rows hold no pose: not a number, zeros, or the last pose again although the object moves.

    Args:
        t: Times (n,) [s].
        poses: (n, 7) positions [m] and quaternions x, y, z, w; not finite where the file has none.

    Returns:
        (n,) true where there is none, and how many there are by what they hold instead.
    """
    nothing = np.asarray(~np.isfinite(poses).all(axis=1))
    zero = ~nothing & _zeros(poses, ~nothing)
    good = np.flatnonzero(~(nothing | zero))
    again = np.zeros(len(t), dtype=bool)
    again[good[_held(t[good], poses[good])]] = True
    kinds = {NOT_FINITE: nothing, ZERO: zero, REPEATED: again}
    return nothing | zero | again, +Counter({kind: int(where.sum()) for kind, where in kinds.items()})


def lost_words(rows: int, lost: Counter[str]) -> str:
    """How many rows hold no pose, in words.

    Args:
        rows: All of them.
        lost: Of these, rows without a pose, as `lost_rows` counts them.
    """
    kinds = ", ".join(f"{count} {kind}" for kind, count in lost.items())
    return f"{lost.total()} of {rows} rows hold no pose ({kinds})"


def _zeros(poses: Array, given: Bools) -> Bools:
    """Rows whose quaternion is 0, or that are at the origin, unturned, though poses beside them are far from it."""
    at_origin = given & (poses[:, :3] == 0).all(axis=1)
    no_turn = (poses[:, 3:] == 0).all(axis=1)
    unturned = at_origin & (poses[:, 3:6] == 0).all(axis=1) & (np.abs(poses[:, 6]) == 1)
    # a wxyz file has its 1 in the first place
    unturned |= at_origin & (poses[:, 4:] == 0).all(axis=1) & (np.abs(poses[:, 3]) == 1)
    others = np.flatnonzero(given & ~unturned & ~no_turn)
    if not len(others):
        return given & no_turn
    steps = np.linalg.norm(np.diff(poses[others, :3], axis=0), axis=1)
    far = max(_FAR, _STEPS * float(np.median(steps))) if len(steps) else _FAR
    for row in np.flatnonzero(unturned):
        after = int(np.searchsorted(others, row))
        beside = others[max(after - 1, 0) : after + 1]
        unturned[row] = np.linalg.norm(poses[beside, :3], axis=1).min() > far
    return (given & no_turn) | unturned


def _held(t: Array, poses: Array) -> NDArray[np.int64]:
    """Rows that repeat the one before them to the last digit, between steps of a moving object."""
    if len(t) < 4:
        return np.zeros(0, dtype=np.int64)
    step, size = np.diff(poses, axis=0), np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)
    same = (step == 0).all(axis=1)
    digits = np.abs(step[:, :3])
    least = _DIGITS * float(digits[digits > 1e-12].min(initial=np.inf))
    with np.errstate(divide="ignore", invalid="ignore"):
        moves = (size / np.diff(t) > _MOVING) & (size > least)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same, [0]]).astype(int)))
    runs = [
        np.arange(first + 1, last + 1)
        for first, last in zip(edges[::2], edges[1::2], strict=True)
        if first > 0 and last < len(same) and moves[first - 1] and moves[last]
    ]
    return np.concatenate(runs) if runs else np.zeros(0, dtype=np.int64)
