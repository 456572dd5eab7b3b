"""YAML from outside: one mapping, or one clear error.

libyaml parses the text, as PyYAML's parser in Python takes five times as long. PyYAML's composer in Python builds the
values, as its composer in C crashes where nesting is deep. Merge keys (`<<`) let a kilobyte unpack to gigabytes, and
numbers of a hundred thousand digits take long. No description of cameras or objects needs them, so they are refused.
OpenCV's files are read: their first line `%YAML:1.0`, which is no YAML, and their matrices.
"""

from __future__ import annotations

import codecs
import contextlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from yaml.composer import Composer

from tossid import budget
from tossid.errors import FileError, brief, nearest
from tossid.rotations import transform_from_rotvec

Array = NDArray[np.float64]

LARGEST = 1 << 18
"""Bytes of a file."""
LONGEST_NUMBER = 400
"""Characters."""
ROTATION = "the rotation vector x, y, z in radians (axis times angle, at most 2π long; no quaternion, no degrees)"
"""How rotations are written."""


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML file that holds a mapping.

    Raises:
        FileError: it is missing, no such file, or holds what only a hostile one does.
    """
    if budget.regular_size(path) > LARGEST:
        raise FileError(path, f"is larger than {LARGEST >> 10} KiB, expected a description in YAML")
    try:
        text = path.read_bytes().removeprefix(codecs.BOM_UTF8)
    except OSError as error:
        raise FileError(path, f"cannot be read: {error}") from error
    if text.startswith(b"%YAML:"):
        text = b"#" + text[1:]
    try:
        content = _Loader(path, text).get_single_data()
    except FileError:
        raise
    except yaml.MarkedYAMLError as error:
        mark, problem = error.problem_mark or error.context_mark, error.problem or error.context
        line = "" if mark is None else f" (line {mark.line + 1})"
        raise FileError(path, f"is not valid YAML{line}: {problem}") from error
    except yaml.YAMLError as error:  # of bytes that are no text
        raise FileError(path, f"is not valid YAML: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise FileError(path, "is nested too deeply") from error
    except Exception as error:  # of dates and numbers that are none, PyYAML raises whatever it comes across
        raise FileError(path, f"is not valid YAML ({error})") from error
    if not isinstance(content, dict):
        raise FileError(path, "holds no mapping of names to values")
    _check_repeated(path, content)
    return content


def _check_repeated(path: Path, content: Any) -> None:
    """Refuse a file whose aliases repeat values without end, or too many of them. Each value is looked at once."""
    counts: dict[int, int] = {}

    def count(value: Any) -> int:
        if not isinstance(value, dict | list):
            return 1
        known = counts.get(id(value))
        if known == 0:
            raise FileError(path, "holds a value that contains itself")
        if known is None:
            counts[id(value)] = 0
            inner = [*value, *value.values()] if isinstance(value, dict) else value
            known = counts[id(value)] = 1 + sum(map(count, inner))
        return known

    budget.check_claim(path, "values, with all that its aliases repeat", count(content), budget.limits().yaml_nodes)


def check_keys(
    path: Path,
    where: str,
    given: Mapping[Any, Any],
    read: Iterable[str],
    *,
    unused: Iterable[str] = (),
    instead: Mapping[str, str] | None = None,
) -> None:
    """Refuse a key that nothing reads: what it says would be lost without a word.

    Args:
        path: The file, for the error.
        where: Name of the mapping in the file; empty for the whole file.
        given: The mapping.
        read: Keys that are read.
        unused: Keys that other tools write there, and for which there is no use here.
        instead: What to write in place of other tools' keys that are not read.

    Raises:
        FileError: A key is none of those read and unused; it suggests the nearest.
    """
    read = list(read)
    for key in given:
        if key in read or key in unused:
            continue
        near = nearest(str(key), read)
        hint = f"did you mean '{near}'?" if near else f"expected one of {', '.join(read)}"
        if instead is not None and key in instead:
            hint = f"expected {instead[key]}"
        name = key if isinstance(key, str) and len(key) < 60 and key.isprintable() else brief(key)
        raise FileError(path, f"{f'{where}.' if where else ''}{name} is no key that is read; {hint}")


def number(path: Path, where: str, value: Any) -> float:
    """A finite number, or `FileError`."""
    read = np.nan
    if isinstance(value, str | int | float) and not isinstance(value, bool):  # YAML 1.1 reads '1e-05' as text
        with contextlib.suppress(ValueError, OverflowError):
            read = float(value)
    if not np.isfinite(read):
        raise FileError(path, f"{where} is {brief(value)}, expected a finite number")
    return read


def numbers(path: Path, where: str, value: Any, count: int | tuple[int, ...], *, meaning: str = "") -> Array:
    """A list of finite numbers of the given length(s), also as the `data` of OpenCV's or ROS's matrix.

    Args:
        path: The file, for the error.
        where: What the list is called in the file.
        value: What stands there.
        count: How many numbers it may have.
        meaning: What the numbers are, for the error.

    Raises:
        FileError: It is no list of so many finite numbers.
    """
    counts = (count,) if isinstance(count, int) else count
    value = value.get("data", value) if isinstance(value, dict) else value
    if not isinstance(value, list) or len(value) not in counts:
        wanted = f"{' or '.join(map(str, counts))} numbers{f' ({meaning})' if meaning else ''}"
        held = f"has {len(value)} numbers" if isinstance(value, list) and len(value) > 3 else f"is {brief(value)}"
        raise FileError(path, f"{where} {held}, expected {wanted}")
    return np.array([number(path, where, item) for item in value], dtype=float)


def read_xyz(path: Path, where: str, value: Any) -> Array:
    """A mapping x, y, z. (3,)."""
    if not isinstance(value, dict) or not {"x", "y", "z"} <= set(value):
        raise FileError(path, f"{where} is {brief(value)}, expected x, y, z")
    check_keys(path, where, value, "xyz", instead={"w": ROTATION})
    return np.array([number(path, f"{where}.{key}", value[key]) for key in "xyz"])


def read_pose(path: Path, where: str, value: Any) -> Array:
    """A mapping position, rotation (rotation vector [rad]), and what TagSLAM says of their noise. (4, 4)."""
    keys = ("position", "rotation", "position_noise", "rotation_noise", "R")
    if isinstance(value, dict):
        check_keys(path, where, value, keys, instead={"orientation": f"rotation: {ROTATION}"})
    if not isinstance(value, dict) or "position" not in value or "rotation" not in value:
        raise FileError(path, f"{where} needs position and rotation")
    position = read_xyz(path, f"{where}.position", value["position"])
    rotation = read_xyz(path, f"{where}.rotation", value["rotation"])
    angle = float(np.linalg.norm(rotation))
    if angle > 2 * np.pi * (1 + 1e-6):
        raise FileError(
            path, f"{where}.rotation is {angle:.4g} long, which is no angle in radians; expected {ROTATION}"
        )
    return transform_from_rotvec(position, rotation)


class _Loader(Composer, yaml.CSafeLoader):  # in this order: CSafeLoader has a composer of its own, in C
    def __init__(self, path: Path, text: bytes) -> None:
        yaml.CSafeLoader.__init__(self, text)
        Composer.__init__(self)
        self.path, self.values = path, 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        self.values, most = self.values + 1, budget.limits().yaml_values
        if self.values > most:
            raise FileError(self.path, f"claims more than {most:,} values and names, expected at most that")
        node: yaml.Node | None = super().compose_node(parent, index)
        return node

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        seen: set[str] = set()
        for key, _ in node.value:
            problem = ""
            if key.tag == "tag:yaml.org,2002:merge":
                problem = "merge keys (<<) are not read, as a small file could grow to gigabytes by them"
                problem += "; expected the merged values written out where they hold"
            elif isinstance(key, yaml.ScalarNode) and key.value in seen:
                problem = f"'{key.value}' stands here a second time, expected each key once"
            if problem:
                raise FileError(self.path, f"line {key.start_mark.line + 1}: {problem}")
            seen.add(key.value if isinstance(key, yaml.ScalarNode) else "")
        super().flatten_mapping(node)

    def matrix(self, node: yaml.Node) -> dict[Any, Any]:
        if not isinstance(node, yaml.MappingNode):
            raise yaml.constructor.ConstructorError(None, None, "expected a matrix", node.start_mark)
        matrix: dict[Any, Any] = self.construct_mapping(node, deep=True)
        return matrix

    def number(self, node: yaml.ScalarNode) -> int | float:
        if len(node.value) > LONGEST_NUMBER:
            raise yaml.constructor.ConstructorError(None, None, "a number is too long", node.start_mark)
        kind = self.construct_yaml_int if node.tag.endswith(":int") else self.construct_yaml_float
        value: int | float = kind(node)
        return value


for _kind in ("int", "float"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _Loader.number)
_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _Loader.matrix)
