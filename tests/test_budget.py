"""What a file may claim before it is refused."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tossid.budget import (
    check_claim,
    check_pixels,
    check_unpacked,
    limits,
    regular_size,
    unpacked_allowance,
    use_limits,
)
from tossid.errors import FileError
from tossid.settings.limits import ReadLimits


@pytest.fixture
def small() -> Iterator[None]:
    """Limits of a few bytes and pixels."""
    before = limits()
    use_limits(ReadLimits(unpacked=100, ratio=10, pixels=12))
    yield
    use_limits(before)


def test_only_regular_files_have_a_size(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"12345")
    assert regular_size(tmp_path / "file") == 5
    os.mkfifo(tmp_path / "pipe")
    for name, says in (("pipe", "not a regular file"), ("", "not a regular file"), ("gone", "no such file")):
        with pytest.raises(FileError, match=says):
            regular_size(tmp_path / name)


def test_a_claim_beyond_its_limit_is_named() -> None:
    check_claim(Path("a.png"), "pixels", 12, 12)
    with pytest.raises(FileError, match=r"a.png: claims 1,300 pixels, expected at most 12"):
        check_claim(Path("a.png"), "pixels", 1300, 12)
    with pytest.raises(FileError, match=r"claims 1e\+20"):
        check_claim(Path("a.png"), "pixels", 1e20, 12)


@pytest.mark.usefixtures("small")
def test_a_large_packed_file_may_unpack_to_more(tmp_path: Path) -> None:
    assert [unpacked_allowance(size) for size in (1, 10, 50)] == [100, 100, 500]
    path = tmp_path / "packed"
    path.write_bytes(bytes(50))
    check_unpacked(path, 500)
    with pytest.raises(FileError, match="claims 501 bytes when unpacked, expected at most 500"):
        check_unpacked(path, 501)


@pytest.mark.usefixtures("small")
def test_an_image_has_some_pixels_and_not_too_many() -> None:
    check_pixels(Path("a.png"), 3, 4)
    for width, height, says in ((3, 5, "pixels"), (0, 5, "at least one each way"), (5, -1, "at least one each way")):
        with pytest.raises(FileError, match=says):
            check_pixels(Path("a.png"), width, height)
