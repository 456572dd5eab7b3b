"""`tossid info FILE`: what is in a dataset, a pose file or a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pipelines.cli.console import Console
from tossid.errors import FileError


def run(path: Path, console: Console) -> dict[str, Any]:
    """Describe `path`; returns what `--json` prints."""
    if not path.exists():
        raise FileError(path, "no such file or folder")
    if path.is_dir():
        facts = _folder(path)
    elif path.suffix in (".h5", ".hdf5"):
        from tossid.store import dataset_info

        facts = dataset_info(path)
    elif path.suffix == ".txt":
        facts = _poses(path)
    elif path.suffix == ".npz":
        facts = _stage(path)
    else:
        raise FileError(path, "expected a dataset (.h5), poses (.txt, .npz), detections (.npz) or a recording folder")
    show(facts, console, title=str(path))
    return facts


def show(facts: dict[str, Any], console: Console, *, title: str) -> None:
    """The facts for a person."""
    console.facts({name: value for name, value in facts.items() if name != "provenance"}, title=title)
    provenance = facts.get("provenance")
    if provenance:
        console.facts({name: _first_line(value) for name, value in provenance.items()}, title="made from")


def _folder(path: Path) -> dict[str, Any]:
    if (path / "cameras.yaml").is_file():
        return _recording(path)
    if (path / "tosses.h5").is_file():  # what `synthesize frames=false` wrote
        from tossid.store import dataset_info

        return dataset_info(path / "tosses.h5")
    datasets = sorted(path.glob("*.h5"))
    tensors, texts = len(list(path.glob("*.pt"))), len(list(path.glob("*.txt")))
    if datasets or tensors or texts:
        return {"kind": "folder", "datasets": [d.name for d in datasets], "pt_files": tensors, "txt_files": texts}
    raise FileError(path, "a folder without cameras.yaml, datasets (.h5) or tosses (.pt, .txt)")


def _recording(path: Path) -> dict[str, Any]:
    from tossid.objects import recorded_object
    from tossid.vision.recordings.formats.frames import read_recording

    recording = read_recording(path)
    times = [file.t_ns for files in recording.frames.values() for file in files]
    known = recorded_object(path)
    return {
        "kind": "recording",
        "object": known.name if known else None,
        "cameras": {camera.name: len(recording.frames[camera.name]) for camera in recording.cameras},
        "resolution_px": sorted({f"{w}x{h}" for w, h in (camera.resolution for camera in recording.cameras)}),
        "n_frames": recording.n_frames,
        "rate_hz": recording.rate_hz,
        "duration_s": (max(times) - min(times)) * 1e-9,
        "tags": {body.name: len(body.tags) for body in recording.layout.bodies if body.tags},
        "truth": str(path / "truth.h5") if (path / "truth.h5").is_file() else None,
    }


def _stage(path: Path) -> dict[str, Any]:
    """What `detect` or `track` wrote."""
    from collections import Counter

    from tossid.vision.recordings.npz import read_detections, read_tracks

    try:
        tracks = read_tracks(path)
    except FileError:
        detections = read_detections(path)
        return {
            "kind": "detections",
            "n_detections": len(detections),
            "cameras": dict(sorted(Counter(d.camera for d in detections).items())),
            "tags": {str(tag): count for tag, count in sorted(Counter(d.tag_id for d in detections).items())},
        }
    return {
        "kind": "poses",
        "tracks": {track.name: len(track.t) for track in tracks},
        "n_frames": sum(len(track.t) for track in tracks),
        "covariances": all(track.q_cov is not None for track in tracks),
    }


def _poses(path: Path) -> dict[str, Any]:
    """One TUM trajectory."""
    import numpy as np

    from tossid.errors import MotionError
    from tossid.types import check_motion

    form = "rows of 'timestamp tx ty tz qx qy qz qw'"
    try:
        rows = np.loadtxt(path, comments="#", ndmin=2)
    except (ValueError, UnicodeDecodeError) as error:
        raise FileError(path, f"expected {form} ({' '.join(str(error).split())})") from error
    if rows.shape[1] != 8:
        raise FileError(path, f"has {rows.shape[1]} columns, expected {form}")
    try:
        check_motion(rows[:, 0], rows[:, [1, 2, 3, 7, 4, 5, 6]])
    except MotionError as error:
        raise FileError(path, error.problem, row=error.row) from error
    return {
        "kind": "poses",
        "n_frames": len(rows),
        "rate_hz": float(1 / np.median(np.diff(rows[:, 0]))),
        "duration_s": float(rows[-1, 0] - rows[0, 0]),
        "position_min_m": rows[:, 1:4].min(axis=0).tolist(),
        "position_max_m": rows[:, 1:4].max(axis=0).tolist(),
    }


def _first_line(value: Any) -> Any:
    lines = str(value).splitlines()
    return f"{lines[0]} … ({len(lines)} lines)" if len(lines) > 1 else value
