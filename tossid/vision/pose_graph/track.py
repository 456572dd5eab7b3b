"""From tag corners to pose tracks: the pose graph solved, its poses gated, and what became of every detection."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tossid.errors import InputError
from tossid.settings.tracking import TrackSettings
from tossid.types import Detection, PoseTrack
from tossid.vision.cameras.camera import Camera
from tossid.vision.pose_graph.clocks import SAME, Clocks, clock_offsets
from tossid.vision.pose_graph.gating import gate_steps, pose_track
from tossid.vision.pose_graph.graph_builder import CLOCK_SIGMA
from tossid.vision.pose_graph.report import (
    CONTRADICTS,
    FrameErrors,
    TrackReport,
    calibrated,
    frame_errors,
    make_report,
    sightings_left_out,
)
from tossid.vision.pose_graph.robust import SolvedScene, solve_scene
from tossid.vision.pose_graph.scene import observe, words
from tossid.vision.setup.layout import TagLayout, descendants

DEFAULT = TrackSettings()
SIGMAS = 5.0
"""The pose graph confirms an offset that is so many of its standard deviations from zero."""


@dataclass(frozen=True, eq=False)
class Tracked:
    """What tracking found in a scene.

    Attributes:
        tracks: Of each moving body by name, with the joints of what hangs on it.
        cameras: As given, with the poses and covariances that were found.
        layout: Likewise.
        frames: Reprojection of each frame.
        report: What became of the detections.
    """

    tracks: dict[str, PoseTrack]
    cameras: tuple[Camera, ...]
    layout: TagLayout
    frames: FrameErrors
    report: TrackReport


def track_scene(
    detections: Sequence[Detection],
    cameras: Sequence[Camera],
    layout: TagLayout,
    *,
    settings: TrackSettings = DEFAULT,
    name: str | None = None,
) -> Tracked:
    """All that is unknown in a scene: poses of its moving bodies, and of cameras, tags and static bodies.

    Args:
        detections: In any order, of cameras that need not be synchronous, and whose clocks may be apart.
        cameras: What is known of them.
        layout: What is known of bodies and their tags.
        settings: When poses are accepted.
        name: Of the track, where there is one moving body; else each track has its body's name.

    Raises:
        InputError: A detection of an unknown camera; nothing that can be placed; too few poses for a track.
    """
    detections = sorted(detections, key=lambda d: d.t)
    clocks = clock_offsets(detections, cameras, layout, settings=settings) if settings.clocks else Clocks()
    in_time = list(clocks.in_time(detections))
    tracked = track_in_time(in_time, cameras, layout, settings=settings, name=name, subtracted=clocks.offsets)
    return replace(tracked, report=replace(tracked.report, clock_doubts=clocks.doubts))


def track_in_time(
    detections: Sequence[Detection],
    cameras: Sequence[Camera],
    layout: TagLayout,
    *,
    settings: TrackSettings = DEFAULT,
    name: str | None = None,
    subtracted: Mapping[str, float] | None = None,
) -> Tracked:
    """The same of cameras whose clocks agree, but for what `clock_offsets` has left of their offsets.

    `subtracted` are the offsets [s] that the detections' times are without, by camera's name; what is left of these is
    estimated. All else is as `track_scene` has it.
    """
    late = dict(subtracted or {})
    while True:
        dropped: Counter[str] = Counter()
        scene = observe(detections, cameras, layout, dropped=dropped)
        free = np.array([camera.name in late for camera in cameras])
        solved = solve_scene(scene, free, settings=settings)
        rest, sigma = solved.solution.clock, solved.solution.clock_sigma
        found = {cameras[c].name: (late[cameras[c].name] + rest[c], sigma[c]) for c in map(int, np.flatnonzero(free))}
        # an offset that the graph does not confirm is taken as zero, and the scene solved again
        sure = {one: abs(offset) > max(SAME, SIGMAS * sd) for one, (offset, sd) in found.items()}
        zero = {one for one, (_, sd) in found.items() if not sure[one] and sd < CLOCK_SIGMA / 2}
        if not zero:
            clocks = {one: (float(offset), float(sd)) for one, (offset, sd) in found.items()}
            return _tracked(solved, settings, layout, name, clocks, dropped)
        detections = [replace(d, t=d.t + late[d.camera]) if d.camera in zero else d for d in detections]
        late = {one: offset for one, offset in late.items() if one not in zero}


def _tracked(
    solved: SolvedScene,
    settings: TrackSettings,
    layout: TagLayout,
    name: str | None,
    clocks: dict[str, tuple[float, float]],
    dropped: Counter[str],
) -> Tracked:
    """Tracks of the accepted poses, and the report."""
    scene, solution, errors, used = solved.scene, solved.solution, solved.errors, solved.used
    if solved.outliers:
        dropped[CONTRADICTS] = solved.outliers
    tracks: dict[str, PoseTrack] = {}
    reasons: Counter[str] = Counter()
    accepted, gated = used.copy(), np.full(len(used), "", dtype=object)
    n_steps = n_poses = 0
    moving = [b for b, body in enumerate(scene.bodies) if not body.is_static and body.hinge is None]
    for b in moving:
        tree = [b, *descendants(scene.bodies, b)]
        rows = np.isin(scene.body[scene.tag], tree) | (scene.rig[scene.camera] == b)
        seen = np.bincount(scene.step[rows], minlength=len(scene.t)) > 0
        if not seen.any():
            continue
        gate = gate_steps(scene, solution, errors, rows & used, seen, tree, settings)
        n_steps, n_poses = n_steps + int(seen.sum()), n_poses + int(gate.accepted.sum())
        reasons += gate.reasons
        accepted &= ~rows | gate.accepted[scene.step]
        for reason, bad in gate.rejected.items():
            gated[rows & bad[scene.step]] = reason
        keep = np.flatnonzero(gate.accepted)
        body = scene.bodies[b].name
        if len(keep) >= 2:
            label = name if name is not None and len(moving) == 1 else body
            tracks[body] = pose_track(label, scene, solution, tree, keep)
    if moving and not tracks:
        why = "; ".join([words(reasons + dropped), *(suspect.message for suspect in solved.suspects)])
        raise InputError(f"only {n_poses} of {n_steps} time steps gave a pose ({why})")
    frames = frame_errors(scene, errors, accepted)
    report = replace(
        make_report(solved, accepted, frames),
        n_steps=n_steps,
        n_poses=n_poses,
        left_out=sightings_left_out(solved, accepted, gated),
        dropped_steps=dict(reasons),
        dropped_tags=dict(dropped),
        clocks=clocks,
    )
    cameras, layout = calibrated(scene, solution, layout)
    return Tracked(tracks, cameras, layout, frames, report)
