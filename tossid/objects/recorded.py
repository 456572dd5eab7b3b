"""The object of a recording: `object.yaml`, and its model, in the recording's folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from tossid.errors import ConfigError, FileError, ObjectError
from tossid.objects.model import ObjectModel
from tossid.objects.references import check_model_file, inside
from tossid.settings.kinds import convert, to_plain
from tossid.settings.objects import ObjectSettings
from tossid.yaml_files import read_yaml


def write_object(model: ObjectModel, mjcf: str, folder: Path) -> None:
    """Leave an object beside a recording: its bodies in object.xml, its settings in object.yaml.

    Args:
        model: The object; its tags are those of the recording's tagslam.yaml.
        mjcf: Its bodies as MJCF, as `tossid.store.text_of_model` gives them.
        folder: The recording's folder.
    """
    settings = ObjectSettings(
        name=model.name,
        path=Path("object.xml"),
        friction=model.friction,
        restitution=model.restitution,
        width=model.width,
        tags=Path("tagslam.yaml") if model.tags else None,
    )
    (folder / "object.xml").write_text(mjcf, encoding="utf-8")
    (folder / "object.yaml").write_text(yaml.safe_dump(to_plain(settings), sort_keys=False))


def recorded_object(folder: Path) -> ObjectSettings | None:
    """The object that `write_object` left in a folder, None if there is none.

    Raises:
        FileError: The folder's object.yaml does not describe an object, or names files outside the folder.
    """
    file = folder / "object.yaml"
    if not file.exists():
        return None
    try:
        values = read_yaml(file)
        settings: ObjectSettings = convert(ObjectSettings, values, key="")
        convert(Path, settings.name, key="name")  # files are called after it
        tags = None if settings.tags is None else _named(folder, values, "tags")
        settings = replace(settings, path=_named(folder, values, "path"), tags=tags)
    except (ConfigError, ObjectError) as error:
        raise FileError(file, f"does not describe an object: {error}") from error
    if settings.path.exists():
        check_model_file(settings.path, own_folder=folder)
    return settings


def _named(folder: Path, values: Mapping[str, Any], key: str) -> Path:
    """The file of the folder that a key names; errors name the key."""
    try:
        return inside(folder, str(values[key]))
    except ObjectError as error:
        raise ObjectError(f"{key}: {error}") from error
