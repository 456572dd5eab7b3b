"""Keys of ingest and of its stages."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pipelines.config.schemas.launching import Launcher
from tossid.settings.ingestion import DetectSettings, IngestSettings, TossSettings
from tossid.settings.kinds import Count, Registered
from tossid.settings.objects import ObjectSettings, UnknownObjectSettings
from tossid.settings.tracking import TrackSettings


def _sources() -> tuple[type, ...]:
    """The settings of every registered input format."""
    from tossid.vision.recordings.registry import input_formats

    return tuple(entry.settings for entry in input_formats().values())


Source = Annotated[Any, Registered(_sources)]
"""Settings of an input format: the member of `conf/source` chooses the format of its name."""


@dataclass(frozen=True, kw_only=True)
class _IngestFiles:
    """What ingest reads and writes."""

    source: Source
    """what is read:"""
    object: ObjectSettings | UnknownObjectSettings | None
    """what was tossed; none: what the recording says, else the elbow for pll and the cube for the rest; unknown: the
    dataset states no object:"""
    out: Path | None
    """the dataset to write (.h5); null: data/datasets/NAME.h5"""


@dataclass(frozen=True, kw_only=True)
class IngestConfig(IngestSettings, _IngestFiles):
    """Keys of `tossid ingest`."""


@dataclass(frozen=True)
class DetectStageConfig:
    """Keys of `tossid detect`."""

    recording: Path | None
    """recording folder (frames or videos), or a bag with images; null: the newest in data/raw"""
    recordings: str | None
    """several, by a pattern ('data/raw/*'): each is searched by a worker, those that have been are left as they are"""
    out: Path | None
    """detections to write (.npz), of several a folder; null: outputs/stages/RECORDING/detections.npz"""
    threads: Count | None
    """images searched at the same time; null: one a core"""
    workers: Count | None
    """recordings at the same time, of several; null: one a core, or as many as the cluster has workers"""
    launcher: Launcher
    """who searches several:"""
    object: ObjectSettings | None
    """what was tossed; none: what the recording says, else the cube:"""
    detect: DetectSettings = DetectSettings()
    """how tags are looked for:"""


@dataclass(frozen=True)
class TrackStageConfig:
    """Keys of `tossid track`."""

    recording: Path | None
    """recording folder (for its calibration), or a bag with detections; null: the newest in data/raw"""
    detections: Path | None
    """what `tossid detect` wrote; null: the bag's, else its default place for this recording"""
    out: Path | None
    """poses to write (.npz, with .txt of each body in the TUM format and the calibration beside);
    null: outputs/stages/RECORDING/poses.npz"""
    object: ObjectSettings | None
    """what was tossed; none: what the recording says, else every moving body of tagslam.yaml:"""
    track: TrackSettings = TrackSettings()
    """when a pose is accepted:"""


@dataclass(frozen=True, kw_only=True)
class _SegmentFiles:
    """What segment reads and writes."""

    recording: Path | None
    """recording folder (for its object); null: the newest in data/raw"""
    poses: Path | None
    """what `tossid track` wrote; null: its default place for this recording"""
    out: Path | None
    """the dataset to write (.h5); null: data/datasets/RECORDING.h5"""
    object: ObjectSettings | None
    """what was tossed; none: what the recording says, else the cube:"""


@dataclass(frozen=True, kw_only=True)
class SegmentStageConfig(TossSettings, _SegmentFiles):
    """Keys of `tossid segment`."""
