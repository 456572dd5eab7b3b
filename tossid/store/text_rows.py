"""Rows of numbers in a text file of a tracker, and the names that it gives its columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tossid.errors import FileError
from tossid.store.pose_columns import column_of, is_header, split_names
from tossid.text_files import read_text

Array = NDArray[np.float64]

MAX_FILE = 1 << 28
"""Largest size of a file that is one toss as text [bytes]."""
NO_NUMBER = ("", "nan", "-nan", "+nan", "nan(ind)", "-nan(ind)", "null", "none", "n/a", "na")
"""What trackers write where they have no pose."""


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
