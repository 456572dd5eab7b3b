"""The registry of input formats: what a source of tosses can be, and who reads it.

A format is one file with a frozen dataclass of settings (its `name` is the format's) and one call of
`register_importer` for tracked poses and ready tosses, or of `tossid.vision.recordings.registry.register_recording`
for recordings of cameras. Help pages and completion import every format's file for its settings, so the formats of
tossid import numpy and other heavy libraries inside the functions that read.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from tossid.code_digest import note_registered

if TYPE_CHECKING:
    from tossid.objects import ObjectModel
    from tossid.types import PoseTrack

S = TypeVar("S")


class Contents(Enum):
    """What a source holds."""

    POSES = "tracked poses, one track a toss"
    RECORDING = "a recording of cameras: images or tag detections"


class Imported(NamedTuple):
    """What an importer read."""

    tracks: Sequence[PoseTrack]
    """one track a toss"""
    rate_hz: float | None = None
    """frames a second; None: the median over the tracks"""
    remarks: tuple[str, ...] = ()
    """what a person should not miss of what was read"""
    w_first: bool = True
    """whether quaternions stand as w x y z in the source, else as x y z w"""
    stated: bool = True
    """whether the source, or a person, states the order of quaternions; one that is not is refused if
    motion refutes it"""


@dataclass(frozen=True, kw_only=True)
class InputFormat:
    """One format of input."""

    settings: type[Any]
    """frozen dataclass of its settings; the default of the field `name` names the format, `path` says where it lies"""
    read: Callable[..., Any]
    """reads it: settings and object to `Imported` for poses, settings to `Opened` for a recording"""
    contents: Contents
    """what it holds, and so what `ingest` does with it"""
    recognizes: Callable[[Path], bool] = lambda path: False
    """whether a path looks like this format, for callers that name none"""
    default_object: str = "cube"
    """name of the object where neither the caller nor the source names one"""
    cut_at_rest: bool = False
    """whether tosses are cut after the object came to rest: the files of some formats go on"""
    read_links: Callable[[Any], tuple[Sequence[PoseTrack], ...]] | None = None
    """reads the tracks of each of two links of which nothing is stated; None where the format holds no such"""

    @property
    def name(self) -> str:
        """The format's name."""
        return str(self.settings.name)


FORMATS: dict[str, InputFormat] = {}
"""Every registered format by its name."""


def register(entry: InputFormat) -> None:
    """Add a format, or replace the one of that name."""
    note_registered(entry)
    FORMATS[entry.name] = entry


def register_importer(settings: type[S], read: Callable[[S, ObjectModel], Imported], **options: Any) -> None:
    """Add a format of tracked poses or ready tosses; `tossid.ingest(..., source=NAME)` then reads it.

    Args:
        settings: Frozen dataclass with the fields `name` (a `Literal`, whose default names the format) and `path`, and
            what else the format needs, each with a default. The command line takes these fields as `source.FIELD`.
        read: Reads a source of the object. Poses are in metres, quaternions wxyz, in a world whose z points up and
            whose ground is z = 0.
        **options: Further fields of `InputFormat`: `recognizes`, `default_object`, `cut_at_rest`, `read_links`.
    """
    register(InputFormat(settings=settings, read=read, contents=Contents.POSES, **options))


def holds(path: Path, suffix: str) -> bool:
    """Whether a path is a folder with a file of that suffix, and no recording of cameras.

    Returns:
        True if it looks like a folder of tosses.
    """
    return (
        path.is_dir()
        and not (path / "cameras.yaml").exists()
        and any(entry.name.endswith(suffix) for entry in path.iterdir())
    )
