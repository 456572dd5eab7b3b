"""`tossid view`: a recording, a dataset, a run's rollouts or a gap as a Rerun file; a recording as a contact sheet."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipelines.cli.console import Console
from pipelines.config.schemas import ViewConfig
from pipelines.drawing.recording_view import (
    SINCE_1970,
    ViewContent,
    faces_in_view,
    is_placed,
    misplaced,
    moments_of,
    recording_content,
)
from pipelines.drawing.toss_view import toss_content
from pipelines.files.project import named
from tossid.errors import ConfigError, InputError
from tossid.outputs import output_file
from tossid.types import Phase
from tossid.vision.cameras.camera import Camera
from tossid.vision.detection.contact_sheet import Cell, Column, contact_sheet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLDER = Path("outputs/view")
LOOPBACK = "127.0.0.1"
"""The only address that the viewer listens on."""


def run(config: ViewConfig, console: Console) -> dict[str, Any]:
    """Gather, write; returns what was written."""
    recorded = config.data is None and config.run is None and config.gap is None
    for key, path, suffix in (("out", config.out, ".rrd"), ("sheet", config.sheet, ".png")):
        if path is not None:
            named(key, path, suffix)
    if config.recording is not None and not recorded:
        raise ConfigError("recording", "is given with data=, run= or gap=; one of them is shown at a time.")
    if config.run is not None and config.gap is not None:
        raise ConfigError("gap", "is given with run=; one of them is shown at a time.")
    if config.sheet is not None and not recorded:
        raise ConfigError("sheet", "is a contact sheet of a recording's frames; give recording=, or leave it out.")
    wants_file = config.sheet is None or config.out is not None or config.open
    if wants_file:
        from pipelines.drawing.rerun_file import need_rerun, write_rerun

        need_rerun()
    content = recording_content(config, console) if recorded else toss_content(config, console)
    result: dict[str, Any] = {
        "name": content.name,
        "n_detections": len(content.detections),
        "n_poses": {body.name: len(body.t) for body in content.moving},
        "tosses": [toss.name for toss in content.tosses],
        "out": None,
        "sheet": None,
    }
    if config.sheet is not None:
        with output_file(config.sheet) as temporary:
            sheet_of(content, config.moments).savefig(temporary)
        result["sheet"] = str(config.sheet)
        console.say(f"wrote {config.sheet}")
    if wants_file:
        out = config.out or FOLDER / f"{content.name}.rrd"
        with output_file(out) as temporary:
            result["n_images"] = write_rerun(content, temporary, magnify=config.magnify, console=console)
        result["out"] = str(out)
        console.say(f"wrote {out}; open it with: rerun {out}")
        if config.open:
            # The viewer listens for further data, by default on all addresses.
            viewer = [sys.executable, "-m", "rerun", "--bind", LOOPBACK, str(out)]
            subprocess.Popen(viewer, start_new_session=True)
    return result


def sheet_of(content: ViewContent, moments: int) -> Figure:
    """A contact sheet of evenly spaced moments of a recording."""
    times = {camera.name: moments_of(content, camera.name) for camera in content.cameras}
    stamps = np.unique(np.concatenate([*times.values(), np.zeros(0)]))
    if not len(stamps):
        raise InputError(f"{content.name} has no frames and no detections in that stretch of time")
    wanted = np.linspace(stamps[0], stamps[-1], moments) if moments > 1 else np.array([np.median(stamps)])
    period = np.median(np.concatenate([np.diff(own) for own in times.values()] + [np.zeros(1)]))
    origin = stamps[0] if stamps[0] > SINCE_1970 else 0.0  # the columns then have times from the beginning
    columns = []
    for t in stamps[np.abs(stamps - wanted[:, None]).argmin(axis=1)]:
        cells = tuple(_cell(content, camera, times[camera.name], float(t), 1.5 * period) for camera in content.cameras)
        columns.append(Column(float(t - origin), happening(content, float(t)), cells))
    names = f"{len(content.cameras)} camera{'s' * (len(content.cameras) > 1)}"
    tosses = f", {len(content.tosses)} toss{'es' * (len(content.tosses) != 1)}" if content.tosses else ""
    images = "" if content.recording is not None else ", detections without images"
    span = f"{stamps[0] - origin:.3f} s to {stamps[-1] - origin:.3f} s" + f" from {origin:.3f} s on" * bool(origin)
    title = f"{content.name}: {names}, {span}{tosses}{images}"
    return contact_sheet(columns, title=title)


def _cell(content: ViewContent, camera: Camera, times: np.ndarray, t: float, reach: float) -> Cell:
    i = int(np.argmin(np.abs(times - t))) if len(times) else -1
    if i < 0 or abs(times[i] - t) > reach:
        return Cell(camera.name, t, None)
    t, width, height = float(times[i]), *camera.resolution
    image = np.full((height, width), 150, dtype=np.uint8)
    if content.recording is not None and content.frames is not None:
        image = content.recording.read(content.frames[camera.name][i]).image
    found = tuple(d for d in content.detections if d.camera == camera.name and abs(d.t - t) < 1e-6)
    outlines = faces_in_view(content, camera, t) if is_placed(camera) else ()
    return Cell(
        camera.name, t, image, found, outlines, misplaced(content, camera, found) if is_placed(camera) else None
    )


def happening(content: ViewContent, t: float) -> str:
    """The toss and its phase at a time, "" between tosses."""
    for toss in content.tosses:
        if toss.t[0] <= t <= toss.t[-1]:
            phase = Phase(int(toss.phase[int(np.argmin(np.abs(toss.t - t)))]))
            words = "" if phase is Phase.UNKNOWN else f", {phase.name.lower()}"
            return f"toss {toss.name.rpartition('_')[2] or toss.name}{words}"
    return ""
