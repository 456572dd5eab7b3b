"""Results as plain JSON."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any


def jsonable(value: Any) -> Any:
    """A value as JSON can hold it: paths as text, arrays as lists, NaN and infinity as null.

    Args:
        value: Numbers, text, paths, arrays, tensors, dataclasses, and mappings and sequences of these.

    Raises:
        TypeError: Something in it has no JSON form.
    """
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return {str(name): jsonable(item) for name, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [jsonable(item) for item in value]
    if is_dataclass(value) and not isinstance(value, type):
        return jsonable(asdict(value))
    if hasattr(value, "tolist"):  # NumPy and torch
        return jsonable(value.tolist())
    raise TypeError(f"{type(value).__name__} has no JSON form")


def digest_of(value: Any) -> str:
    """SHA-256 of a value as plain JSON: the same settings, data and code are known again by it.

    Args:
        value: As of `jsonable`.
    """
    return hashlib.sha256(json.dumps(jsonable(value), sort_keys=True).encode()).hexdigest()
