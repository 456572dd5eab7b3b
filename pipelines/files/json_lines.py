"""Files of JSON lines, which experiments add to and go on with."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def read_lines(path: str | Path) -> list[dict[str, Any]]:
    """All lines of a file.

    Args:
        path: The file.
    """
    return [json.loads(line) for line in Path(path).read_text().splitlines()]


def lines_so_far(path: Path) -> list[dict[str, Any]]:
    """All lines of a file; none if it is not there yet.

    Args:
        path: The file.
    """
    return read_lines(path) if path.exists() else []


def add_line(path: Path, line: Mapping[str, Any]) -> None:
    """Add a line to a file, which is made if it is not there yet.

    Args:
        path: The file.
        line: The line.
    """
    with path.open("a") as file:
        file.write(json.dumps(line) + "\n")
