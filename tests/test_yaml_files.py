"""YAML from outside: what only a hostile file holds is one clear error, at once."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import pytest

from tossid.errors import FileError, brief
from tossid.yaml_files import number, read_yaml

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
        ("a: &a {x: 1}\nb: {<<: *a}", r"not valid YAML \(line 2\)"),
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
    path.write_text(content)
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
