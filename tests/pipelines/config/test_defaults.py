"""`conf/` holds what differs from the defaults of the library and of the schemas, and no default twice."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from pipelines.config.compose import flatten, load
from pipelines.config.keys import Group, Key, keys_of
from pipelines.config.places import CONF
from pipelines.config.schemas import COMMANDS
from tossid.errors import ConfigError
from tossid.settings.kinds import to_plain

NAMED = ("object", "sweep")
"""Groups whose files are whole: objects and studies as people write their own."""


def files() -> Iterator[tuple[Path, str, dict[str, str | None]]]:
    """Files of values with the command that reads each, and the members that are chosen for that."""
    for command, schema in COMMANDS.items():
        yield CONF / f"{command}.yaml", command, {}
        for group in keys_of(schema, {}):
            if isinstance(group, Group) and group.name not in NAMED:
                for member in group.members():
                    yield CONF / group.name / f"{member}.yaml", command, {group.name: member}


@pytest.mark.parametrize(("path", "command", "chosen"), list(files()), ids=lambda value: getattr(value, "stem", None))
def test_no_file_of_values_repeats_a_default(path: Path, command: str, chosen: dict[str, str | None]) -> None:
    values: dict[str, Any] = yaml.safe_load(path.read_text())
    prefix = "".join(f"{group}." for group in chosen)
    defaults = {key.name: to_plain(key.default) for key in keys_of(COMMANDS[command], chosen) if isinstance(key, Key)}
    given = {prefix + name: value for name, value in flatten(values).items() if name not in ("name", "defaults")}
    assert given.keys() <= defaults.keys()
    assert [name for name, value in given.items() if value == defaults[name]] == []


@pytest.mark.parametrize("command", COMMANDS)
def test_every_key_is_documented_and_what_nothing_sets_has_its_default(command: str) -> None:
    schema = COMMANDS[command]
    assert [key.name for key in keys_of(schema, {}) if not key.doc] == []
    try:
        config = load(command, schema)
    except ConfigError as error:  # a value that only the caller can know
        assert "is needed" in str(error)
        return
    found = flatten(to_plain(config, advanced=False))
    written = flatten(yaml.safe_load((CONF / f"{command}.yaml").read_text()))
    for key in keys_of(schema, {}):
        if isinstance(key, Key) and key.name not in written:
            default = to_plain(key.default)
            assert found[key.name] == default, key.name
