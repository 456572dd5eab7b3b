"""`tossid view`: a recording, a dataset or a run's rollouts as a Rerun file, or as a contact sheet."""

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
from pipelines.shown import Shown, faces_in_view, misplaced, shown_recording, shown_tosses
from tossid.errors import ConfigError, InputError
from tossid.types import Phase
from tossid.vision.recording import FrameFile
from tossid.vision.sheet import Cell, Column, contact_sheet

FOLDER = Path("outputs/view")


def run(config: ViewConfig, console: Console) -> dict[str, Any]:
    """Gather, write; returns what was written."""
    recorded = config.data is None and config.run is None
    for key, path, suffix in (("out", config.out, ".rrd"), ("sheet", config.sheet, ".png")):
        if path is not None and path.suffix != suffix:
            raise ConfigError(key, f"'{path}' does not end in {suffix}.", suggestion=str(path.with_suffix(suffix)))
    if config.recording is not None and not recorded:
        raise ConfigError("recording", "is given with data= or run=; one of them is shown at a time.")
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
    if shown.recording is None or shown.frames is None:
        raise InputError(f"{shown.name} has tag detections and no images; a contact sheet needs frames")
    stamps = np.array([file.t_ns for files in shown.frames.values() for file in files], dtype=np.int64)
    if not len(stamps):
        raise InputError(f"{shown.name}: no frames in that stretch of time; see start_s and seconds")
    wanted = np.linspace(stamps.min(), stamps.max(), moments) if moments > 1 else [float(np.median(stamps))]
    period = 1e9 / shown.recording.rate_hz if np.isfinite(shown.recording.rate_hz) else np.inf
    columns = []
    for t_ns in wanted:
        nearest = stamps[np.argmin(np.abs(stamps - t_ns))]
        cells = tuple(_cell(shown, name, int(nearest), 1.5 * period) for name in shown.frames)
        columns.append(Column(nearest * 1e-9, happening(shown, nearest * 1e-9), cells))
    span = f"{stamps.min() * 1e-9:.3f} s to {stamps.max() * 1e-9:.3f} s"
    names = f"{len(shown.cameras)} camera{'s' * (len(shown.cameras) > 1)}"
    tosses = f", {len(shown.tosses)} toss{'es' * (len(shown.tosses) != 1)}" if shown.tosses else ""
    return contact_sheet(columns, title=f"{shown.name}: {names}, {span}{tosses}")


def _cell(shown: Shown, name: str, t_ns: int, reach: float) -> Cell:
    assert shown.recording is not None
    assert shown.frames is not None
    camera = next(camera for camera in shown.cameras if camera.name == name)
    file: FrameFile | None = min(shown.frames[name], key=lambda file: abs(file.t_ns - t_ns), default=None)
    if file is None or abs(file.t_ns - t_ns) > reach:
        return Cell(name, t_ns * 1e-9, None)
    frame = shown.recording.read(file)
    found = tuple(d for d in shown.detections if d.camera == name and abs(d.t - frame.t) < 1e-6)
    placed = camera.T_rig_cam is not None and camera.T_world_rig is not None
    outlines = faces_in_view(shown, camera, frame.t) if placed else ()
    return Cell(name, frame.t, frame.image, found, outlines, misplaced(shown, camera, found) if placed else None)


def happening(shown: Shown, t: float) -> str:
    """The toss and its phase at a time, "" between tosses."""
    for toss in shown.tosses:
        if toss.t[0] <= t <= toss.t[-1]:
            phase = Phase(int(toss.phase[int(np.argmin(np.abs(toss.t - t)))]))
            words = "" if phase is Phase.UNKNOWN else f", {phase.name.lower()}"
            return f"toss {toss.name.rpartition('_')[2] or toss.name}{words}"
    return ""
