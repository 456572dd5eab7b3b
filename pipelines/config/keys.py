"""Schemas read as keys: their names, types, units and texts; and plain values turned into them."""

from __future__ import annotations

import ast
import difflib
import inspect
import os
import sys
import types
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import Field, dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from pipelines.config.places import CONF, folders
from pipelines.config.schemas import Bounds, Ordered
from tossid.errors import ConfigError, brief
from tossid.settings.kinds import ADVANCED, Except, Registered

LONGEST_NAME = 255
"""Bytes of a file's or folder's name."""
MISSING = "???"
"""Hydra's mark of a value that the caller has to give."""


@dataclass(frozen=True, slots=True)
class Key:
    """One settable key. `fixed`: the `name` of a group's member, set by choosing it."""

    name: str
    type: Any
    doc: str
    fixed: bool = False

    @property
    def is_text(self) -> bool:
        """Its values are text or paths, taken as typed."""
        return {part for part in parts_of(self.type) if part is not type(None)} <= {str, Path}

    @property
    def is_table(self) -> bool:
        """Its values are names with values, replaced as a whole."""
        return any(get_origin(part) is dict for part in parts_of(self.type))

    @property
    def expected(self) -> str:
        """Its type in words."""
        return describe(self.type)


@dataclass(frozen=True, slots=True)
class Group:
    """A key that chooses one of the files in `conf/NAME/`.

    Attributes:
        name: the key.
        doc: what it says of itself.
        optional: none may be chosen.
        classes: the dataclasses of which a member is one.
    """

    name: str
    doc: str
    optional: bool
    classes: tuple[Any, ...]

    def members(self, conf: Path = CONF) -> tuple[str, ...]:
        """The members that this command takes: those of which a class is found."""
        return tuple(name for name in group_members(self.name, conf) if class_of(self.classes, name) is not None)


def key_fields(schema: Any) -> list[Field[Any]]:
    """The fields of a config dataclass that are keys: those that only Python changes are none."""
    return [field for field in fields(schema) if not field.metadata.get(ADVANCED)]


def nearest(word: str, candidates: Iterable[str]) -> str | None:
    """The nearest valid spelling, or a key whose last part is the word."""
    candidates = list(candidates)
    head, _, tail = word.rpartition(".")
    beside = {name.rpartition(".")[2]: name for name in candidates if head and name.rpartition(".")[0] == head}
    tails = {name.rpartition(".")[2]: name for name in reversed(candidates)}
    for cutoff in (0.8, 0.6):
        for spoken, names in ((tail, beside), (word, {name: name for name in candidates}), (tail, tails)):
            near = difflib.get_close_matches(spoken, names, n=1, cutoff=cutoff)
            if near and (names is beside or not beside or cutoff > 0.7):
                return names[near[0]]
    return None


def shorten(text: str, limit: int = 60) -> str:
    """Text for an error line: printable, and not longer than a line."""
    text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= limit else text[: limit - 1] + "…"


def group_members(group: str, conf: Path = CONF) -> tuple[str, ...]:
    """The members of a group: the YAML files in its folder, and in the user's own."""
    return tuple(sorted({path.stem for folder in folders(conf) for path in (folder / group).glob("*.yaml")}))


def keys_of(
    schema: type, chosen: Mapping[str, str | None], *, prefix: str = "", conf: Path = CONF
) -> list[Key | Group]:
    """All keys of a schema, in its order.

    Args:
        schema: A config dataclass.
        chosen: The chosen member of each group; keys of other members are left out.
        prefix: Put before each name.
        conf: The folder of values.

    Returns:
        Keys and groups. A group is followed by the keys of its chosen member.
    """
    found: list[Key | Group] = []
    docs, hints = field_docs(schema), get_type_hints(schema, include_extras=True)
    for field in key_fields(schema):
        name, hint = prefix + field.name, hints[field.name]
        classes = [part for part in parts_of(hint) if isinstance(part, type) and is_dataclass(part)]
        if not classes:
            found.append(Key(name, hint, docs[field.name], fixed=field.name == "name" and get_origin(hint) is Literal))
            continue
        if not (conf / field.name).is_dir():
            found += keys_of(classes[0], chosen, prefix=name + ".", conf=conf)
            continue
        found.append(Group(name, docs[field.name], type(None) in parts_of(hint), tuple(classes)))
        member = chosen.get(name)
        if member is not None:
            own = class_of(classes, member)
            if own is not None:
                found += keys_of(own, chosen, prefix=name + ".", conf=conf)
    return found


def all_keys(schema: type, *, conf: Path = CONF) -> list[str]:
    """The names of all keys of a schema, with those of every member of every group."""
    names = [key.name for key in keys_of(schema, {}, conf=conf)]
    for group in [key for key in keys_of(schema, {}, conf=conf) if isinstance(key, Group)]:
        for member in group.members(conf):
            names += [key.name for key in keys_of(schema, {group.name: member}, conf=conf)]
    return list(dict.fromkeys(names))


@cache
def field_docs(schema: type) -> dict[str, str]:
    """The text under each field of a dataclass (its own and inherited)."""
    docs: dict[str, str] = {}
    for cls in reversed(schema.__mro__):
        if not is_dataclass(cls):
            continue
        body = ast.parse(inspect.cleandoc(inspect.getsource(cls))).body[0]
        assert isinstance(body, ast.ClassDef)
        for statement, text in zip(body.body, body.body[1:], strict=False):
            if (
                isinstance(statement, ast.AnnAssign)
                and isinstance(statement.target, ast.Name)
                and isinstance(text, ast.Expr)
                and isinstance(text.value, ast.Constant)
                and isinstance(text.value.value, str)
            ):
                docs[statement.target.id] = " ".join(text.value.value.split())
    return {field.name: docs.get(field.name, "") for field in fields(schema)}


def describe(hint: Any) -> str:
    """A type in words: "a whole number of at least 1"."""
    origin = get_origin(hint)
    if origin is Annotated:
        base, *extras = get_args(hint)
        if any(isinstance(extra, Ordered) for extra in extras):
            return f"two limits [low,high], each {describe(get_args(base)[0])}"
        limits = [str(extra) for extra in extras if isinstance(extra, Bounds)]
        return describe(base) + "".join(limits)
    if origin in (Union, types.UnionType):
        parts = [part for part in get_args(hint) if part is not type(None)]
        words = " or ".join(describe(part) for part in parts)
        return f"{words} or null" if type(None) in get_args(hint) else words
    if origin is Literal:
        return "one of " + ", ".join(str(value) for value in get_args(hint))
    if origin is tuple:
        args = get_args(hint)
        if len(args) == 2 and args[1] is Ellipsis:
            return f"a list [a,b,…], each {describe(args[0])}"
        return f"a list of {len(args)} values, each {describe(args[0])}"
    if origin is dict:
        return f"{{name: value}}, each {describe(get_args(hint)[1])}"
    names = {bool: "true or false", int: "a whole number", float: "a number", str: "text", Path: "a path"}
    return names.get(hint, getattr(hint, "__name__", str(hint)))


def convert(hint: Any, value: Any, *, key: str) -> Any:
    """A plain value as the type that the schema wants.

    Raises:
        ConfigError: it is of another type, out of bounds or missing.
    """
    if isinstance(value, str) and value == MISSING:
        raise ConfigError(key, f"is needed; expected {describe(hint)}.")
    origin = get_origin(hint)
    if origin is Annotated:
        base, *extras = get_args(hint)
        if any(isinstance(extra, Registered) for extra in extras):
            return _convert_union(Union[parts_of(hint)], value, key)  # noqa: UP007 (a tuple of classes)
        converted = convert(base, value, key=key)
        for extra in extras:
            if isinstance(extra, Bounds) and not extra.contains(converted):
                raise ConfigError(key, f"{value} is out of range; expected {describe(hint)}.")
            if isinstance(extra, Except) and converted == extra.word:
                raise ConfigError(key, f"'{extra.word}' has a meaning of its own; expected another name.")
            if isinstance(extra, Ordered) and converted[0] > converted[1]:
                raise ConfigError(key, f"{value} has its limits in the wrong order; expected {describe(hint)}.")
        return converted
    if origin in (Union, types.UnionType):
        return _convert_union(hint, value, key)
    if is_dataclass(hint) and isinstance(hint, type):
        return _convert_dataclass(hint, value, key)
    if origin is Literal:
        if value is None and "null" in get_args(hint):
            return "null"  # YAML reads this word as nothing where it has no quotes
        if value in get_args(hint) and not (isinstance(value, bool) and True not in get_args(hint)):
            return value
    elif origin is tuple and isinstance(value, (list, tuple)):
        return _convert_tuple(hint, value, key)
    elif origin is dict and isinstance(value, dict):
        return {str(name): convert(get_args(hint)[1], item, key=f"{key}.{name}") for name, item in value.items()}
    elif hint is Any:
        return value
    else:
        scalar = _scalar(hint, value)
        if scalar is not None:
            return scalar
    near = nearest(brief(value).strip("'"), [str(choice) for choice in get_args(hint)]) if origin is Literal else None
    raise ConfigError(key, f"{shorten(brief(value))} will not do; expected {describe(hint)}.", suggestion=near)


def _scalar(hint: Any, value: Any) -> Any:
    """The value as bool, int, float, str or Path; None where it is none."""
    if hint is bool:
        return value if isinstance(value, bool) else None
    if isinstance(value, bool):
        return None
    if hint is int:
        return value if isinstance(value, int) else None
    if hint is float:
        return float(value) if isinstance(value, (int, float)) and abs(value) <= sys.float_info.max else None
    if hint is str:
        return str(value) if isinstance(value, (str, float)) or _is_short(value) else None
    if hint is Path:
        return _path(value) if isinstance(value, str) and value and "\0" not in value else None
    return None


def _path(text: str) -> Path | None:
    """A path that the system can be asked about; None for names that none can have."""
    try:
        path = Path(text).expanduser()
        return path if all(len(os.fsencode(part)) <= LONGEST_NAME for part in path.parts) else None
    except (RuntimeError, UnicodeEncodeError):  # the home of nobody, half a letter
        return None


def _is_short(value: Any) -> bool:
    """Whether it is a whole number that can be printed."""
    return isinstance(value, int) and abs(value) < 10**400


def _convert_union(hint: Any, value: Any, key: str) -> Any:
    parts = get_args(hint)
    if value is None and type(None) in parts:
        return None
    rest = [part for part in parts if part is not type(None)]
    classes = [part for part in rest if is_dataclass(part)]
    if classes and isinstance(value, dict):
        own = class_of(classes, value.get("name")) or classes[0]
        return convert(own, value, key=key)
    errors = []
    for part in rest:
        try:
            return convert(part, value, key=key)
        except ConfigError as error:
            errors.append(error)
    if len(errors) == 1 and get_origin(rest[0]) is Annotated:
        raise errors[0]
    raise ConfigError(key, f"{shorten(brief(value))} will not do; expected {describe(hint)}.")


def _convert_dataclass(schema: type, value: Any, key: str) -> Any:
    if not isinstance(value, dict):
        raise ConfigError(key or schema.__name__, f"{shorten(brief(value))} is no part with keys of its own.")
    hints = get_type_hints(schema, include_extras=True)
    dot = f"{key}." if key else ""
    names = [field.name for field in key_fields(schema)]
    for name in value:
        if name not in names:
            raise ConfigError(f"{dot}{name}", "there is no such key.", suggestion=nearest(str(name), names))
    converted = {}
    for name in names:
        if name in value:
            converted[name] = convert(hints[name], value[name], key=f"{dot}{name}")
        elif type(None) in parts_of(hints[name]):
            converted[name] = None
        else:
            raise ConfigError(f"{dot}{name}", f"is needed; expected {describe(hints[name])}.")
    return schema(**converted)


def _convert_tuple(hint: Any, value: Sequence[Any], key: str) -> tuple[Any, ...]:
    args = get_args(hint)
    if len(args) == 2 and args[1] is Ellipsis:
        return tuple(convert(args[0], item, key=f"{key}[{i}]") for i, item in enumerate(value))
    if len(value) != len(args):
        raise ConfigError(key, f"has {len(value)} values; expected {describe(hint)}.")
    return tuple(convert(arg, item, key=f"{key}[{i}]") for i, (arg, item) in enumerate(zip(args, value, strict=True)))


def parts_of(hint: Any) -> tuple[Any, ...]:
    """The types of a union or of a registry (or the type itself), without their annotations."""
    if get_origin(hint) is Annotated:
        base, *extras = get_args(hint)
        registered = [extra.classes() for extra in extras if isinstance(extra, Registered)]
        return registered[0] if registered else parts_of(base)
    if get_origin(hint) in (Union, types.UnionType):
        return tuple(part for arg in get_args(hint) for part in parts_of(arg))
    return (hint,)


def class_of(classes: Sequence[Any], member: Any) -> Any:
    """The dataclass of a group's member: the one whose `name` is that, else the only one of any name."""
    anyone = []
    for cls in classes:
        hint = get_type_hints(cls, localns=vars(sys.modules[cls.__module__])).get("name")
        if get_origin(hint) is not Literal:
            anyone += [] if member in _excluded(cls) else [cls]
        elif member in get_args(hint):
            return cls
    return anyone[0] if len(anyone) == 1 else None


def _excluded(cls: Any) -> set[str]:
    """The names that a dataclass of objects with any name may not have."""
    hint = get_type_hints(cls, localns=vars(sys.modules[cls.__module__]), include_extras=True).get("name")
    extras = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
    return {extra.word for extra in extras if isinstance(extra, Except)}
