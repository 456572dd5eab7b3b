"""Keys of view and export."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pipelines.schemas.ingestion import DetectConfig, TrackConfig
from pipelines.schemas.kinds import Bounds, Count, NonNegative, ObjectConfig, Positive


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
    every: Count
    """each so many-th frame's image"""
    moments: Annotated[int, Bounds(low=1, high=40)]
    """columns of the contact sheet"""
    magnify: Positive
    """covariances are drawn at three standard deviations, so many times as large"""
    threads: Count | None
    """images searched at the same time; null: one a core"""
    object: ObjectConfig | None
    """what was tossed; none: what the recording says:"""
    detect: DetectConfig
    """how tags are looked for:"""
    track: TrackConfig
    """when a pose is believed:"""


@dataclass(frozen=True)
class ExportConfig:
    """Keys of `tossid export`."""

    run: str | None
    """run id, name or folder; null: the newest training"""
    format: Literal["mjcf", "urdf"]
    """mjcf: a scene that MuJoCo runs as it is; urdf: the object alone, with its meshes beside"""
    out: Path | None
    """file to write (.xml, .urdf); null: outputs/export/NAME"""
    timestep: Positive
    """mjcf: MuJoCo's time step [s]; contact that is learned rigid is as stiff as it bears"""
