"""Files from outside: what they may claim, text in its encodings, and YAML that only a hostile file holds."""

from __future__ import annotations

import os
import re
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
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
from tossid.errors import FileError, brief
from tossid.settings.limits import ReadLimits
from tossid.text_files import read_text
from tossid.yaml_files import check_keys, number, numbers, read_pose, read_yaml


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


# ---------------------------------------------------------------- text


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


# ---------------------------------------------------------------- YAML


LAUGHS = "\n".join(["a0: &a0 [x]", *(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 30))])


def test_a_mapping_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("x: 1\ny: [2.5, 1.0e-05, 0x10]\nz: {text: größer, none: ~}\nw: &w [1]\nv: *w\n")
    assert read_yaml(path) == {
        "x": 1,
        "y": [2.5, 1e-5, 16],
        "z": {"text": "größer", "none": None},
        "w": [1],
        "v": [1],
    }


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("%YAML:1.0\n---\na: [1, 2]\n", "utf-8"),
        ("%YAML:1.0\n\n# made by FileStorage\na: [1, 2]\n", "utf-8"),
        ("%YAML 1.2\n---\na: [1, 2]\n", "utf-8"),
        ("a: [1, 2]\r\n", "utf-8-sig"),
        ("a: [1, 2]\n", "utf-16"),
    ],
)
def test_opencvs_first_line_and_marks_of_windows_are_read(tmp_path: Path, text: str, encoding: str) -> None:
    (tmp_path / "a.yaml").write_bytes(text.encode(encoding))
    assert read_yaml(tmp_path / "a.yaml") == {"a": [1, 2]}


def test_a_matrix_of_opencv_or_ros_holds_its_numbers(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("%YAML:1.0\n---\nD: !!opencv-matrix\n   rows: 1\n   cols: 2\n   dt: d\n   data: [ 1., 2.e-1 ]\n")
    assert numbers(path, "D", read_yaml(path)["D"], 2).tolist() == [1.0, 0.2]
    assert numbers(path, "D", {"rows": 1, "cols": 2, "data": [1, 2]}, 2).tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"sise": 1}, "a.b.sise is no key that is read; did you mean 'size'?"),
        ({"zzz": 1}, "a.b.zzz is no key that is read; expected one of id, size"),
        ({"K": 1}, "a.b.K is no key that is read; expected id: a number"),
        ({5: 1}, "a.b.5 is no key that is read; expected one of id, size"),
        ({"\n": 1}, "is no key that is read"),
    ],
)
def test_a_key_that_nothing_reads_is_refused(given: dict[object, int], says: str) -> None:
    check_keys(Path("x"), "a.b", {"id": 1, "size": 2, "bits": 3}, ("id", "size"), unused=("bits",))
    with pytest.raises(FileError, match=re.escape(says)):
        check_keys(Path("x"), "a.b", {"id": 1, **given}, ("id", "size"), instead={"K": "id: a number"})


@pytest.mark.parametrize(
    ("rotation", "says"),
    [
        ({"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}, "p.rotation.w is no key that is read; expected the rotation vector"),
        ({"x": 0.0, "y": 90.0, "z": 0.0}, "p.rotation is 90 long, which is no angle in radians"),
        ({"x": 5.0, "y": 4.0, "z": 0.0}, "p.rotation is 6.403 long, which is no angle in radians"),
    ],
)
def test_a_rotation_that_is_no_rotation_vector_is_refused(rotation: dict[str, float], says: str) -> None:
    at = {"x": 0, "y": 0, "z": 0}
    assert read_pose(Path("x"), "p", {"position": at, "rotation": {"x": 0, "y": 0, "z": 2 * np.pi}}).shape == (4, 4)
    with pytest.raises(FileError, match=re.escape(says)):
        read_pose(Path("x"), "p", {"position": at, "rotation": rotation})
    with pytest.raises(FileError, match="expected rotation: the rotation vector"):
        read_pose(Path("x"), "p", {"position": at, "orientation": rotation})


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("[1, 2]", "no mapping"),
        ("a: [1", r"not valid YAML \(line"),
        ("a: 2001-99-99", "not valid YAML"),
        ("a: " + "9" * 5000, r"not valid YAML \(line 1\)"),
        ("a: " + "1:" * 60_000 + "1", r"not valid YAML \(line 1\)"),
        ("a: " + "1:" * 190 + "1.5", "not valid YAML"),
        ("a: " + "[" * 100_000, "nested too deeply"),
        ("\n".join(" " * i + "a:" for i in range(700)), "nested too deeply"),
        ("a: &a {x: 1}\nb: {<<: *a}", r"line 2: merge keys \(<<\) are not read"),
        ("a: 1\nb: 2\na: 3", "line 3: 'a' stands here a second time"),
        ("a:\n\t- 1", r"not valid YAML \(line 2\): found character that cannot start any token"),
        ("a: !!opencv-matrix 3", r"not valid YAML \(line 1\): expected a matrix"),
        ("a: \udcff", "not valid YAML: "),
        ("a: " + "x" * 300_000, "larger than 256 KiB"),
        ("!!python/object/apply:os.system [ls]", "not valid YAML"),
        ("\x00", "not valid YAML"),
        ("a: !!int ''", "not valid YAML"),
        ("a: !!timestamp x", "not valid YAML"),
    ],
    ids=lambda text: text[:24],
)
def test_anything_else_is_one_clear_error(content: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes(content.encode(errors="surrogateescape"))
    with pytest.raises(FileError, match=says) as caught:
        read_yaml(path)
    assert str(caught.value).count("a.yaml") == 1  # one error, not one in another


def test_what_laughs_a_billion_times_is_said_briefly(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(LAUGHS)
    tracemalloc.start()
    with pytest.raises(FileError, match="claims 1e\\+28 values, with all that its aliases repeat") as caught:
        read_yaml(path)
    largest = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(str(caught.value)) < 1000
    assert largest < 2**23


@pytest.mark.parametrize(
    ("value", "text"),
    [(1.5, "1.5"), ("a\nb", r"'a\nb'"), ([1, "two"], "[1, 'two']"), (1 << 20_000, "a long int")],
    ids=["number", "text", "list", "long"],
)
def test_a_value_in_an_errors_words(value: object, text: str) -> None:
    assert brief(value) == text


@pytest.mark.parametrize("value", [10**30, 1 << 20_000, "1e999", "nan", None, True, [1]], ids=lambda v: brief(v)[:9])
def test_numbers_are_finite(value: object) -> None:
    if value == 10**30:
        assert number(Path("a"), "x", value) == 1e30
    else:
        with pytest.raises(FileError, match="expected a finite number"):
            number(Path("a"), "x", value)
