"""`conf/` holds what differs from the defaults of the library and of the schemas, and members are found in it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from pipelines.config.compose import flatten, load
from pipelines.config.keys import Group, Key, keys_of
from pipelines.config.places import CONF, SAMPLE, folders
from pipelines.config.schemas import COMMANDS, IngestConfig, _sources
from tests.pipelines.conftest import members
from tossid.errors import ConfigError
from tossid.settings.kinds import to_plain
from tossid.vision.recordings.registry import input_formats

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


def test_values_ship_and_the_working_folder_adds_members(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(CONF.parent)
    assert folders() == (CONF,)  # a clone is not searched twice
    monkeypatch.chdir(tmp_path)
    assert folders() == (CONF,)
    assert (SAMPLE / "cameras.yaml").is_file()
    (tmp_path / "conf/object").mkdir(parents=True)
    (tmp_path / "conf/object/brick.yaml").write_text("name: brick\n")
    assert folders() == (CONF, tmp_path / "conf")
    assert {"brick", "cube"} <= set(members("object"))


def test_every_registered_format_can_be_a_source() -> None:
    in_conf = {path.stem for path in (CONF / "source").glob("*.yaml")}
    assert {settings.name for settings in _sources()} == set(input_formats()) >= in_conf
    for name, entry in input_formats().items():
        if name in in_conf:
            source = load("ingest", IngestConfig, [f"source={name}", "source.path=x"]).source
            assert source == entry.settings(path=Path("x"))
