"""Recordings among the input formats: images or tag detections of calibrated cameras."""

from __future__ import annotations

import os
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

from tossid.errors import ConfigError, FileError
from tossid.store import importers
from tossid.store.importers.registry import FORMATS, Contents, InputFormat, register
from tossid.vision.recordings import formats

if TYPE_CHECKING:
    from tossid.objects import ObjectModel
    from tossid.types import Detection
    from tossid.vision.cameras.camera import Camera
    from tossid.vision.recordings.recording import Recording
    from tossid.vision.setup.layout import TagLayout

S = TypeVar("S")

PLUGINS = "tossid.inputs"
"""Entry points of this group name modules of other packages that register formats."""


@dataclass(frozen=True, kw_only=True)
class Opened:
    """A recording that is open to be read."""

    path: Path
    """where it lies, as the caller named it"""
    folder: Path
    """folder of its calibration"""
    cameras: tuple[Camera, ...]
    """its cameras"""
    layout: TagLayout
    """bodies and tags of the scene"""
    recording: Recording | None = None
    """its images; None where it has ready detections"""
    detections: tuple[Detection, ...] = ()
    """ready detections"""
    problems: tuple[str, ...] = ()
    """what could not be read of it"""
    model: ObjectModel | None = None
    """the object in it, with the tags that the layout gives it; None where none is named"""

    @classmethod
    def of(cls, recording: Recording, path: Path) -> Opened:
        """A recording with images."""
        cameras, layout, folder = recording.cameras, recording.layout, recording.folder
        problems = recording.problems
        return cls(path=path, folder=folder, cameras=cameras, layout=layout, recording=recording, problems=problems)

    @property
    def name(self) -> str:
        """Name of the recording, for files that are made from it."""
        return recording_name(self.path)

    def images(self) -> Recording:
        """Its images.

        Raises:
            FileError: It has none.
        """
        if self.recording is None:
            raise FileError(self.path, "has tag detections and no images; 'tossid track' and 'tossid ingest' take them")
        return self.recording

    def object(self) -> ObjectModel:
        """The object in it.

        Raises:
            FileError: None is named.
        """
        if self.model is None:
            raise FileError(self.path, "does not say what was tossed; give object=NAME")
        return self.model


def recording_name(path: Path) -> str:
    """The name of what lies at a path: the last part, up to its first dot."""
    return Path(os.path.realpath(path)).name.split(".")[0]


def register_recording(
    settings: type[S], read: Callable[[S], Opened], *, recognizes: Callable[[Path], bool] = lambda path: False
) -> None:
    """Add a format of recordings; `tossid.ingest(..., source=NAME)` then reads it.

    Args:
        settings: Frozen dataclass, as `tossid.store.importers.registry.register_importer` has it.
        read: Opens a recording: its calibration, and where its images or detections are.
        recognizes: Whether a path looks like this format, for callers that name none.
    """
    register(InputFormat(settings=settings, read=read, contents=Contents.RECORDING, recognizes=recognizes))


def input_formats() -> dict[str, InputFormat]:
    """Every format that `ingest` reads, by name: those of tossid, and those of installed plug-ins."""
    _load_formats()
    return dict(sorted(FORMATS.items()))


@cache
def _load_formats() -> None:
    """Import the modules that register formats."""
    for package in (importers, formats):
        _import_modules(package)
    for plugin in entry_points(group=PLUGINS):
        plugin.load()


def _import_modules(package: ModuleType) -> None:
    for module in pkgutil.iter_modules(package.__path__):
        import_module(f"{package.__name__}.{module.name}")


def format_named(name: str) -> InputFormat:
    """The format of a name.

    Args:
        name: As in `source=NAME`.

    Returns:
        The format.

    Raises:
        ConfigError: There is none of that name.
    """
    formats = input_formats()
    if name not in formats:
        raise ConfigError("source", f"there is no format '{name}'; expected {', '.join(formats)}.")
    return formats[name]


def recognized_format(path: Path, *, contents: Contents | None = None) -> InputFormat | None:
    """The format that a path looks like.

    Args:
        path: A file or folder.
        contents: Only formats with these contents; None for all.

    Returns:
        The format, None if no registered format recognizes the path.
    """
    fits = (entry for entry in input_formats().values() if contents in (None, entry.contents))
    return next((entry for entry in fits if entry.recognizes(path)), None)


def open_recording(source: Any) -> Opened:
    """Open what a source names.

    Args:
        source: Settings of a format of recordings, such as `FramesSource(path=...)`.

    Returns:
        The open recording, without an object.

    Raises:
        ConfigError: The format holds no recording.
        FileError: It is missing or cannot be read.
    """
    entry = format_named(source.name)
    if entry.contents is not Contents.RECORDING:
        raise ConfigError("source", f"{entry.name} holds {entry.contents.value}; expected a recording of cameras.")
    opened = entry.read(source)
    assert isinstance(opened, Opened)
    return opened
