"""Keys of view and export."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tossid.settings.evaluation import ExportSettings
from tossid.settings.ingestion import DetectSettings
from tossid.settings.kinds import Bounds, Count, NonNegative, Positive
from tossid.settings.objects import ObjectSettings
from tossid.settings.tracking import TrackSettings


@dataclass(frozen=True)
class ViewConfig:
    """Keys of `tossid view`."""

    recording: Path | None
    """recording to show (frames, videos, or a bag); null, with no data=, run= or gap=: the newest in data/raw"""
    data: Path | None
    """dataset to show (.h5)"""
    run: str | None
    """training whose rollouts to show beside held-out tosses (id, name or folder), or those of data="""
    gap: Path | None
    """what `tossid diagnose` wrote (folder or gap.json): its tosses, and rollouts as stated and as patched"""
    detections: Path | None
    """what `tossid detect` wrote for the recording; null: its default place, else tags are looked for now"""
    poses: Path | None
    """what `tossid track` wrote for it; null: its default place, else it is tracked now"""
    out: Path | None
    """Rerun file to write (.rrd); null: outputs/view/NAME.rrd, unless a sheet is asked for"""
    sheet: Path | None
    """contact sheet of the recording to write (.png), for which Rerun is not needed; null: none"""
    open: bool
    """open the Rerun file in its viewer"""
    start_s: NonNegative
    """skip so much at the beginning [s]"""
    seconds: Positive | None
    """show so much from there [s]; null: all"""
    every: Count | None
    """each so many-th frame's image; null: as many as a Rerun file of some 15 MB has room for"""
    moments: Annotated[int, Bounds(low=1, high=40)]
    """columns of the contact sheet"""
    magnify: Positive
    """covariances are drawn at three standard deviations, so many times as large"""
    threads: Count | None
    """images searched at the same time; null: one a core"""
    object: ObjectSettings | None
    """what was tossed; none: what the recording says:"""
    detect: DetectSettings = DetectSettings()
    """how tags are looked for:"""
    track: TrackSettings = TrackSettings()
    """when a pose is accepted:"""


@dataclass(frozen=True, kw_only=True)
class ExportConfig(ExportSettings):
    """Keys of `tossid export`."""

    run: str | None
    """run id, name or folder; null: the newest training"""
    out: Path | None
    """file to write (.xml, .urdf); null: outputs/export/NAME"""
