"""An object by its name, its file or its settings."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Unpack

from tossid.errors import ConfigError, nearest
from tossid.objects.mjcf import Stated, object_from_file
from tossid.objects.model import ObjectModel
from tossid.objects.tags import read_tags
from tossid.objects.unstated import UNKNOWN, unstated_object
from tossid.settings.objects import PRESETS, ObjectSettings, UnknownObjectSettings

OBJECT_FILES = Path(__file__).parent / "library"
"""The files of the objects that come with tossid."""
_BESIDE = Path(__file__).parents[2]
"""The folder in which the package `tossid` lies."""


def load_object(
    what: str | Path | ObjectSettings | UnknownObjectSettings | ObjectModel, **stated: Unpack[Stated]
) -> ObjectModel:
    """The object that is meant, with its tags.

    Args:
        what: A name among `tossid.settings.objects.PRESETS` ("cube", "elbow"), the path of an MJCF or URDF file,
            settings, or an object that is loaded already. "unknown" is an object of which nothing is stated.
        **stated: What the file cannot say, or what shall differ from it or from the settings: see `Stated`. What
            friction holds, and whether it is a guess, is logged (logger `tossid`).

    Returns:
        The object. A base without a joint gets a free joint.

    Raises:
        ConfigError: There is neither an object nor a file of that name.
        FileError: A file is missing or cannot be read, or states several frictions and none is given.
        ObjectError: It is no tree of one free base with hinges and slides.
    """
    if isinstance(what, ObjectModel):
        return _stating(what, stated)
    if isinstance(what, UnknownObjectSettings) or what == UNKNOWN:
        return unstated_object()
    if isinstance(what, str):
        what = PRESETS.get(what, Path(what))
    given: dict[str, Any] = dict(stated)
    if isinstance(what, ObjectSettings):
        given = asdict(what) | given
        what = Path(given.pop("path"))
    elif not what.suffix and not what.exists():
        expected = f"expected {', '.join(PRESETS)} or a file."
        raise ConfigError("object", f"there is no '{what}'; {expected}", suggestion=nearest(str(what), PRESETS))
    return _stating(object_from_file(found(what), friction=given.get("friction")), given)


def _stating(model: ObjectModel, stated: Any) -> ObjectModel:
    """The object with the values that are not None."""
    given = {name: value for name, value in stated.items() if value is not None}
    if isinstance(given.get("tags"), str | Path):
        given["tags"] = read_tags(found(Path(given["tags"])), model.body_names)
    return replace(model, **given)


def found(path: Path) -> Path:
    """A path as it is or, where nothing is there, beside tossid's own package ("tossid/objects/library/cube.xml")."""
    beside = _BESIDE / path
    return beside if not path.is_absolute() and not path.exists() and beside.exists() else path


def absolute_paths(settings: ObjectSettings) -> ObjectSettings:
    """The same settings with absolute paths, for processes in other folders."""
    tags = None if settings.tags is None else found(settings.tags).absolute()
    return replace(settings, path=found(settings.path).absolute(), tags=tags)
