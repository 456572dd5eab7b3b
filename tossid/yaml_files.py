"""YAML from outside: one mapping, or one clear error.

PyYAML's own loader (in C) dies of deep nesting, merge keys (`<<`) let a kilobyte unpack to gigabytes, and numbers of a
hundred thousand digits take their time: what no description of cameras or objects needs is refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from tossid.errors import FileError

LARGEST = 1 << 18
"""Bytes of a file; so many take PyYAML a second."""
LONGEST_NUMBER = 400
"""Characters."""


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML file that holds a mapping.

    Raises:
        FileError: it is missing, no such file, or holds what only a hostile one does.
    """
    try:
        large = path.stat().st_size > LARGEST
        text = "" if large else path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise FileError(path, "no such file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(path, f"cannot be read: {error}") from error
    if large:
        raise FileError(path, f"is larger than {LARGEST >> 10} KiB, expected a description in YAML")
    try:
        content = yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" (line {mark.line + 1})" if mark is not None else ""
        raise FileError(path, f"is not valid YAML{where}") from error
    except RecursionError as error:
        raise FileError(path, "is nested too deeply") from error
    except Exception as error:  # of dates and numbers that are none, PyYAML raises whatever it comes across
        raise FileError(path, f"is not valid YAML ({error})") from error
    if not isinstance(content, dict):
        raise FileError(path, "holds no mapping of names to values")
    return content


class _Loader(yaml.SafeLoader):
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
