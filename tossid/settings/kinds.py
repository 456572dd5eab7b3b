"""Kinds of values that settings hold, with their limits, and the one check of a value against its kind.

Keywords, the command line and files all go through `convert`, so that they take the same values and refuse others with
the same words.
"""

from __future__ import annotations

import os
import sys
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from tossid.errors import ConfigError, brief, nearest

S = TypeVar("S")
T = TypeVar("T")
LARGEST = sys.float_info.max
LONGEST_NAME = 255
"""Bytes of a file's or folder's name."""
ADVANCED = "advanced"
"""Mark, in a field's metadata, of what only Python changes: no key of the command line."""


def advanced(default: T) -> T:
    """A field that only Python changes; the command line neither shows nor stores it.

    Args:
        default: Its value.
    """
    return field(default=default, metadata={ADVANCED: True})


def advanced_part(settings: type[T]) -> T:
    """A field that holds settings of its own, which only Python changes.

    Args:
        settings: Their class; the field's default is all of its defaults.
    """
    return field(default_factory=settings, metadata={ADVANCED: True})


@dataclass(frozen=True, slots=True)
class Bounds:
    """Limits of a number, inclusive; `above`: exclusive lower limit."""

    low: float | None = None
    high: float | None = None
    above: float | None = None

    def contains(self, value: float) -> bool:
        """Whether a number is within the limits; NaN never is."""
        return (
            value == value
            and (self.low is None or value >= self.low)
            and (self.high is None or value <= self.high)
            and (self.above is None or value > self.above)
        )

    def __str__(self) -> str:
        """The limits in words, such as " above 0 and at most 5"."""
        if self.above is not None:
            text = f" above {self.above:g}"
            return text if self.high is None else f"{text} and at most {self.high:g}"
        if self.low is not None and self.high is not None:
            return f" from {self.low:.10g} to {self.high:.10g}"
        return f" of at least {self.low:g}" if self.low is not None else f" of at most {self.high:g}"


@dataclass(frozen=True, slots=True)
class Registered:
    """Marks a choice among settings that a registry knows.

    Attributes:
        classes: Gives their dataclasses; each has a field `name`, a `Literal` whose value chooses it.
    """

    classes: Callable[[], tuple[type, ...]]


@dataclass(frozen=True, slots=True)
class Except:
    """Marks text that may be anything but one word, which has a meaning of its own."""

    word: str


@dataclass(frozen=True, slots=True)
class Ordered:
    """Marks a pair of limits: the first is not above the second."""


class Checked:
    """Base of settings whose values are converted, and held against their limits, when they are made."""

    def __post_init__(self) -> None:
        """Convert each value to its field's type.

        Raises:
            ConfigError: A value is of another type, or beyond its limits.
        """
        settings: Any = type(self)
        for name, hint in type_hints(settings).items():
            object.__setattr__(self, name, convert(hint, getattr(self, name), key=name))


Positive = Annotated[float, Bounds(above=0)]
NonNegative = Annotated[float, Bounds(low=0)]
Count = Annotated[int, Bounds(low=1)]
Fraction = Annotated[float, Bounds(low=0, high=1)]
Range = Annotated[tuple[float, float], Ordered()]
Span = Annotated[tuple[NonNegative, NonNegative], Ordered()]
Seed = Annotated[int, Bounds(low=0, high=2**32 - 1)]

# ---------------------------------------------------------------- values from a keyword, the command line or a file


def convert(hint: Any, value: Any, *, key: str, advanced: bool = True, start: Any = None) -> Any:
    """A value as the type that a setting has.

    Args:
        hint: The type, with its limits (`Annotated`).
        value: Plain (numbers, text, booleans, lists, mappings), or of the type already.
        key: The setting's name, for errors.
        advanced: Whether the value may set fields that only Python changes (`advanced`).
        start: Of a part with settings of its own: where fields that the value lacks come from; None: their defaults.

    Raises:
        ConfigError: It is of another type, beyond its limits, or lacks a field without a default.
    """
    if hasattr(value, "tolist"):
        value = value.tolist()  # NumPy's numbers and arrays
    origin, args = get_origin(hint), get_args(hint)
    classes: list[Any] = [part for part in parts_of(hint) if is_dataclass(part)]
    if classes and (isinstance(value, tuple(classes)) or (value is None and type(None) in parts_of(hint))):
        return value
    if classes and (isinstance(value, Mapping) or {*parts_of(hint)} <= {*classes, type(None)}):
        return _convert_part(classes, value, key, advanced, start)
    if origin is Annotated:
        return _within(hint, convert(args[0], value, key=key, advanced=advanced), value, key)
    if hint is Any:
        return value
    if origin in (Union, types.UnionType):
        return _convert_union(hint, value, key)
    if origin is Literal:
        if value is None and "null" in args:
            return "null"  # YAML reads this word as nothing where it has no quotes
        if value in args and not (isinstance(value, bool) and True not in args):
            return value
    elif origin is tuple and isinstance(value, Sequence) and not isinstance(value, str):
        count = len(value) if args[1:] == (...,) else len(args)
        if len(value) != count:
            raise ConfigError(key, f"has {len(value)} values; expected {describe(hint)}.")
        each = args[:1] * count if args[1:] == (...,) else args
        return tuple(convert(of, item, key=f"{key}[{i}]") for i, (of, item) in enumerate(zip(each, value, strict=True)))
    elif origin in (dict, Mapping) and isinstance(value, Mapping):
        return {str(name): convert(args[1], item, key=f"{key}.{name}") for name, item in value.items()}
    elif (scalar := _scalar(hint, value)) is not None:
        return scalar
    near = nearest(brief(value).strip("'"), map(str, args)) if origin is Literal else None
    raise ConfigError(key, f"{brief(value)} will not do; expected {describe(hint)}.", suggestion=near)


def from_plain(start: S, values: Mapping[str, Any]) -> S:
    """Settings with plain values in place of their own.

    Args:
        start: Settings that have every field; what the values lack stays as it is.
        values: What `to_plain` gave, of this or of an earlier version. Fields that are gone are left out: their values
            became constants.

    Raises:
        ConfigError: A value will not do.
    """
    part: S = _convert_part([type(start)], _with_known_fields([type(start)], values), "", True, start)
    return part


def to_plain(value: Any, *, advanced: bool = True) -> Any:
    """Settings as nested dicts of numbers, text, booleans and lists: what YAML, JSON and `torch.save` can hold.

    Args:
        value: A settings dataclass, or a value of a field.
        advanced: With the fields that only Python changes.
    """
    if is_dataclass(value):
        return {name: to_plain(getattr(value, name), advanced=advanced) for name in _fields_of(value, advanced)}
    if isinstance(value, Mapping):
        return {str(name): to_plain(item, advanced=advanced) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_plain(item, advanced=advanced) for item in value]
    if isinstance(value, Enum):
        return to_plain(value.value)
    return str(value) if isinstance(value, Path) else value


def describe(hint: Any) -> str:
    """A type in words: "a whole number of at least 1"."""
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        if any(isinstance(extra, Ordered) for extra in args[1:]):
            return f"two limits [low,high], each {describe(get_args(args[0])[0])}"
        return describe(args[0]) + "".join(str(extra) for extra in args[1:] if isinstance(extra, Bounds))
    if origin in (Union, types.UnionType):
        words = " or ".join(describe(part) for part in args if part is not type(None))
        return f"{words} or null" if type(None) in args else words
    if origin is Literal:
        return "one of " + ", ".join(map(str, args))
    if origin is tuple:
        return f"a list {'[a,b,…]' if args[1:] == (...,) else f'of {len(args)} values'}, each {describe(args[0])}"
    if origin in (dict, Mapping):
        return f"{{name: value}}, each {describe(args[1])}"
    names = {bool: "true or false", int: "a whole number", float: "a number", str: "text", Path: "a path"}
    return names.get(hint, getattr(hint, "__name__", str(hint)))


def parts_of(hint: Any) -> tuple[Any, ...]:
    """The types of a union or of a registry (or the type itself), without their annotations."""
    args = get_args(hint)
    if get_origin(hint) is Annotated:
        registered = [extra.classes() for extra in args[1:] if isinstance(extra, Registered)]
        return registered[0] if registered else parts_of(args[0])
    if get_origin(hint) in (Union, types.UnionType):
        return tuple(part for arg in args for part in parts_of(arg))
    return (hint,)


def class_of(classes: Sequence[Any], member: Any) -> Any:
    """The dataclass of a group's member: the one whose `name` is that, else the only one of any name."""
    of_any_name = []
    for cls in classes:
        hint = type_hints(cls).get("name")
        if get_origin(hint) is Literal:
            if member in get_args(hint):
                return cls
        elif not any(isinstance(extra, Except) and extra.word == member for extra in get_args(hint)[1:]):
            of_any_name.append(cls)
    return of_any_name[0] if len(of_any_name) == 1 else None


@cache
def type_hints(settings: Any) -> dict[str, Any]:
    """The types of a dataclass's fields, with their limits."""
    found = get_type_hints(settings, localns=vars(sys.modules[settings.__module__]), include_extras=True)
    return {own.name: found[own.name] for own in fields(settings)}


def _fields_of(settings: Any, advanced: bool) -> list[str]:
    return [own.name for own in fields(settings) if advanced or not own.metadata.get(ADVANCED)]


def _with_known_fields(classes: Sequence[Any], values: Any) -> Any:
    """The values of fields that one of some settings dataclasses has, and its parts have."""
    if not classes or not isinstance(values, Mapping):
        return values
    hints = type_hints(class_of(classes, values.get("name")) or classes[0])
    parts = {name: [part for part in parts_of(hint) if is_dataclass(part)] for name, hint in hints.items()}
    return {name: _with_known_fields(parts[name], value) for name, value in values.items() if name in hints}


def _convert_part(classes: Sequence[Any], value: Any, key: str, advanced: bool, start: Any) -> Any:
    """A mapping as one of some settings dataclasses, which its `name` chooses where there are several."""
    if not isinstance(value, Mapping):
        raise ConfigError(key or classes[0].__name__, f"{brief(value)} is no part with keys of its own.")
    cls = class_of(classes, value.get("name")) or classes[0]
    start = start if isinstance(start, cls) else None
    names, hints, prefix = _fields_of(cls, advanced), type_hints(cls), f"{key}." if key else ""
    for name in value:
        if name not in names:
            raise ConfigError(f"{prefix}{name}", "there is no such key.", suggestion=nearest(str(name), names))
    given = {}
    for own in fields(cls):
        name, hint = own.name, hints[own.name]
        if name in value:
            before = getattr(start, name, None)
            given[name] = convert(hint, value[name], key=f"{prefix}{name}", advanced=advanced, start=before)
        elif start is not None or own.default is not MISSING or own.default_factory is not MISSING:
            continue
        elif type(None) in parts_of(hint):
            given[name] = None
        else:
            raise ConfigError(f"{prefix}{name}", f"is needed; expected {describe(hint)}.")
    return cls(**given) if start is None else replace(start, **given)


def _within(hint: Any, value: Any, written: Any, key: str) -> Any:
    """The value, within the limits that its type has."""
    for limit in get_args(hint)[1:]:
        if isinstance(limit, Bounds) and not limit.contains(value):
            raise ConfigError(key, f"{written} is out of range; expected {describe(hint)}.")
        if isinstance(limit, Except) and value == limit.word:
            raise ConfigError(key, f"'{limit.word}' has a meaning of its own; expected another name.")
        if isinstance(limit, Ordered) and value[0] > value[1]:
            raise ConfigError(key, f"{written} has its limits in the wrong order; expected {describe(hint)}.")
    return value


def _convert_union(hint: Any, value: Any, key: str) -> Any:
    """The value as the first type of a union that takes it."""
    if value is None and type(None) in parts_of(hint):
        return None
    errors, parts = [], [part for part in get_args(hint) if part is not type(None)]
    for part in parts:
        try:
            return convert(part, value, key=key)
        except ConfigError as error:
            errors.append(error)
    if len(errors) == 1 and get_origin(parts[0]) is Annotated:
        raise errors[0]
    raise ConfigError(key, f"{brief(value)} will not do; expected {describe(hint)}.")


def _scalar(hint: Any, value: Any) -> Any:
    """The value as bool, int, float, str or Path, or as it is where it is of the type; None where it is neither."""
    if hint is bool or isinstance(value, bool):
        return value if hint is bool and isinstance(value, bool) else None
    if hint is float:
        return float(value) if isinstance(value, int | float) and abs(value) <= LARGEST else None
    if hint is str and isinstance(value, int | float):
        return str(value) if isinstance(value, float) or abs(value) < LARGEST else None
    if hint is Path and isinstance(value, str | Path):
        return _path(str(value))
    return value if isinstance(hint, type) and isinstance(value, hint) else None


def _path(text: str) -> Path | None:
    """A path that the system can be asked about; None for names that none can have."""
    try:
        path = Path(text).expanduser()
        short = all(len(os.fsencode(part)) <= LONGEST_NAME for part in path.parts)
    except (RuntimeError, UnicodeEncodeError):  # the home of nobody, half a letter
        return None
    return path if text and "\0" not in text and short else None
