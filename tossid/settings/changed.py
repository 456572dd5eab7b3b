"""Settings with some of their fields changed by name, as keyword arguments of the library's verbs give them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

from tossid.errors import ConfigError, nearest
from tossid.settings.kinds import convert, type_hints

S = TypeVar("S")


def changed(settings: S, keys: Mapping[str, Any]) -> S:
    """The settings with new values.

    Args:
        settings: A frozen dataclass; its fields may be settings themselves.
        keys: New values by name. `gravity` changes the field of that name, at the top or, where there is none, in the
            one part that has it; `model__gravity` and `{"model.gravity": 0.0}` say which part.

    Returns:
        A copy; the argument stays as it is.

    Raises:
        ConfigError: No field has the name, more than one part has it, or the value is none of the field's.
    """
    for key, value in keys.items():
        settings = _replaced(settings, _path(settings, key), value, key)
    return settings


def _path(settings: Any, key: str) -> tuple[str, ...]:
    """The way to the field that a key names."""
    asked = tuple(key.replace("__", ".").split("."))
    every = list(_paths(settings))
    if asked in every:
        return asked
    found = [path for path in every if path[-len(asked) :] == asked]
    if len(found) == 1:
        return found[0]
    if found:
        raise ConfigError(key, f"is not one setting but {len(found)}: {', '.join('.'.join(path) for path in found)}.")
    near = nearest(asked[-1], [path[-1] for path in every])
    raise ConfigError(key, f"is no setting of {type(settings).__name__}.", suggestion=near)


def _paths(settings: Any) -> Iterator[tuple[str, ...]]:
    for field in fields(settings):
        yield (field.name,)
        value = getattr(settings, field.name)
        if is_dataclass(value) and not isinstance(value, type):
            for rest in _paths(value):
                yield (field.name, *rest)


def _replaced(settings: Any, path: tuple[str, ...], value: Any, key: str) -> Any:
    name, *rest = path
    own = getattr(settings, name)
    if rest:
        return replace(settings, **{name: _replaced(own, tuple(rest), value, key)})
    return replace(settings, **{name: convert(type_hints(settings.__class__)[name], value, key=key, start=own)})
