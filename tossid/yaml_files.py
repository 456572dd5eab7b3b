"""YAML from outside: one mapping, or one clear error.

libyaml parses the text, as PyYAML's parser in Python takes five times as long. PyYAML's composer in Python builds the
values, as its composer in C crashes where nesting is deep. Merge keys (`<<`) let a kilobyte unpack to gigabytes, and
numbers of a hundred thousand digits take long. No description of cameras or objects needs them, so they are refused.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from yaml.composer import Composer

from tossid import budget
from tossid.errors import FileError, brief
from tossid.rotations import transform_from_rotvec

Array = NDArray[np.float64]

LARGEST = 1 << 18
"""Bytes of a file."""
LONGEST_NUMBER = 400
"""Characters."""


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML file that holds a mapping.

    Raises:
        FileError: it is missing, no such file, or holds what only a hostile one does.
    """
    if budget.regular_size(path) > LARGEST:
        raise FileError(path, f"is larger than {LARGEST >> 10} KiB, expected a description in YAML")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(path, f"cannot be read: {error}") from error
    try:
        content = yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" (line {mark.line + 1})" if mark is not None else ""
        raise FileError(path, f"is not valid YAML{where}") from error
    except _TooManyValues as error:
        many = budget.limits().yaml_values
        raise FileError(path, f"claims more than {many:,} values and names, expected at most that") from error
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


def number(path: Path, where: str, value: Any) -> float:
    """A finite number, or `FileError`."""
    read = np.nan
    if isinstance(value, str | int | float) and not isinstance(value, bool):  # YAML 1.1 reads '1e-05' as text
        with contextlib.suppress(ValueError, OverflowError):
            read = float(value)
    if not np.isfinite(read):
        raise FileError(path, f"{where} is {brief(value)}, expected a finite number")
    return read


def numbers(path: Path, where: str, value: Any, count: int | tuple[int, ...]) -> Array:
    """A list of finite numbers of the given length(s), or `FileError`."""
    counts = (count,) if isinstance(count, int) else count
    if not isinstance(value, list) or len(value) not in counts:
        raise FileError(path, f"{where} is {brief(value)}, expected {' or '.join(map(str, counts))} numbers")
    return np.array([number(path, where, item) for item in value], dtype=float)


def read_xyz(path: Path, where: str, value: Any) -> Array:
    """A mapping x, y, z. (3,)."""
    if not isinstance(value, dict) or not {"x", "y", "z"} <= set(value):
        raise FileError(path, f"{where} is {brief(value)}, expected x, y, z")
    return np.array([number(path, f"{where}.{key}", value[key]) for key in "xyz"])


def read_pose(path: Path, where: str, value: Any) -> Array:
    """A mapping position, rotation (rotation vector [rad]). (4, 4)."""
    if not isinstance(value, dict) or "position" not in value or "rotation" not in value:
        raise FileError(path, f"{where} needs position and rotation")
    position = read_xyz(path, f"{where}.position", value["position"])
    return transform_from_rotvec(position, read_xyz(path, f"{where}.rotation", value["rotation"]))


class _TooManyValues(Exception):
    """More than `ReadLimits.yaml_values`."""


class _Loader(Composer, yaml.CSafeLoader):  # in this order: CSafeLoader has a composer of its own, in C
    def __init__(self, text: str) -> None:
        yaml.CSafeLoader.__init__(self, text)
        Composer.__init__(self)
        self.left = budget.limits().yaml_values

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        self.left -= 1
        if self.left < 0:
            raise _TooManyValues
        node: yaml.Node | None = super().compose_node(parent, index)
        return node

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        for key, _ in node.value:
            if key.tag == "tag:yaml.org,2002:merge":
                raise yaml.constructor.ConstructorError(None, None, "merge keys are not read", key.start_mark)
        super().flatten_mapping(node)

    def number(self, node: yaml.ScalarNode) -> int | float:
        if len(node.value) > LONGEST_NUMBER:
            raise yaml.constructor.ConstructorError(None, None, "a number is too long", node.start_mark)
        kind = self.construct_yaml_int if node.tag.endswith(":int") else self.construct_yaml_float
        value: int | float = kind(node)
        return value


for _kind in ("int", "float"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _Loader.number)
