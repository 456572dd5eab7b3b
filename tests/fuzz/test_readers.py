"""Whatever a file from outside holds, reading it succeeds or is one clear error. `make fuzz` looks further."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.fuzz.targets import TARGETS
from tossid.errors import TossidError

FINDINGS = sorted(path for path in (Path(__file__).parent / "findings").glob("*/*") if path.is_file())


HUGE = (
    *(number.to_bytes(size, order) for number in (2**31 - 1, 10**9) for size in (4, 8) for order in ("little", "big")),
    b"1000000000",
    b"1e300",
)
"""Counts and sizes that no file of this size has."""


def claim(content: bytearray, place: int, huge: bytes) -> None:
    """Write a huge number over what is there: text over the next number in digits, bytes over bytes."""
    if not huge.isalnum():
        content[place : place + len(huge)] = huge
    elif found := re.compile(rb"\d+(\.\d+)?").search(content, place):
        content[found.start() : found.end()] = huge


def survives(name: str, file: Path, content: bytes) -> None:
    """Reading that content is no crash."""
    file.write_bytes(content)
    try:
        TARGETS[name].read(file)
    except TossidError as error:
        assert str(error)


@pytest.mark.parametrize("name", TARGETS)
def test_valid_files_are_read(name: str, tmp_path: Path) -> None:
    TARGETS[name].read(TARGETS[name].make(tmp_path))


@pytest.mark.parametrize("finding", FINDINGS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_what_fuzzing_found_is_one_clear_error(finding: Path, tmp_path: Path) -> None:
    name = finding.parent.name
    survives(name, TARGETS[name].make(tmp_path), finding.read_bytes())


@pytest.mark.parametrize("name", TARGETS)
@settings(max_examples=25, deadline=5000, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True)
@given(data=st.data())
def test_damaged_files_are_one_clear_error(name: str, data: st.DataObject, tmp_path: Path) -> None:
    made = TARGETS[name].make(_emptied(tmp_path / "input"))
    content = bytearray(made.read_bytes())
    for _ in range(data.draw(st.integers(1, 4), label="changes")):
        place = data.draw(st.integers(0, len(content)), label="place")
        what = data.draw(st.sampled_from(("flip", "cut", "insert", "repeat", "claim")), label="what")
        some = data.draw(st.binary(min_size=1, max_size=8), label="bytes")
        if what == "flip":
            content[place : place + len(some)] = some
        elif what == "cut":
            del content[place : place + data.draw(st.integers(1, 200), label="length")]
        elif what == "insert":
            content[place:place] = some
        elif what == "claim":
            claim(content, place, data.draw(st.sampled_from(HUGE), label="huge"))
        else:
            content[place:place] = content[place : place + 40]
    survives(name, made, bytes(content))


def _emptied(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    return folder
