"""From tag corners to pose tracks: the pose graph solved, its poses gated, and what became of every detection."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tossid.errors import InputError
from tossid.settings.tracking import TrackSettings
from tossid.types import Detection, PoseTrack
from tossid.vision.cameras.camera import Camera
from tossid.vision.pose_graph.clocks import SAME, SIGMAS, clock_offsets
from tossid.vision.pose_graph.coarse_clocks import CoarseClocks, coarse_clocks
from tossid.vision.pose_graph.gating import gate_tree, pose_track
from tossid.vision.pose_graph.graph_builder import CLOCK_SIGMA
from tossid.vision.pose_graph.report import (
    CONTRADICTS,
    Counts,
    FrameErrors,
    TrackReport,
    calibrated,
    frame_errors,
    make_report,
    sightings_left_out,
)
from tossid.vision.pose_graph.robust import SolvedScene, solve_scene
from tossid.vision.pose_graph.scene import Scene, observe, words
from tossid.vision.pose_graph.state import given
from tossid.vision.setup.layout import TagLayout, descendants

DEFAULT = TrackSettings()


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
    coarse = coarse_clocks(detections, cameras, layout, settings=settings) if settings.clocks else CoarseClocks()
    in_time = list(coarse.in_time(detections))
    return with_clocks(
        track_in_time(in_time, cameras, layout, settings=settings, name=name, apart=coarse.offsets), coarse
    )


def with_clocks(tracked: Tracked, coarse: CoarseClocks) -> Tracked:
    """What was tracked after clocks had been set coarsely, with the whole offsets in its report.

    Args:
        tracked: What was found; its clocks' offsets are the rest.
        coarse: What had been subtracted.
    """
    rest, sigma = tracked.report.clocks, CLOCK_SIGMA
    clocks = {
        c: (late + rest.get(c, (0.0, sigma))[0], rest.get(c, (0.0, sigma))[1]) for c, late in coarse.offsets.items()
    }
    return replace(tracked, report=replace(tracked.report, clocks={**rest, **clocks}, clock_doubts=dict(coarse.doubts)))


def track_in_time(
    detections: Sequence[Detection],
    cameras: Sequence[Camera],
    layout: TagLayout,
    *,
    settings: TrackSettings = DEFAULT,
    name: str | None = None,
    apart: Collection[str] = (),
) -> Tracked:
    """The same of cameras whose clocks are no further apart than the fine search looks.

    Args:
        detections: As `track_scene` has them.
        cameras: As `track_scene` has them.
        layout: As `track_scene` has it.
        settings: As `track_scene` has them.
        name: As `track_scene` has it.
        apart: Cameras whose clocks were set coarsely; what is left of their offsets is estimated however small it is.

    Raises:
        InputError: As `track_scene`.
    """
    as_stamped, dropped = _observed(detections, cameras, layout, {})
    scene = as_stamped
    always = {c for c, camera in enumerate(cameras) if camera.name in apart}
    offsets = dict.fromkeys(always, 0.0)
    if settings.clocks:
        offsets |= clock_offsets(scene, given(scene), settings=settings)
    while True:
        if any(offsets.values()):
            scene, dropped = _observed(detections, cameras, layout, offsets)
        solved = solve_scene(scene, offsets, settings=settings)
        clocks = solved.clocks(offsets)
        # an offset that the graph does not confirm is taken as zero, and the scene solved again
        sure = {
            c: offset
            for c, offset in offsets.items()
            if c in always or abs(clocks[c][0]) > max(SAME, SIGMAS * clocks[c][1])
        }
        if len(sure) == len(offsets):
            named = {cameras[c].name: found for c, found in clocks.items()}
            return _tracked(solved, settings, layout, name, named, dropped)
        offsets = sure
        if not any(offsets.values()):
            scene, dropped = _observed(detections, cameras, layout, {})


def _observed(
    detections: Sequence[Detection],
    cameras: Sequence[Camera],
    layout: TagLayout,
    offsets: dict[int, float],
) -> tuple[Scene, Counter[str]]:
    """The scene with clocks' offsets [s] subtracted, by camera's number, and counts of what was left out."""
    late = {cameras[c].name: offset for c, offset in offsets.items()}
    dropped: Counter[str] = Counter()
    shifted = [replace(d, t=d.t - late[d.camera]) if d.camera in late else d for d in detections]
    return observe(shifted, cameras, layout, dropped=dropped), dropped


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
        gate = gate_tree(scene, solution, errors, rows & used, seen, tree, settings)
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
    per_camera = np.bincount(scene.camera, scene.count, minlength=len(scene.cameras)).astype(int)
    seen_by = {camera.name: n for camera, n in zip(scene.cameras, per_camera.tolist(), strict=True)}
    left_out = sightings_left_out(solved, accepted, gated)
    counts = Counts(n_steps, n_poses, seen_by, left_out, dict(reasons), dict(dropped))
    report = make_report(solved, accepted, frames, counts, clocks)
    cameras, layout = calibrated(scene, solution, layout)
    return Tracked(tracks, cameras, layout, frames, report)
