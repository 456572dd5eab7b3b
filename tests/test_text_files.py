"""Text from outside is read with the byte order marks that Windows writes, and nothing else is taken for text."""

from __future__ import annotations

from pathlib import Path

import pytest

from tossid.errors import FileError
from tossid.text_files import read_text

TEXT = "time [µs]\r\n0.5\r\n"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le-mark", "utf-16-be-mark"])
def test_marks_are_no_part_of_a_text(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "a.txt"
    marked = encoding.endswith("-mark")
    path.write_bytes((("\ufeff" if marked else "") + TEXT).encode(encoding.removesuffix("-mark")))
    assert read_text(path, most=100, expected="numbers") == TEXT


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (TEXT.encode("utf-16-le"), "is not text in UTF-8, or UTF-16 with a byte order mark, expected numbers"),
        (TEXT.encode("latin-1"), "is not text"),
        (b"\xff\xfea", "is not text"),
        (b"1" * (1 << 20), "is larger than 0 MiB, expected numbers"),
    ],
)
def test_what_is_no_text_is_refused(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(content)
    with pytest.raises(FileError, match=says):
        read_text(path, most=100, expected="numbers")
    with pytest.raises(FileError, match="no such file"):
        read_text(tmp_path / "b.txt", most=100, expected="numbers")
