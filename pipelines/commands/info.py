"""`tossid info FILE`: what is in a dataset, a pose file or a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipelines.cli.console import Console
from tossid import budget
from tossid.errors import FileError


@dataclass(frozen=True)
class InfoRequest:
    """What `tossid info` describes and draws."""

    file: Path
    """a dataset, a pose file or a recording folder"""
    figure: Path | None = None
    """a file (.png) for the figure of the order of recording; None for none"""


def run(request: InfoRequest, console: Console) -> dict[str, Any]:
    """Describe a file; returns what `--json` prints."""
    path = request.file
    if not path.exists():
        raise FileError(path, "no such file or folder")
    if not path.is_dir():
        budget.regular_size(path)
    if path.is_dir():
        facts = _folder(path)
    elif path.suffix in (".h5", ".hdf5"):
        from tossid.store import dataset_info

        facts = dataset_info(path)
    elif path.suffix == ".txt":
        from tossid.store.importers.tum import trajectory_info

        facts = trajectory_info(path)
    elif path.suffix == ".npz":
        facts = _stage(path)
    else:
        raise FileError(path, "expected a dataset (.h5), poses (.txt, .npz), detections (.npz) or a recording folder")
    if request.figure is not None:
        facts["figure"] = str(_draw(path, request.figure))
    show(facts, console, title=str(path))
    return facts


def _draw(path: Path, out: Path) -> Path:
    """The figure of a dataset's order of recording."""
    from tossid.evaluation.figures import recording_over_order
    from tossid.outputs import output_file
    from tossid.store import open_dataset

    if path.suffix not in (".h5", ".hdf5"):
        raise FileError(path, "--figure draws the order of recording of a dataset (.h5)")
    if out.suffix != ".png":
        raise FileError(out, "--figure expects a file that ends with .png")
    with open_dataset(path) as dataset:
        order = dataset.order
    if order is None:
        raise FileError(path, "its order of recording was not looked at when it was made; 'tossid ingest' does")
    with output_file(out) as temporary:
        recording_over_order(order).savefig(temporary, format="png")
    return out


def show(facts: dict[str, Any], console: Console, *, title: str) -> None:
    """The facts for a person."""
    apart = ("provenance", "sessions")
    console.facts({name: value for name, value in facts.items() if name not in apart}, title=title)
    if facts.get("sessions"):
        console.table(_SESSION_COLUMNS, [_session_row(session) for session in facts["sessions"]], title="sessions")
    provenance = facts.get("provenance")
    if provenance:
        console.facts({name: _first_line(value) for name, value in provenance.items()}, title="made from")


_SESSION_COLUMNS = ("first", "last", "tosses", "tilt x, y [deg]", "levelled", "changed before it", "note")


def _session_row(session: dict[str, Any]) -> list[Any]:
    level, sigma = session["level_deg"], session.get("level_sigma_deg")
    pairs = [] if level is None else [f"{a:.2f} ± {s:.2f}" for a, s in zip(level, sigma or (0, 0), strict=True)]
    changed = ", ".join(f"{name} (p {p:.2g})" for name, p in session.get("changed", {}).items())
    done = "yes" if session.get("levelled") else "no"
    return [
        session["first"],
        session["last"],
        session["n_tosses"],
        ", ".join(pairs) or "not decided",
        done,
        changed,
        session.get("note", ""),
    ]


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


def _first_line(value: Any) -> Any:
    lines = str(value).splitlines()
    return f"{lines[0]} … ({len(lines)} lines)" if len(lines) > 1 else value
