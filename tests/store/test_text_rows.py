"""Rows of a tracker's file: separators, empty fields, names, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tossid.errors import FileError
from tossid.store.text_rows import read_rows

NAN = float("nan")


@pytest.mark.parametrize(
    ("text", "rows", "lines", "header"),
    [
        ("# c\n1 2\n\n3\t4 # after\n", [[1, 2], [3, 4]], [2, 4], []),
        ("1,2\n3,\n,null\n", [[1, 2], [3, NAN], [NAN, NAN]], [1, 2, 3], []),
        ("1;2,5\n0,25;-nan(ind)\n", [[1, 2.5], [0.25, NAN]], [1, 2], []),
        ("time,frame_id\n1,cam\n2,cam\n", [[1, NAN], [2, NAN]], [2, 3], ["time", "frame_id"]),
        ("# a note\n# timestamp angle\n0 NaN\n1 2\n", [[0, NAN], [1, 2]], [3, 4], ["timestamp", "angle"]),
        (
            "# time x y z of Take 3.csv t0=1.5\n0 1 2 3\n1 2 3 4\n",
            [[0, 1, 2, 3], [1, 2, 3, 4]],
            [2, 3],
            ["time", "x", "y", "z"],
        ),
        ("1, 2,\n3, 4,\n", [[1, 2], [3, 4]], [1, 2], []),
    ],
)
def test_rows(tmp_path: Path, text: str, rows: list[list[float]], lines: list[int], header: list[str]) -> None:
    (tmp_path / "a.txt").write_text(text)
    found, at, names = read_rows(tmp_path / "a.txt", "a b")
    np.testing.assert_array_equal(found, rows)
    assert (at, names) == (lines, header)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1 2\n3\n", "line 2: 1 columns, expected 2: 'a b'"),
        ("1 2\n3 x\n", "line 2: 'x' is none, expected numbers: 'a b'"),
        ("1 2\n3 1_0\n", "line 2: '1_0' is none"),
        ("0,5 1,5\n0,6 1,6\n", "line 1: '5 1' is none, expected numbers: 'a b'; decimals have a point, no comma"),
        ("a b\n1 2\n", "has 1 rows of numbers, expected rows of 'a b', at least 2"),
    ],
)
def test_what_is_refused(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(FileError) as caught:
        read_rows(tmp_path / "a.txt", "a b")
    assert says in str(caught.value)
