"""Schemas read as keys: their names, types, units and texts."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterable, Mapping
from dataclasses import MISSING as NO_DEFAULT
from dataclasses import Field, dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_origin, get_type_hints

from pipelines.config.places import folders
from tossid import errors
from tossid.settings.kinds import ADVANCED, class_of, describe, parts_of

MISSING = "???"
"""Hydra's mark of a value that the caller has to give."""


@dataclass(frozen=True, slots=True)
class Key:
    """One settable key.

    Attributes:
        name: the key.
        type: of its values.
        doc: what it says of itself.
        default: its value where neither `conf/` nor the caller says one; `MISSING` where one of them has to.
        fixed: whether it is the `name` of a group's member, set by choosing it.
    """

    name: str
    type: Any
    doc: str
    default: Any = MISSING
    fixed: bool = False

    @property
    def is_text(self) -> bool:
        """Its values are text or paths, taken as typed."""
        return {part for part in parts_of(self.type) if part is not type(None)} <= {str, Path}

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

    def members(self) -> tuple[str, ...]:
        """The YAML files in its folder, and in the user's own, of which a class is found."""
        names = {path.stem for folder in folders() for path in (folder / self.name).glob("*.yaml")}
        return tuple(name for name in sorted(names) if class_of(self.classes, name) is not None)


def key_fields(schema: Any) -> list[Field[Any]]:
    """The fields of a config dataclass that are keys: those that only Python changes are none."""
    return [field for field in fields(schema) if not field.metadata.get(ADVANCED)]


def nearest(word: str, candidates: Iterable[str]) -> str | None:
    """The nearest valid spelling: of a key beside it, of a whole key, or of a key's last part."""
    head, _, tail = word.rpartition(".")
    names = list(candidates)
    beside = {name.rpartition(".")[2]: name for name in names if head and name.rpartition(".")[0] == head}
    tails = {name.rpartition(".")[2]: name for name in reversed(names)}
    for spoken, known in ((tail, beside), (word, {name: name for name in names}), (tail, tails)):
        near = errors.nearest(spoken, known)
        if near is not None:
            return known[near]
    return None


def shorten(text: str, limit: int = 60) -> str:
    """Text for an error line: printable, and not longer than a line."""
    text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= limit else text[: limit - 1] + "…"


def keys_of(
    schema: type, chosen: Mapping[str, str | None], *, prefix: str = "", start: Any = None
) -> list[Key | Group]:
    """All keys of a schema, in its order.

    Args:
        schema: A config dataclass.
        chosen: The chosen member of each group; keys of other members are left out.
        prefix: Put before each name.
        start: Settings that hold the defaults; None: those of the schema.

    Returns:
        Keys and groups. A group is followed by the keys of its chosen member.
    """
    found: list[Key | Group] = []
    docs, hints = field_docs(schema), get_type_hints(schema, include_extras=True)
    for field in key_fields(schema):
        name, hint = prefix + field.name, hints[field.name]
        classes = [part for part in parts_of(hint) if isinstance(part, type) and is_dataclass(part)]
        default = _default_of(field, hint, start)
        if not classes:
            fixed = field.name == "name" and get_origin(hint) is Literal
            found.append(Key(name, hint, docs[field.name], default, fixed))
            continue
        if not (folders()[0] / field.name).is_dir():
            inner = default if isinstance(default, classes[0]) else None
            found += keys_of(classes[0], chosen, prefix=name + ".", start=inner)
            continue
        found.append(Group(name, docs[field.name], type(None) in parts_of(hint), tuple(classes)))
        member = chosen.get(name)
        if member is not None:
            own = class_of(classes, member)
            if own is not None:
                found += keys_of(own, chosen, prefix=name + ".")
    return found


def _default_of(field: Field[Any], hint: Any, start: Any) -> Any:
    """The value of a field that nothing sets; `MISSING` where there is none."""
    if start is not None:
        return getattr(start, field.name)
    if field.default is not NO_DEFAULT:
        return field.default
    if field.default_factory is not NO_DEFAULT:
        return field.default_factory()
    return None if type(None) in parts_of(hint) else MISSING


def all_keys(schema: type) -> list[str]:
    """The names of all keys of a schema, with those of every member of every group."""
    names = [key.name for key in keys_of(schema, {})]
    for group in [key for key in keys_of(schema, {}) if isinstance(key, Group)]:
        for member in group.members():
            names += [key.name for key in keys_of(schema, {group.name: member})]
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
