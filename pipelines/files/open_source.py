"""Recordings and stage files where the commands look for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipelines.files.project import newest_recording
from tossid.errors import FileError
from tossid.ingestion.ingest import with_object
from tossid.outputs import recover_folder
from tossid.settings.objects import ObjectSettings
from tossid.types import Detection, PoseTrack
from tossid.vision.recordings.formats.frames import FramesSource
from tossid.vision.recordings.npz import read_detections, read_tracks
from tossid.vision.recordings.registry import Contents, Opened, open_recording, recognized_format

STAGES = Path("outputs/stages")
"""Where the stages leave their files, a folder for each recording."""
DETECTIONS, POSES = "detections.npz", "poses.npz"
"""What `detect` and `track` leave there."""


def located(source: Any) -> Any:
    """A source with its path: the newest recording in data/raw where none is named."""
    path = source.path
    if path is None:
        return replace(source, path=newest_recording())
    recover_folder(path)
    return source


def source_at(path: Path) -> Any:
    """The source of the recording at a path, whatever its format; frames where none is recognized."""
    recover_folder(path)
    entry = recognized_format(path, contents=Contents.RECORDING)
    return FramesSource(path=path) if entry is None else entry.settings(path=path)


def open_stage(path: Path | None, object: ObjectSettings | None = None, *, default: str | None = None) -> Opened:
    """The recording that a stage's key names, with its object.

    Args:
        path: Where it lies; None for the newest in data/raw.
        object: What was tossed; None for what the recording says.
        default: Name of the object where the recording names none either; None for none.

    Returns:
        The open recording.
    """
    source = source_at(newest_recording() if path is None else path)
    return with_object(open_recording(source), object, default=default)


def stage_file(opened: Opened, name: str) -> Path:
    """Where a stage leaves its file of a recording."""
    return STAGES / opened.name / name


def stage_detections(opened: Opened, given: Path | None) -> Sequence[Detection]:
    """What `tossid detect` wrote, or what a bag holds.

    Args:
        opened: The recording.
        given: The file that a key names; None for the bag's, else for that of this recording.
    """
    if given is None and opened.recording is None:
        return opened.detections
    return read_detections(_made(given or stage_file(opened, DETECTIONS), by="detect"))


def stage_tracks(opened: Opened, given: Path | None) -> Sequence[PoseTrack]:
    """What `tossid track` wrote.

    Args:
        opened: The recording.
        given: The file that a key names; None for that of this recording.
    """
    return read_tracks(_made(given or stage_file(opened, POSES), by="track"))


def _made(path: Path, *, by: str) -> Path:
    if not path.is_file():
        raise FileError(path, f"no such file; 'tossid {by}' makes it")
    return path
