"""`make DATA=FOLDER tagslam`: TagSLAM's published recordings from their own set-up, against TagSLAM's own poses.

FOLDER holds tagslam_test/test_N: a bag, cameras.yaml, camera_poses.yaml, tagslam.yaml, and what TagSLAM found
(reference_poses.csv, reference_static.csv). Prints a Markdown table; nothing is tuned to a recording.
"""

from __future__ import annotations

import csv
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.harness import markdown
from pipelines.cli.console import Console
from pipelines.cli.failures import guarded
from pipelines.files.open_source import open_stage
from tossid.errors import FileError
from tossid.rotations import geodesic_angle, matrix_to_quat, transform, xyzw_to_wxyz
from tossid.settings.tracking import TrackSettings
from tossid.vision.pose_graph.track import Tracked, track_scene
from tossid.vision.recordings.registry import Opened
from tossid.vision.setup.layout import BodyTag

Array = NDArray[np.float64]

EVERY_POSE = TrackSettings(max_sigma=float("inf"), max_angle_sigma=float("inf"))
COLUMNS = (
    "recording", "body", "poses", "TagSLAM has", "median [mm]", "max [mm]", "median [°]", "max [°]",
    "rms [px]", "along an axis [px]", "left out", "s",
)  # fmt: skip
FROM_SCRATCH = 4, "cam4", "aviary"
"""Recording, the camera whose pose is given, and the body of the tags that the set-up does not list."""


def main(folder: Path) -> None:
    """Every recording there, then the calibration from scratch of one."""
    console = Console()
    recordings = sorted((folder / "tagslam_test").glob("test_*"), key=lambda path: int(path.name[5:]))
    if not recordings:
        raise FileError(folder, "has no folder tagslam_test/test_N; name the recordings' folder with DATA=FOLDER")
    rows = [row for path in recordings for row in against_reference(path)]
    console.say(markdown(COLUMNS, rows))
    number, camera, body = FROM_SCRATCH
    path = folder / "tagslam_test" / f"test_{number}"
    if path.is_dir():
        console.say(f"\nCameras of {path.name} from scratch, {camera}'s pose given, aligned to TagSLAM's\n")
        console.say(markdown(("camera", "off [mm]", "off [°]"), from_scratch(path, camera, body)))


def against_reference(path: Path) -> list[list[str]]:
    """A row of the table for each moving body that TagSLAM has poses of."""
    opened, started = open_stage(path), time.perf_counter()
    tracked = track_scene(opened.detections, opened.cameras, opened.layout, settings=EVERY_POSE)
    seconds, report = time.perf_counter() - started, tracked.report
    left_out = sum(n for why, n in report.dropped_tags.items() if why != "id on no body")
    rows = []
    for body, (t, T) in _reference_poses(path).items():
        track = tracked.tracks[body]
        index = np.abs(track.t[:, None] - t).argmin(axis=0)
        both = np.abs(track.t[index] - t) < 1e-5
        mine = transform(track.q[index[both], :3], track.q[index[both], 3:7])
        far, turn = _apart(mine, T[both])
        figures = [np.median(far), far.max(), np.median(turn), turn.max(), report.rms, report.rms_axis]
        poses = f"{len(track.t)} of {report.n_steps}" if len(tracked.tracks) == 1 else f"{len(track.t)}"
        texts = [f"{value:.4f}" if value < 0.1 else f"{value:.2f}" for value in figures]
        rows.append([path.name[5:], body, poses, f"{both.sum()} of {len(t)}", *texts, f"{left_out}", f"{seconds:.1f}"])
    return rows


def _reference_poses(path: Path) -> dict[str, tuple[Array, Array]]:
    """Times and T_map_body of each body."""
    found: dict[str, list[dict[str, Any]]] = {}
    with (path / "reference_poses.csv").open() as stream:
        for row in csv.DictReader(stream):
            found.setdefault(row["body"], []).append(row)
    return {
        body: (np.array([int(row["t_ns"]) * 1e-9 for row in rows]), np.stack([_pose(row) for row in rows]))
        for body, rows in found.items()
    }


def _pose(row: dict[str, Any]) -> Array:
    quat = xyzw_to_wxyz([float(row[f"q{k}"]) for k in "xyzw"])
    return transform(np.array([float(row[k]) for k in "xyz"]), quat)


def _apart(A: Array, B: Array) -> tuple[Array, Array]:
    """Distances [mm] and angles [°] of poses."""
    turn = geodesic_angle(matrix_to_quat(A[..., :3, :3]), matrix_to_quat(B[..., :3, :3]))
    return 1e3 * np.linalg.norm(A[..., :3, 3] - B[..., :3, 3], axis=-1), np.rad2deg(turn)


def calibrated_from_scratch(opened: Opened, camera: str, body: str) -> Tracked:
    """The graph without any pose but one camera's: tags on moving bodies and all else unknown."""
    cameras = [
        one if one.name == camera else replace(one, T_rig_cam=None, T_rig_cam_cov=None) for one in opened.cameras
    ]
    bodies = [
        one if one.is_static else replace(one, tags=tuple(BodyTag(tag.id, tag.size, None) for tag in one.tags))
        for one in opened.layout.bodies
    ]
    layout = replace(opened.layout, bodies=tuple(bodies), default_body=body)
    return track_scene(opened.detections, cameras, layout, settings=EVERY_POSE)


def from_scratch(path: Path, camera: str, body: str) -> list[list[str]]:
    """How far each camera is from TagSLAM's, after the best rigid alignment of all of them."""
    tracked = calibrated_from_scratch(open_stage(path), camera, body)
    with (path / "reference_static.csv").open() as stream:
        reference = {row["child"]: _pose(row) for row in csv.DictReader(stream) if row["kind"] == "camera"}
    names = [one.name for one in tracked.cameras]
    mine = np.stack([np.asarray(one.T_rig_cam) for one in tracked.cameras])
    theirs = np.stack([reference[name] for name in names])
    a, b = mine[:, :3, 3], theirs[:, :3, 3]
    U, _, Vt = np.linalg.svd((a - a.mean(axis=0)).T @ (b - b.mean(axis=0)))
    align = np.eye(4)
    align[:3, :3] = (U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt).T
    align[:3, 3] = b.mean(axis=0) - align[:3, :3] @ a.mean(axis=0)
    far, turn = _apart(align @ mine, theirs)
    return [[name, f"{d:.1f}", f"{angle:.3f}"] for name, d, angle in zip(names, far, turn, strict=True)]


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(Path(sys.argv[1])), "against_tagslam"))
