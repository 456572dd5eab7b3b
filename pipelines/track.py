"""`tossid track`: poses from detected tags, from file to file."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from pipelines.console import Console
from pipelines.frames import STAGES, check_stage_name, open_recording, track_stage
from pipelines.outputs import output_file
from pipelines.schemas import TrackStageConfig
from tossid.errors import FileError
from tossid.rotations import wxyz_to_xyzw
from tossid.vision.files import read_detections, write_tracks


def run(config: TrackStageConfig, console: Console) -> dict[str, Any]:
    """Track, write; returns the report and `out`."""
    opened = open_recording(config.recording, config.object)
    source = config.detections or STAGES / opened.name / "detections.npz"
    if not source.is_file():
        raise FileError(source, "no such file; 'tossid detect' makes it")
    detections = read_detections(source)
    out = check_stage_name("out", config.out or STAGES / opened.name / "poses.npz")
    text = out.with_suffix(".txt")
    with output_file(out) as temporary, output_file(text) as temporary_text:
        poses, report = track_stage(opened, detections, config.track, console=console)
        write_tracks([poses], temporary)
        rows = np.column_stack([poses.t, poses.q[:, :3], wxyz_to_xyzw(poses.q[:, 3:7])])
        np.savetxt(temporary_text, rows, fmt="%.9f", header="timestamp tx ty tz qx qy qz qw")
    console.say(f"wrote {out} and {text}")
    return {"out": str(out), "tum": str(text), "recording": str(opened.path), **asdict(report)}
