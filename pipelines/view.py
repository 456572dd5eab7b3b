"""`tossid view`: a recording, a dataset, a run's rollouts or a gap as a Rerun file; a recording as a contact sheet."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipelines.console import Console
from pipelines.outputs import output_file
from pipelines.schemas import ViewConfig
from pipelines.shown import (
    SINCE_1970,
    Shown,
    faces_in_view,
    is_placed,
    misplaced,
    moments_of,
    shown_recording,
)
from pipelines.shown_tosses import shown_tosses
from tossid.errors import ConfigError, InputError
from tossid.types import Phase
from tossid.vision.camera import Camera
from tossid.vision.sheet import Cell, Column, contact_sheet

FOLDER = Path("outputs/view")


def run(config: ViewConfig, console: Console) -> dict[str, Any]:
    """Gather, write; returns what was written."""
    recorded = config.data is None and config.run is None and config.gap is None
    for key, path, suffix in (("out", config.out, ".rrd"), ("sheet", config.sheet, ".png")):
        if path is not None and path.suffix != suffix:
            raise ConfigError(key, f"'{path}' does not end in {suffix}.", suggestion=str(path.with_suffix(suffix)))
    if config.recording is not None and not recorded:
        raise ConfigError("recording", "is given with data=, run= or gap=; one of them is shown at a time.")
    if config.run is not None and config.gap is not None:
        raise ConfigError("gap", "is given with run=; one of them is shown at a time.")
    if config.sheet is not None and not recorded:
        raise ConfigError("sheet", "is a contact sheet of a recording's frames; give recording=, or leave it out.")
    wants_file = config.sheet is None or config.out is not None or config.open
    if wants_file:
        _need_rerun()
    shown = shown_recording(config, console) if recorded else shown_tosses(config, console)
    result: dict[str, Any] = {
        "name": shown.name,
        "n_detections": len(shown.detections),
        "n_poses": {body.name: len(body.t) for body in shown.moving},
        "tosses": [toss.name for toss in shown.tosses],
        "out": None,
        "sheet": None,
    }
    if config.sheet is not None:
        with output_file(config.sheet) as temporary:
            cv2.imwrite(str(temporary), sheet_of(shown, config.moments))
        result["sheet"] = str(config.sheet)
        console.say(f"wrote {config.sheet}")
    if wants_file:
        from pipelines.rerun_file import write_rerun

        out = config.out or FOLDER / f"{shown.name}.rrd"
        with output_file(out) as temporary:
            result["n_images"] = write_rerun(shown, temporary, magnify=config.magnify, console=console)
        result["out"] = str(out)
        console.say(f"wrote {out}; open it with: rerun {out}")
        if config.open:
            subprocess.Popen([sys.executable, "-m", "rerun", str(out)], start_new_session=True)
    return result


def _need_rerun() -> None:
    try:
        import rerun  # noqa: F401
    except ImportError:
        raise InputError(
            "Rerun is not installed (its viewer takes 500 MB): pip install 'tossid[view]', or from a clone "
            "pip install -e '.[view]'; without it, sheet=FILE.png draws a contact sheet"
        ) from None


def sheet_of(shown: Shown, moments: int) -> np.ndarray:
    """A contact sheet (H, W, 3) of evenly spaced moments of a recording."""
    times = {camera.name: moments_of(shown, camera.name) for camera in shown.cameras}
    stamps = np.unique(np.concatenate([*times.values(), np.zeros(0)]))
    if not len(stamps):
        raise InputError(f"{shown.name} has no frames and no detections in that stretch of time")
    wanted = np.linspace(stamps[0], stamps[-1], moments) if moments > 1 else np.array([np.median(stamps)])
    period = np.median(np.concatenate([np.diff(own) for own in times.values()] + [np.zeros(1)]))
    origin = stamps[0] if stamps[0] > SINCE_1970 else 0.0  # the columns then have times from the beginning
    columns = []
    for t in stamps[np.abs(stamps - wanted[:, None]).argmin(axis=1)]:
        cells = tuple(_cell(shown, camera, times[camera.name], float(t), 1.5 * period) for camera in shown.cameras)
        columns.append(Column(float(t - origin), happening(shown, float(t)), cells))
    names = f"{len(shown.cameras)} camera{'s' * (len(shown.cameras) > 1)}"
    tosses = f", {len(shown.tosses)} toss{'es' * (len(shown.tosses) != 1)}" if shown.tosses else ""
    images = "" if shown.recording is not None else ", detections without images"
    span = (
        f"{stamps[-1] - origin:.3f} s from {origin:.3f} s on" if origin else f"{stamps[0]:.3f} s to {stamps[-1]:.3f} s"
    )
    title = f"{shown.name}: {names}, {span}{tosses}{images}"
    return contact_sheet(columns, title=title)


def _cell(shown: Shown, camera: Camera, times: np.ndarray, t: float, reach: float) -> Cell:
    i = int(np.argmin(np.abs(times - t))) if len(times) else -1
    if i < 0 or abs(times[i] - t) > reach:
        return Cell(camera.name, t, None)
    t, width, height = float(times[i]), *camera.resolution
    image = np.full((height, width), 150, dtype=np.uint8)
    if shown.recording is not None and shown.frames is not None:
        image = shown.recording.read(shown.frames[camera.name][i]).image
    found = tuple(d for d in shown.detections if d.camera == camera.name and abs(d.t - t) < 1e-6)
    outlines = faces_in_view(shown, camera, t) if is_placed(camera) else ()
    return Cell(camera.name, t, image, found, outlines, misplaced(shown, camera, found) if is_placed(camera) else None)


def happening(shown: Shown, t: float) -> str:
    """The toss and its phase at a time, "" between tosses."""
    for toss in shown.tosses:
        if toss.t[0] <= t <= toss.t[-1]:
            phase = Phase(int(toss.phase[int(np.argmin(np.abs(toss.t - t)))]))
            words = "" if phase is Phase.UNKNOWN else f", {phase.name.lower()}"
            return f"toss {toss.name.rpartition('_')[2] or toss.name}{words}"
    return ""
