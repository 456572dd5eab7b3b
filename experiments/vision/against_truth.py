"""`make truth`: filmed tosses from images to a dataset, against the truth that `synthesize` left beside them.

Three cameras of 1280 by 1024 px at 148 Hz, exposed for 1 ms, noise of 1.5 grey levels, blur of 0.5 px: 20 tosses of the
cube and 20 of the elbow. The stages of `ingest` find poses, tosses and velocities with the settings of `conf/`; the
truth is looked at afterwards. Prints Markdown tables; what is filmed already (outputs/truth) is taken as it is.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from experiments.harness import markdown
from pipelines.cli.call import call_with_keys
from pipelines.cli.console import Console, reported
from pipelines.cli.failures import guarded
from pipelines.config.compose import load
from pipelines.config.schemas import IngestConfig
from pipelines.files.open_source import open_stage
from tossid.ingestion import stages
from tossid.ingestion.progress import Reporter
from tossid.motion import tosses_from_tracks
from tossid.motion.ground_plane import find_ground
from tossid.motion.kinematics import center_of_mass, com_velocities, jump_speed
from tossid.objects import GRAVITY, ObjectModel, Tag, body_poses
from tossid.rotations import quat_boxminus, transform, transform_points
from tossid.store import read_dataset
from tossid.synthesis.synthesize import TRUTH
from tossid.types import Phase, PoseTrack, Toss
from tossid.vision.cameras.camera import Camera
from tossid.vision.recordings.npz import read_tracks
from tossid.vision.recordings.registry import Opened
from tossid.vision.setup.layout import SQUARE

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

FOLDER = Path("outputs/truth")
KEYS = ("tosses=20", "camera.width=1280", "camera.height=1024")
FILMS = (("cube", 1), ("cube", 2), ("elbow", 1), ("elbow", 2))
"""Object and seed of each film."""
FACING = 0.25
"""A tag counts as visible where its normal is within acos of this of the way to the camera."""
FLIP = 10.0
"""Beyond so many degrees of error a pose is a flip."""
NEAR_IMPACT = 2
"""Frames from an impact within which velocities are not judged."""
IMPACT_WEIGHTS = 1.5
"""An impact is a mean contact force beyond so many times the object's weight over a frame."""


class Row(NamedTuple):
    """A measured figure: what, in which unit, wanted (in words), found."""

    what: str
    wanted: str
    found: str


def main(names: Sequence[str]) -> None:
    """Film what is missing, take it through the stages, print what came of it."""
    console = Console()
    films = [(name, seed) for name, seed in FILMS if not names or name in names or f"{name}-{seed}" in names]
    columns: dict[str, dict[str, str]] = {}
    wanted: dict[str, str] = {}
    for name, seed in films:
        folder = FOLDER / f"{name}-{seed}"
        if not folder.is_dir():
            call_with_keys(
                "synthesize", [f"object={name}", f"seed={seed}", *KEYS, f"out={folder}"], json=False, quiet=False
            )
        rows = against_truth(folder, console)
        wanted |= {row.what: row.wanted for row in rows}
        columns[folder.name] = {row.what: row.found for row in rows}
    heads = ("what", "wanted", *columns)
    table = [[what, text, *(column.get(what, "") for column in columns.values())] for what, text in wanted.items()]
    console.say(markdown(heads, table))


def against_truth(folder: Path, console: Console) -> list[Row]:
    """The errors of each stage of `ingest` on a film.

    Args:
        folder: A film with its truth.
        console: Shows the progress.

    Returns:
        A row a quantity.
    """
    config: IngestConfig = load("ingest", IngestConfig, [f"source.path={folder}"])
    opened, clock = open_stage(folder, None), [time.process_time()]
    with reported(console) as progress:
        report = Reporter(progress)
        detections = list(stages.detect(opened, settings=config.detect, report=report))
        clock.append(time.process_time())
        tracked = stages.track(opened, detections, settings=config.track, report=report)
        poses, model = stages.object_track(opened, tracked), opened.object()
        tracks, stretches = stages.segment_tosses(opened, poses, settings=config, report=report)
    tosses = tosses_from_tracks(tracks, model, gravity=config.gravity)
    clock.append(time.process_time())
    ground = find_ground(poses, model, gravity=config.gravity)
    (truth,) = read_tracks(folder / "truth_poses.npz")
    true_tosses = read_dataset(folder / TRUTH).tosses
    facts = asdict(tracked.report)
    return [
        Row("images", "", f"{opened.images().n_frames}"),
        Row("reprojection rms [px]", "", f"{facts['rms']:.3f}"),
        Row("corners' errors over what they promise", "", f"{facts['noise_scale']:.2f}"),
        *pose_rows(poses, truth, model, visible(opened, model, truth)),
        *toss_rows(tosses, true_tosses, 1 / float(np.median(np.diff(truth.t)))),
        Row("stretches that are none, each with a reason", "", f"{len(stretches)}"),
        *motion_rows(tosses, true_tosses, model),
        Row("ground's height from rests [mm]", "", f"{1e3 * ground.height:.4f} ± {1e3 * ground.cov[0, 0] ** 0.5:.4f}"),
        Row("ground's tilt from rests [°]", "", f"{np.rad2deg(ground.tilt):.4f}"),
        Row("detection, CPU [s]", "", f"{clock[1] - clock[0]:.0f}"),
        Row("tracking to velocities, CPU [s]", "a quarter of it", f"{clock[2] - clock[1]:.0f}"),
    ]


def pose_rows(poses: PoseTrack, truth: PoseTrack, model: ObjectModel, seen: Bools) -> list[Row]:
    """Of single poses: errors, flips, how many of the frames that show a tag have one, and NEES."""
    index, near = at_times(truth.t, poses.t)
    error = tangent(poses.q, truth.q[index])
    far, turn = 1e3 * np.linalg.norm(error[:, :3], axis=1), np.rad2deg(np.linalg.norm(error[:, 3:6], axis=1))
    has = np.zeros(len(truth.t), dtype=bool)
    has[index[near]] = True
    assert poses.q_cov is not None
    rows = [
        Row("position, median [mm]", "0.3", f"{np.median(far):.3f}"),
        Row("position, 95 % [mm]", "1.5", f"{np.quantile(far, 0.95):.3f}"),
        Row("position, largest [mm]", "", f"{far.max():.2f}"),
        Row("rotation, median [°]", "0.15", f"{np.median(turn):.3f}"),
        Row("rotation, 95 % [°]", "0.8", f"{np.quantile(turn, 0.95):.3f}"),
        Row("rotation, largest [°]", "", f"{turn.max():.2f}"),
        Row("flips", "0", f"{np.sum(turn > FLIP)}"),
        Row("frames with a visible tag that have a pose", "97 %", f"{100 * has[seen].mean():.2f} % of {seen.sum()}"),
        Row("NEES of poses / expected", "0.7 to 1.5", f"{nees(error, poses.q_cov).mean():.2f}"),
    ]
    if model.n_joints:
        joint = np.rad2deg(np.abs(error[:, 6:])).max(axis=1)
        rows.append(Row("joint angle, median [°]", "0.3", f"{np.median(joint):.3f}"))
        rows.append(Row("joint angle, 95 % [°]", "", f"{np.quantile(joint, 0.95):.3f}"))
    return rows


def toss_rows(found: Sequence[Toss], true: Sequence[Toss], rate_hz: float) -> list[Row]:
    """Of the cut: tosses found and not, and how many frames their boundaries are off."""
    pairs = matched(found, true)
    off = [abs(round((f.t[end] - t.t[end]) * rate_hz)) for f, t in pairs for end in (0, -1)]
    return [
        Row("tosses found", "all", f"{len(pairs)} of {len(true)}"),
        Row("what is called a toss and is none", "0", f"{len(found) - len(pairs)}"),
        Row("boundaries off by at most [frames]", "3", f"{max(off, default=-1)}"),
    ]


def motion_rows(found: Sequence[Toss], true: Sequence[Toss], model: ObjectModel) -> list[Row]:
    """Of the smoother: errors and NEES of poses and velocities.

    Velocities are judged outside `NEAR_IMPACT` frames of an impact, and of those that are labelled so (twice the
    force), and there beside what the true poses' own differences from frame to frame would give.
    """
    pairs = [(mine, its, *at_times(its.t, mine.t)) for mine, its in matched(found, true)]
    if not pairs:
        return []
    lag = half_step(true, model)
    q_error, q_nees, v_error, v_nees, bound, hard, soft, flight = (
        np.concatenate(part) for part in zip(*(_one_toss(*pair, model, lag) for pair in pairs), strict=True)
    )
    far, turn = 1e3 * np.linalg.norm(q_error[:, :3], axis=1), np.rad2deg(np.linalg.norm(q_error[:, 3:6], axis=1))
    rows = [
        Row("smoothed: position, median [mm]", "", f"{np.median(far):.3f}"),
        Row("smoothed: rotation, median [°]", "", f"{np.median(turn):.3f}"),
        Row("smoothed: NEES of poses / expected", "0.7 to 1.5", f"{q_nees.mean():.2f}"),
    ]
    for where, own, wanted in (
        ("outside impacts", ~soft, True),
        ("outside labelled impacts", ~hard, False),
        ("in flight", flight, False),
    ):
        error = v_error[own]
        rows += [
            Row(f"velocity {where}, rms [m/s]", "0.02" if wanted else "", f"{rms(error[:, :3]):.4f}"),
            Row(f"spin {where}, rms [rad/s]", "0.15" if wanted else "", f"{rms(error[:, 3:6]):.3f}"),
        ]
        if error.shape[1] > 6:
            rows.append(Row(f"joint rate {where}, rms [rad/s]", "", f"{rms(error[:, 6:]):.3f}"))
        rows.append(Row(f"NEES of velocities {where}", "0.7 to 1.5" if wanted else "", f"{v_nees[own].mean():.2f}"))
    rows.append(Row("spin outside labelled impacts, median [rad/s]", "", f"{np.median(size(v_error[~hard, 3:6])):.3f}"))
    for where, own in (("outside impacts", ~soft), ("outside labelled impacts", ~hard)):
        rows.append(Row(f"spin of true poses' differences {where}, rms [rad/s]", "", f"{rms(bound[own, 3:6]):.3f}"))
    return rows


def _one_toss(
    mine: Toss, its: Toss, index: NDArray[np.int64], near: Bools, model: ObjectModel, lag: float
) -> tuple[NDArray[Any], ...]:
    """Errors of one toss, of each frame that estimate and truth share.

    Errors and NEES of q and of v, the errors of true differences, and which frames are near labelled impacts, near any
    impacts, and in flight.
    """
    h = np.diff(its.t)
    jump = jump_speed(model, its.q[1:], its.v[:-1], its.v[1:], GRAVITY * h) > IMPACT_WEIGHTS * GRAVITY * h
    v = its.v.copy()
    v[its.phase == Phase.FLIGHT, 2] += lag
    q_error, v_error = tangent(mine.q, its.q[index]), mine.v - v[index]
    difference = -tangent(its.q[1:], its.q[:-1]) / h[:, None]
    difference = np.concatenate([difference, difference[-1:]]) - its.v
    flight = (its.phase == Phase.FLIGHT) & ~near_impact(its.phase == Phase.IMPACT)
    parts = (
        q_error, nees(q_error, mine.q_cov), v_error, nees(v_error, mine.v_cov), difference[index],
        near_impact(its.phase == Phase.IMPACT)[index],
        near_impact((its.phase == Phase.IMPACT) | np.append(False, jump))[index],
        flight[index],
    )  # fmt: skip
    return tuple(part[near] for part in parts)


def half_step(true: Sequence[Toss], model: ObjectModel) -> float:
    """By how much the true vertical velocity in flight differs from the slope of the true height [m/s].

    An engine that first changes velocities and then moves with them (as MuJoCo does) has the velocity of half a time
    step later.
    """
    off = []
    for toss in true:
        com = center_of_mass(model, toss.q)[:, 2]
        speed = com_velocities(model, toss.q, toss.v)[..., 2] @ model.mass / model.mass.sum()
        slope = np.diff(com) / np.diff(toss.t) - 0.5 * (speed[1:] + speed[:-1])
        off.append(slope[(toss.phase[1:] == Phase.FLIGHT) & (toss.phase[:-1] == Phase.FLIGHT)])
    return float(np.median(np.concatenate(off)))


def near_impact(hit: Bools) -> Bools:
    """Which frames lie within `NEAR_IMPACT` of an interval with an impact. (n,) frames that end one -> (n,)."""
    hit = hit.copy()
    hit[:-1] |= hit[1:]
    near = hit.copy()
    for k in range(1, NEAR_IMPACT + 1):
        near[k:] |= hit[:-k]
        near[:-k] |= hit[k:]
    return near


def size(x: Array) -> Array:
    """Lengths. (n, k) -> (n,)."""
    return np.asarray(np.linalg.norm(x, axis=1))


def rms(x: Array) -> float:
    """Root of the mean squared length. (n, k)."""
    return float(np.sqrt(np.mean(np.sum(x**2, axis=1))))


def matched(found: Sequence[Toss], true: Sequence[Toss]) -> list[tuple[Toss, Toss]]:
    """Each true toss with the found one that overlaps more than half of it, if there is one."""
    pairs = []
    for its in true:
        for mine in found:
            if min(mine.t[-1], its.t[-1]) - max(mine.t[0], its.t[0]) > 0.5 * (its.t[-1] - its.t[0]):
                pairs.append((mine, its))
                break
    return pairs


def at_times(true: Array, t: Array) -> tuple[NDArray[np.int64], Bools]:
    """Index of the true frame nearest to each time (n,), and whether it is at that time within 0.1 ms."""
    index = np.clip(np.searchsorted(true, t), 1, len(true) - 1)
    index -= t - true[index - 1] < true[index] - t
    return index, np.abs(true[index] - t) < 1e-4


def tangent(q: Array, true: Array) -> Array:
    """True minus estimated configurations (n, nq) in the covariances' tangent (n, nv); joints within half a turn."""
    joints = (true[:, 7:] - q[:, 7:] + np.pi) % (2 * np.pi) - np.pi
    return np.concatenate([true[:, :3] - q[:, :3], quat_boxminus(true[:, 3:7], q[:, 3:7]), joints], axis=1)


def nees(error: Array, cov: Array) -> Array:
    """Normalised squared errors over their expectation. (n, k), (n, k, k) -> (n,)."""
    return np.asarray(np.einsum("ni,ni->n", error, np.linalg.solve(cov, error[..., None])[..., 0]) / error.shape[1])


def visible(opened: Opened, model: ObjectModel, truth: PoseTrack) -> Bools:
    """In which true frames a tag faces a camera and is whole in its image. (n,)."""
    seen = [whole for camera in opened.cameras for _, _, whole in tags_in_view(model, camera, truth.q)]
    return np.asarray(np.any(seen, axis=0))


def tags_in_view(model: ObjectModel, camera: Camera, q: Array) -> Iterator[tuple[Tag, Array, Bools]]:
    """Each tag with its corners (n, 4, 2) [px], and whether it faces the camera and is whole, in poses (n, nq)."""
    position, quat = body_poses(model, q)
    for tag in model.tags:
        T = transform(position[:, tag.body], quat[:, tag.body]) @ tag.T_body_tag
        pixels = camera.project(transform_points(T, 0.5 * tag.size * SQUARE))
        way = camera.T_world_cam[:3, 3] - T[:, :3, 3]
        faces = np.einsum("ni,ni->n", T[:, :3, 2], way) > FACING * np.linalg.norm(way, axis=1)
        yield tag, pixels, faces & camera.contains(pixels, margin=5).all(axis=1)


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(sys.argv[1:]), "against_truth"))
