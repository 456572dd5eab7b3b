"""Settings as plain values, for files, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar, get_args, get_type_hints

S = TypeVar("S")


def to_plain(value: Any) -> Any:
    """Settings as nested dicts of numbers, text, booleans and lists.

    Args:
        value: A settings dataclass, or a value of a field.

    Returns:
        What JSON, YAML and `torch.save` without code can hold.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, (list, tuple)):
        return [to_plain(item) for item in value]
    return value


def from_plain(start: S, values: Mapping[str, Any]) -> S:
    """Settings with plain values in place of their own.

    Args:
        start: Settings that have every field; what the values lack stays as it is.
        values: What `to_plain` gave, of this or of an earlier version.

    Raises:
        TypeError: A value is of no field.
    """
    kept = {field.name: getattr(start, field.name) for field in fields(start)}  # type: ignore[arg-type]
    for name, value in values.items():
        own = kept.get(name)
        part = _optional_part(type(start), name) if own is None and isinstance(value, Mapping) else None
        if part is not None:
            kept[name] = from_plain(part(), value)
        elif is_dataclass(own) and not isinstance(own, type):
            kept[name] = from_plain(own, value)
        else:
            kept[name] = tuple(value) if isinstance(value, list) else value
    return type(start)(**kept)


def _optional_part(settings: type, name: str) -> Any:
    """The settings class of a field that may be None; None of other fields."""
    hint = get_type_hints(settings).get(name)
    return next((part for part in get_args(hint) if is_dataclass(part)), None)
