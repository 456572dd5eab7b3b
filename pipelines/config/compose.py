"""From `conf/` and KEY=VALUE to a checked, frozen config.

Hydra composes the values (groups, defaults lists, interpolation); the schema
decides what is a key and of what type, and its values are set as they are given.
Anything else is refused by name, with the nearest valid spelling.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, TypeVar

from pipelines.config.keys import MISSING, Group, Key, all_keys, keys_of, nearest, shorten
from pipelines.config.places import folders
from tossid.errors import ConfigError
from tossid.settings.kinds import convert, to_plain

C = TypeVar("C")

_KEY = re.compile(r"[A-Za-z_][\w/.]*")


def load(command: str, schema: type[C], overrides: Sequence[str] = ()) -> C:
    """The config of a command.

    Args:
        command: `conf/COMMAND.yaml` names its default members, and values that differ from the schema's defaults.
        schema: the frozen dataclass that says what its keys are.
        overrides: KEY=VALUE, as typed.

    Raises:
        ConfigError: an unknown key or group member, a wrong type, a missing
            value, a value that cannot be read; also for the files in `conf/`.
    """
    chosen = default_members(command)
    given = [_split(text, schema) for text in overrides]
    _refuse_twice(given)
    for key, value in given:
        group = _group(schema, key)
        if group is not None:
            chosen[key] = _member(group, value)
    known = keys_of(schema, chosen)
    groups: list[str] = []
    values: dict[str, Any] = {}
    for key, value in given:
        match = next((item for item in known if item.name == key), None)
        if match is None:
            raise _unknown(key, known, schema, chosen)
        if isinstance(match, Group):
            groups.append(f"{key}={chosen[key] or 'null'}")
        else:
            values[key] = _read(match, value, chosen)
    config: C = convert(schema, _given(_compose(command, groups, values)), key="", advanced=False)
    return config


def as_plain(config: Any) -> dict[str, Any]:
    """A config as nested dicts of plain values, for YAML, JSON and the tracker."""
    plain: dict[str, Any] = to_plain(config, advanced=False)
    return plain


def part_of(config: Any, kind: type[C]) -> C:
    """The library's part of a command's keys.

    Args:
        config: The command's, of a class that inherits from `kind`.
        kind: A settings dataclass of the library.
    """
    settings: Any = kind
    made: C = settings(**{field.name: getattr(config, field.name) for field in fields(settings)})
    return made


def flatten(values: Mapping[str, Any], *, prefix: str = "") -> dict[str, Any]:
    """Nested dicts as one, with dotted keys."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping) and value:
            flat |= flatten(value, prefix=f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def _given(values: dict[str, Any]) -> dict[str, Any]:
    """The values that are given, without those that the caller still has to give."""
    parts = {name: _given(value) if isinstance(value, dict) else value for name, value in values.items()}
    return {name: value for name, value in parts.items() if value != MISSING}


# ---------------------------------------------------------------- reading KEY=VALUE


def _split(text: str, schema: type) -> tuple[str, str]:
    """KEY=VALUE, or an error that says what to type instead."""
    key, equals, value = text.partition("=")
    key = key.strip()
    bare = key.lstrip("+~")
    if bare != key:
        sign = key[: len(key) - len(bare)]
        does = "removed" if sign.startswith("~") else "added"
        raise ConfigError(
            shorten(text), f"keys cannot be {does} ('{sign}'); they are only set, as {shorten(bare) or 'KEY'}=VALUE."
        )
    if not equals:
        raise ConfigError(shorten(text), "is no KEY=VALUE.", suggestion=_suggest_assignment(text, schema))
    if not _KEY.fullmatch(key):
        raise ConfigError(shorten(key or text), "is no name of a key; expected KEY=VALUE.")
    return key, value.strip()


def _suggest_assignment(text: str, schema: type) -> str | None:
    """For a word without '=': the group that has it as a member, or the key itself."""
    groups = [key for key in keys_of(schema, {}) if isinstance(key, Group)]
    for group in groups:
        if text in group.members():
            return f"{group.name}={text}"
    near = nearest(text, [key.name for key in keys_of(schema, {})])
    return f"{near}=…" if near else None


def _refuse_twice(given: Sequence[tuple[str, str]]) -> None:
    seen: dict[str, str] = {}
    for key, value in given:
        if key in seen:
            raise ConfigError(key, f"is given twice ({shorten(seen[key])} and {shorten(value)}).")
        seen[key] = value


def _group(schema: type, key: str) -> Group | None:
    return next((item for item in keys_of(schema, {}) if isinstance(item, Group) and item.name == key), None)


def _member(group: Group, value: str) -> str | None:
    value = value.strip("'\"")
    members = group.members()
    if value in members:
        return value
    if value in ("null", "none") and group.optional:
        return None
    raise ConfigError(
        group.name,
        f"there is no '{shorten(value)}' in conf/{group.name}; it has {', '.join(members)}.",
        suggestion=nearest(value, members),
    )


def _read(key: Key, text: str, chosen: Mapping[str, str | None]) -> Any:
    """The value that a text gives to a key: the text itself where the key takes text, without quotes around it."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    if key.fixed:
        group = key.name.rpartition(".")[0]
        raise ConfigError(key.name, f"is set by {group}={chosen.get(group)}; choose another member with {group}=….")
    if key.is_text and text not in ("null", "None"):
        quoted = len(text) >= 2 and text[0] == text[-1] and text[0] in "'\""
        return text[1:-1] if quoted else text
    try:
        override = OverridesParser.create().parse_override(f"{key.name}={text}")
        several = override.is_sweep_override()
    except HydraException:
        problem = f"cannot read the value {shorten(text)!r}; expected {key.expected}."
        raise ConfigError(key.name, problem) from None
    if several:
        raise ConfigError(key.name, f"takes one value, not several ({shorten(text)}); expected {key.expected}.")
    return override.value()


def _unknown(key: str, known: Sequence[Key | Group], schema: type, chosen: Mapping[str, str | None]) -> ConfigError:
    names = [item.name for item in known]
    group_name = key.split(".")[0]
    group = _group(schema, group_name)
    if group is not None and "." in key:
        member = chosen.get(group_name)
        if member is None:
            return ConfigError(key, f"no {group_name} is chosen; give {group_name}=… too.")
        own = [name for name in names if name.startswith(group_name + ".") and name != f"{group_name}.name"]
        return ConfigError(
            key, f"is no key of {group_name}={member}, which has {', '.join(own)}.", suggestion=nearest(key, own)
        )
    inner = [name for name in names if name.startswith(key + ".")]
    if inner:
        return ConfigError(key, f"is a part with keys of its own: {', '.join(inner)}.")
    return ConfigError(key, "there is no such key.", suggestion=nearest(key, all_keys(schema)))


# ---------------------------------------------------------------- composing


def values_in(name: str) -> dict[str, Any]:
    """What stands in `conf/NAME.yaml`, of tossid or else of the user.

    Raises:
        ConfigError: There is no such file, or it holds no values.
    """
    import yaml

    path = next((path for folder in folders() if (path := folder / f"{name}.yaml").is_file()), None)
    if path is None:
        raise ConfigError(name, f"there is no {name}.yaml in {folders()[0]}.")
    try:
        values = yaml.safe_load(path.read_text()) or {}
    except yaml.YAMLError as error:
        raise ConfigError(name, f"{path} cannot be read: {_one_line(error)}") from None
    if not isinstance(values, dict):
        raise ConfigError(name, f"{path} cannot be read: it holds no names with values.")
    return values


def default_members(command: str) -> dict[str, str | None]:
    """The members that the defaults list of a command chooses."""
    entries = values_in(command).get("defaults", [])
    return {group: member for entry in entries if isinstance(entry, dict) for group, member in entry.items()}


def _compose(command: str, groups: Sequence[str], given: Mapping[str, Any]) -> dict[str, Any]:
    from hydra import compose, initialize_config_dir
    from hydra.core.global_hydra import GlobalHydra
    from hydra.errors import HydraException
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException
    from yaml import YAMLError

    GlobalHydra.instance().clear()
    main, *further = folders()  # where Hydra seeks members that the main folder does not have
    lines = [*groups, *(f"hydra.searchpath=['{folder.as_uri()}']" for folder in further)]
    try:
        with initialize_config_dir(config_dir=str(main.resolve()), version_base="1.3"):
            composed = compose(config_name=command, overrides=lines)
        for key, value in given.items():  # `conf/` need not have the key, and a table is replaced as a whole
            OmegaConf.update(composed, key, value, merge=False, force_add=True)
        values = OmegaConf.to_container(composed, resolve=True, throw_on_missing=False)
    except OmegaConfBaseException as error:
        key = getattr(error, "full_key", None) or command
        raise ConfigError(str(key), _one_line(error)) from error
    except (HydraException, YAMLError) as error:
        raise ConfigError(command, f"the values in {main} cannot be composed: {_one_line(error)}") from error
    assert isinstance(values, dict)
    return {str(name): value for name, value in values.items()}


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
