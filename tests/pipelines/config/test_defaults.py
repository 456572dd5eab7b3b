"""`conf/` shows the library's defaults: where a value differs, its line says why, in a comment "differs: ..."."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass
from typing import Any

import pytest
import yaml

from pipelines.config.compose import as_plain, load
from pipelines.config.keys import Group, keys_of
from pipelines.config.places import CONF
from pipelines.config.schemas import COMMANDS
from tossid.errors import ConfigError

REASON = "# differs:"
PRESETS = ("model", "object")
"""Groups whose members are presets of the library, held equal to `conf/` by tests of their own."""


def calls() -> Iterator[tuple[str, tuple[str, ...]]]:
    """Every command with its default members, and with each other member of each group."""
    for command, schema in COMMANDS.items():
        yield command, ()
        for group in keys_of(schema, {}):
            if isinstance(group, Group):
                for member in group.members():
                    yield command, (f"{group.name}={member}",)


def needed(command: str, schema: type, keys: tuple[str, ...]) -> Any:
    """The config of a call, with stand-ins for values that only a user can give."""
    for _ in range(9):
        try:
            return load(command, schema, keys)
        except ConfigError as error:
            if "is needed" not in str(error):
                raise
            asked = str(error)
            given = "[1,1,1]" if "list of 3" in asked else "1" if "number" in asked else "given"
            keys = (*keys, f"{error.key}={given}")
    raise AssertionError(f"{command} {keys} asks for too much")


def differing(part: Any, name: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Fields with a default in the library whose value in `conf/` is another."""
    for field in fields(part):
        value, key = getattr(part, field.name), f"{name}.{field.name}".lstrip(".")
        default = field.default
        if field.default_factory is not MISSING:
            default = field.default_factory()
        if key in PRESETS:
            continue
        if is_dataclass(value) and not isinstance(value, type):
            yield from differing(value, key)
        elif default is not MISSING and value != default:
            yield key, value, default


def reasons() -> set[str]:
    """The last parts of keys whose line in `conf/` says why it differs."""
    found = set()
    for path in CONF.rglob("*.yaml"):
        for line in path.read_text().splitlines():
            if REASON in line:
                found.add(line.split(":")[0].strip())
    return found


@pytest.mark.parametrize(("command", "keys"), list(calls()), ids=lambda value: " ".join(value) or "-")
def test_a_value_is_the_librarys_default_or_says_why_it_differs(command: str, keys: tuple[str, ...]) -> None:
    asked = {key.split("=")[0].split(".")[-1] for key in keys}
    config = needed(command, COMMANDS[command], keys)
    wrong = {
        key: f"{value!r}, in the library {default!r}"
        for key, value, default in differing(config)
        if key.split(".")[-1] not in reasons() | asked and value not in ("given", 1)
    }
    assert not wrong


def test_a_value_that_differs_is_noticed() -> None:
    config = load("evaluate", COMMANDS["evaluate"], [])

    @dataclasses.dataclass(frozen=True)
    class Part:
        speed: float = 2.0

    @dataclasses.dataclass(frozen=True)
    class Whole:
        part: Part
        rate: int = 3

    assert list(differing(Whole(Part(1.0), 3))) == [("part.speed", 1.0, 2.0)]
    assert as_plain(config)  # what is compared is what a command gets


def test_every_file_of_values_is_read() -> None:
    for path in CONF.rglob("*.yaml"):
        assert yaml.safe_load(path.read_text()) is not None, path
