"""Help pages that list a command's keys, with defaults, units and meanings, and what a shell offers after Tab."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import is_dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin, get_type_hints

from typer.core import TyperCommand

from pipelines.config.compose import default_members, flatten, values_in
from pipelines.config.keys import MISSING, Group, Key, all_keys, keys_of
from pipelines.config.schemas import COMMANDS
from tossid.settings.kinds import class_of, describe, parts_of, to_plain

if TYPE_CHECKING:
    from rich.table import Table


class KeyedCommand(TyperCommand):
    """A command whose help lists its keys."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Typer's page, then the keys."""
        super().format_help(ctx, formatter)
        if self.name in COMMANDS:
            print_keys(self.name)


def command_names() -> list[str]:
    """All commands."""
    return sorted({*COMMANDS, "doctor", "info"})


def command_keys(command: str) -> list[str]:
    """The keys of a command, with every group's members' keys."""
    return all_keys(COMMANDS[command]) if command in COMMANDS else []


def print_keys(command: str) -> None:
    """The table of keys, on standard output."""
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.panel import Panel
    from rich.table import Table

    schema = COMMANDS[command]
    values = flatten(values_in(command))
    defaults = default_members(command)
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0), pad_edge=False)
    table.add_column(style="bold cyan", no_wrap=True)
    table.add_column(style="green", overflow="fold")
    table.add_column()
    groups = []
    for key in keys_of(schema, {}):
        if isinstance(key, Group):
            groups.append(key)
        else:
            table.add_row(key.name, escape(_default(key, values)), escape(key.doc))
    for group in groups:
        _add_group(table, group, schema, defaults.get(group.name))
    Console().print(
        Panel(table, title="Keys: default and meaning", title_align="left", box=box.ROUNDED, border_style="dim")
    )


def _add_group(table: Table, group: Group, schema: type, default: str | None) -> None:
    from rich.markup import escape

    hint = get_type_hints(schema, include_extras=True)[group.name]
    classes = [part for part in parts_of(hint) if is_dataclass(part)]
    members = group.members()
    table.add_section()
    table.add_row("", "", "")
    table.add_row(f"{group.name}=", default or "none", f"{escape(group.doc)} [bold]{' | '.join(members)}[/bold]")
    shared = len(classes) == 1
    for member in members:
        if shared and member != (default or members[0]):
            continue
        values = flatten(values_in(f"{group.name}/{member}"), prefix=f"{group.name}.")
        if not shared:
            own = class_of(classes, member)
            about = (own.__doc__ or "").strip().splitlines()[0] if own else ""
            table.add_row(f"  {group.name}={member}", "", f"[dim]{escape(about)}[/dim]")
        for key in keys_of(schema, {group.name: member}):
            if isinstance(key, Key) and key.name.startswith(group.name + ".") and not key.fixed:
                table.add_row(f"    {key.name}", escape(_default(key, values)), escape(key.doc))


def _default(key: Key, values: dict[str, Any]) -> str:
    """A key's value in `conf/`, else its default, as one would write it."""
    value = values.get(key.name, to_plain(key.default))
    if value == MISSING:
        return "(needed)"
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    return str(value)


# ---------------------------------------------------------------- completion


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
