"""From `conf/` and KEY=VALUE to a checked, frozen config.

Hydra composes the values (groups, defaults lists, interpolation); the schema
decides what is a key and of what type. Anything else is refused by name, with
the nearest valid spelling.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
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
    lines: list[str] = []
    tables: dict[str, Any] = {}
    for key, value in given:
        line = _override(key, value, known, schema, chosen)
        if _is_table(key, known):  # Hydra would merge it into the default, or refuse its names
            tables[key] = _parse(key, value)
        else:
            lines.append(line)
    values = _compose(command, lines)
    for key, table in tables.items():
        _put(values, key, table)
    config: C = convert(schema, _given(values), key="", advanced=False)
    return config


def as_plain(config: Any) -> dict[str, Any]:
    """A config as nested dicts of plain values, for YAML, JSON and the tracker."""
    plain: dict[str, Any] = to_plain(config, advanced=False)
    return plain


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
    for known in keys_of(schema, {}):
        if isinstance(known, Group) and known.name == key:
            return known
    return None


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


def _override(
    key: str, value: str, known: Sequence[Key | Group], schema: type, chosen: Mapping[str, str | None]
) -> str:
    """One checked line for Hydra."""
    match = next((item for item in known if item.name == key), None)
    if match is None:
        raise _unknown(key, known, schema, chosen)
    if isinstance(match, Group):
        return f"{key}={chosen[key] or 'null'}"
    line = f"++{key}="  # `conf/` need not have the key, as the library has its default
    if match.fixed:
        group = key.rpartition(".")[0]
        raise ConfigError(key, f"is set by {group}={chosen.get(group)}; choose another member with {group}=….")
    if match.is_text and value not in ("null", "None"):
        return line + _quote(value)
    _check_syntax(key, value, match)
    return line + value


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


def _quote(value: str) -> str:
    """Text for Hydra, taken as it stands: no lists, no sweeps. Quotes around the whole are dropped."""
    if len(value) >= 2 and value[0] == value[-1] and value[0] in "'\"":
        value = value[1:-1]
    escaped = re.sub(r"(\\*)'", lambda m: m.group(1) * 2 + r"\'", value)
    trailing = len(escaped) - len(escaped.rstrip("\\"))
    return f"'{escaped}{chr(92) * trailing}'"


def _is_table(key: str, known: Sequence[Key | Group]) -> bool:
    return any(isinstance(item, Key) and item.name == key and item.is_table for item in known)


def _parse(key: str, value: str) -> Any:
    from hydra.core.override_parser.overrides_parser import OverridesParser

    return OverridesParser.create().parse_override(f"{key}={value}").value()


def _put(values: dict[str, Any], key: str, value: Any) -> None:
    *path, last = key.split(".")
    for part in path:
        values = values.setdefault(part, {})
    values[last] = value


def _check_syntax(key: str, value: str, match: Key) -> None:
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    try:
        override = OverridesParser.create().parse_override(f"{key}={value}")
        sweep = override.is_sweep_override()
    except HydraException:
        raise ConfigError(key, f"cannot read the value {shorten(value)!r}; expected {match.expected}.") from None
    if sweep:
        raise ConfigError(key, f"takes one value, not several ({shorten(value)}); expected {match.expected}.")


# ---------------------------------------------------------------- composing


def default_members(command: str) -> dict[str, str | None]:
    """The members that the defaults list of a command chooses."""
    import yaml

    path = folders()[0] / f"{command}.yaml"
    try:
        values = yaml.safe_load(path.read_text()) or {}
        entries = values.get("defaults", [])
        return {group: member for entry in entries if isinstance(entry, dict) for group, member in entry.items()}
    except FileNotFoundError:
        raise ConfigError(command, f"{path} is missing: the command's values should be there.") from None
    except (yaml.YAMLError, AttributeError) as error:
        raise ConfigError(command, f"{path} cannot be read: {_one_line(error)}") from None


def _compose(command: str, lines: Sequence[str]) -> dict[str, Any]:
    from hydra import compose, initialize_config_dir
    from hydra.core.global_hydra import GlobalHydra
    from hydra.errors import HydraException
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException
    from yaml import YAMLError

    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(config_dir=str(folders()[0].resolve()), version_base="1.3"):
            composed = compose(config_name=command, overrides=[*lines, *_further()])
        values = OmegaConf.to_container(composed, resolve=True, throw_on_missing=False)
    except OmegaConfBaseException as error:
        key = getattr(error, "full_key", None) or command
        raise ConfigError(str(key), _one_line(error)) from error
    except (HydraException, YAMLError) as error:
        raise ConfigError(command, f"the values in {folders()[0]} cannot be composed: {_one_line(error)}") from error
    assert isinstance(values, dict)
    return {str(name): value for name, value in values.items()}


def _further() -> list[str]:
    """Where Hydra seeks members that the main folder does not have."""
    return [f"hydra.searchpath=[{_quote(folder.as_uri())}]" for folder in folders()[1:]]


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
