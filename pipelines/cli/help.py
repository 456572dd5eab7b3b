"""Help pages that list a command's keys: defaults, units and meanings, from its schema and `conf/`."""

from __future__ import annotations

from dataclasses import is_dataclass
from typing import TYPE_CHECKING, Any, get_type_hints

from typer.core import TyperCommand

from pipelines.config.compose import default_members
from pipelines.config.keys import MISSING, Group, Key, all_keys, keys_of
from pipelines.config.places import folders
from pipelines.config.schemas import COMMANDS
from tossid.settings.kinds import class_of, parts_of, to_plain

if TYPE_CHECKING:
    from rich.table import Table


class KeyedCommand(TyperCommand):
    """A command whose help lists its keys."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Typer's page, then the keys."""
        super().format_help(ctx, formatter)
        if self.name in COMMANDS:
            print_keys(self.name)


_ABSENT = object()
"""Of a key that no file of `conf/` sets."""


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
    values = _read(command)
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
        values = {group.name: _read(f"{group.name}/{member}")}
        if not shared:
            own = class_of(classes, member)
            about = (own.__doc__ or "").strip().splitlines()[0] if own else ""
            table.add_row(f"  {group.name}={member}", "", f"[dim]{escape(about)}[/dim]")
        for key in keys_of(schema, {group.name: member}):
            if isinstance(key, Key) and key.name.startswith(group.name + ".") and not key.fixed:
                table.add_row(f"    {key.name}", escape(_default(key, values)), escape(key.doc))


def _default(key: Key, values: dict[str, Any]) -> str:
    """A key's value in `conf/`, else its default, as one would write it."""
    value: Any = values
    for part in key.name.split("."):
        value = value.get(part, _ABSENT) if isinstance(value, dict) else _ABSENT
    value = to_plain(key.default) if value is _ABSENT else value
    if value == MISSING:
        return "(needed)"
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    return str(value)


def _read(name: str) -> dict[str, Any]:
    import yaml

    for folder in folders():
        try:
            values = yaml.safe_load((folder / f"{name}.yaml").read_text())
        except (OSError, yaml.YAMLError):
            continue
        if isinstance(values, dict):
            return values
    return {}
