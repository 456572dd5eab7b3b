"""What a file may claim before it is refused."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
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


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize(
    ("check", "says"),
    [
        (lambda path: check_claim(path, "pixels", 1300, 12), "packed: claims 1,300 pixels, expected at most 12"),
        (lambda path: check_claim(path, "pixels", 1e20, 12), r"claims 1e\+20"),
        (lambda path: check_unpacked(path, 501), "claims 501 bytes when unpacked, expected at most 500"),
        (lambda path: check_pixels(path, 3, 5), "pixels"),
        (lambda path: check_pixels(path, 0, 5), "at least one each way"),
        (lambda path: check_pixels(path, 5, -1), "at least one each way"),
    ],
)
def test_a_claim_beyond_its_limit_is_named(tmp_path: Path, check: Callable[[Path], object], says: str) -> None:
    """A large packed file may unpack to more."""
    path = tmp_path / "packed"
    path.write_bytes(bytes(50))
    assert [unpacked_allowance(size) for size in (1, 10, 50)] == [100, 100, 500]
    check_claim(path, "pixels", 12, 12)
    check_unpacked(path, 500)
    check_pixels(path, 3, 4)
    with pytest.raises(FileError, match=says):
        check(path)
