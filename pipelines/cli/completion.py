"""What a shell offers after Tab: a command's keys, and the values of those that have a few."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import is_dataclass
from typing import Any, Literal, get_args, get_origin

from pipelines.config.keys import Group, Key, keys_of
from pipelines.config.schemas import COMMANDS
from tossid.settings.kinds import describe, parts_of


def complete_keys(ctx: Any, incomplete: str) -> Iterator[tuple[str, str]]:
    """Words that begin like `incomplete`, each with its meaning."""
    command = str(ctx.info_name)
    if command not in COMMANDS:
        return
    apart = _value_apart(incomplete)
    if apart is not None:  # bash takes KEY, = and VALUE for three words
        key, begun = apart
        yield from ((value, "") for value in _values(_found(command, ctx).get(key)) if value.startswith(begun))
        return
    keys = _found(command, ctx)
    name, equals, begun = incomplete.partition("=")
    if equals:
        yield from ((f"{name}={value}", "") for value in _values(keys.get(name)) if value.startswith(begun))
        return
    fits = [key for key in keys.values() if key.name.startswith(incomplete) and not getattr(key, "fixed", False)]
    if len(fits) == 1 and _values(fits[0]):
        yield from ((f"{fits[0].name}={value}", "") for value in _values(fits[0]))
        return
    for fit in fits:
        yield f"{fit.name}=", fit.doc
    if len(fits) == 1 and isinstance(fits[0], Key) and "COMP_WORDS" in os.environ:
        yield f"{fits[0].name}=<{describe(fits[0].type)}>", ""  # a second one keeps bash from adding a space


def _found(command: str, ctx: Any) -> dict[str, Key | Group]:
    """The command's keys, with those of the group members that were given before."""
    given = [str(word).partition("=") for word in ctx.params.get("keys") or []]
    chosen = {name: value for name, _, value in given if value}
    return {key.name: key for key in keys_of(COMMANDS[command], chosen)}


def _value_apart(incomplete: str) -> tuple[str, str] | None:
    """Key and begun value, where bash has parted them."""
    words = os.environ.get("COMP_WORDS", "").split()
    try:
        at = int(os.environ.get("COMP_CWORD", "0"))
    except ValueError:
        return None
    if at >= 1 and words[at : at + 1] == ["="]:
        return words[at - 1], ""
    return (words[at - 2], incomplete) if at >= 2 and words[at - 1 : at] == ["="] else None


def _values(key: Key | Group | None) -> list[str]:
    """The values of a key, where they are a few."""
    if key is None:
        return []
    if isinstance(key, Group):
        return [*key.members(), *(["null"] if key.optional else [])]
    found: list[str] = []
    for part in parts_of(key.type):
        if get_origin(part) is Literal:
            found += [str(value) for value in get_args(part)]
        elif part is bool:
            found += ["true", "false"]
        elif part is type(None) and not is_dataclass(part):
            found.append("null")
    return found
