"""How the parts of a diagnosis's result are written in gap.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any


class Part:
    """A part of a result. In gap.json it is its fields by their names, where it does not say otherwise."""

    def as_json(self) -> dict[str, Any]:
        """As gap.json has it."""
        return {each.name: plain(getattr(self, each.name)) for each in fields(self)}  # type: ignore[arg-type]


def plain(value: Any) -> Any:
    """Parts of a result, alone or in sequences and mappings, as gap.json has them; other values as they are.

    Args:
        value: The value.
    """
    if isinstance(value, Mapping):
        return {name: plain(each) for name, each in value.items()}
    if isinstance(value, (tuple, list)):
        return [plain(each) for each in value]
    return value.as_json() if hasattr(value, "as_json") else value
