"""From tag corners to pose tracks: the pose graph set up, solved, checked, and what became of every detection."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError, ObjectError
from tossid.objects import ObjectModel
from tossid.rotations import matrix_to_quat, quat_boxminus
from tossid.types import Detection, PoseTrack
from tossid.vision.believed import TrackSettings, believed_tree, pose_track
from tossid.vision.camera import Camera
from tossid.vision.checks import BETTER, Suspect, check_set_up
from tossid.vision.clocks import SAME, clock_offsets
from tossid.vision.factors import NO_FLAWS, Flaws
from tossid.vision.flaws import find_flaws, settled
from tossid.vision.graph import solve
from tossid.vision.initial import Decisions, given, initialise, place, there
from tossid.vision.layout import Body, TagLayout, articulated, body_tags, limbs
from tossid.vision.priors import Prior, calibrates, priors, tag_key
from tossid.vision.report import Frames, TrackReport, found, frame_errors, make_report
from tossid.vision.reprojection import Errors, reproject
from tossid.vision.scene import Scene, observe, words
from tossid.vision.solution import Motion, Solution, unsolved

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

DEFAULT = TrackSettings()
CONFIRMED = 5.0
"""A clock's offset is one that is so many of its standard deviations from none."""
PASSES = 6
"""Most times that flaws of tags are looked for."""
AMISS, AMISS_SHARE = 1.5, 0.02
"""Residuals over the noise, or share of sightings that contradict the others, at which the set-up is checked."""
AS_PROMISED = 1.2
"""Residuals within this of what the corners promise, up or down, leave the poses' covariances as these promise. Errors
that swell a tag, such as its edges' bleeding, are in the residuals and not in the pose."""


@dataclass(frozen=True, eq=False)
class Tracked:
    """What a scene's detections tell.

    tracks: of each moving body by name, with the joints of what hangs on it. cameras, layout: as given, with what the
    graph found of poses and their uncertainty. frames: reprojection of each. report: what became of the detections.
    """

    tracks: dict[str, PoseTrack]
    cameras: tuple[Camera, ...]
    layout: TagLayout
    frames: Frames
    report: TrackReport


def track(
    detections: Iterable[Detection],
    cameras: Sequence[Camera],
    model: ObjectModel,
    *,
    settings: TrackSettings = DEFAULT,
    name: str = "track",
) -> tuple[PoseTrack, TrackReport]:
    """The configuration of one object whose tags are where its model says, among cameras of known pose.

    Args:
        detections: in any order. model: with tags; its joints are hinges.

    Raises:
        ObjectError: the object has no tags, or a joint that slides.
        InputError: a detection of an unknown camera, or too few to make a track.
    """
    if not model.tags:
        raise ObjectError(f"object '{model.name}' has no tags to track")
    rigs = {camera.rig_body: camera for camera in cameras}
    bodies = [Body(rig, True, camera.T_world_rig) for rig, camera in rigs.items()]
    own = [Body(name, False, tags=body_tags(model, b)) for b, name in enumerate(model.body_names)]
    layout = articulated(TagLayout((*bodies, *own)), model)
    tracked = track_scene(list(detections), cameras, layout, settings=settings, name=name)
    return tracked.tracks[model.body_names[0]], tracked.report


def track_scene(
    detections: Sequence[Detection],
    cameras: Sequence[Camera],
    layout: TagLayout,
    *,
    settings: TrackSettings = DEFAULT,
    name: str | None = None,
) -> Tracked:
    """Find everything that is unknown in a scene: where its moving bodies are, and its unknown cameras and tags.

    Args:
        detections: in any order, of cameras that need not be synchronous, and whose clocks may be apart.
        cameras, layout: what is known of the scene.
        name: of the track, where there is one moving body; else each has its body's.

    Raises:
        InputError: a detection of an unknown camera; nothing that can be placed; too few poses for a track.
    """
    as_stamped = _observed(detections, cameras, layout, {})
    offsets = _offsets(as_stamped.scene, settings) if settings.clocks else {}
    solved = _solve(_observed(detections, cameras, layout, offsets) if offsets else as_stamped, settings, offsets)
    while True:  # an offset that the graph does not confirm is none
        clocks = solved.clocks(offsets)
        sure = {c: offset for c, offset in offsets.items() if abs(clocks[c][0]) > max(SAME, CONFIRMED * clocks[c][1])}
        if len(sure) == len(offsets):
            return _tracked(solved, settings, layout, name, {cameras[c].name: found for c, found in clocks.items()})
        offsets = sure
        solved = _solve(_observed(detections, cameras, layout, offsets) if offsets else as_stamped, settings, offsets)


@dataclass(frozen=True, eq=False)
class _Observed:
    """A scene, and what of its detections was left out."""

    scene: Scene
    dropped: Counter[str]


def _observed(
    detections: Sequence[Detection], cameras: Sequence[Camera], layout: TagLayout, offsets: dict[int, float]
) -> _Observed:
    """The scene of the detections with the offsets of clocks taken off [s], by camera's number."""
    late = {cameras[c].name: offset for c, offset in offsets.items()}
    dropped: Counter[str] = Counter()
    shifted = [replace(d, t=d.t - late[d.camera]) if d.camera in late else d for d in detections]
    return _Observed(observe(shifted, cameras, layout, dropped=dropped), dropped)


def _offsets(scene: Scene, settings: TrackSettings) -> dict[int, float]:
    """By how much cameras' clocks are late [s], by number."""
    return clock_offsets(scene, given(scene), decisions=_decisions(settings))


def _decisions(settings: TrackSettings) -> Decisions:
    return Decisions(settings.evidence, settings.max_spin, settings.max_gap)


@dataclass(frozen=True, eq=False)
class _Solved:
    """A scene solved: used (d,) sightings, scale of their noise, tags' flaws, what was left out, what is suspect."""

    scene: Scene
    solution: Solution
    errors: Errors
    used: Bools
    scale: float
    flaws: Flaws
    dropped: Counter[str]
    suspects: list[Suspect]

    def clocks(self, offsets: dict[int, float]) -> dict[int, tuple[float, float]]:
        """Clocks' offsets, those taken off before and what the graph added, and their standard deviations [s]."""
        found, sigma = self.solution.clock, self.solution.clock_sigma
        return {c: (offset + float(found[c]), float(sigma[c])) for c, offset in offsets.items()}


def _solve(observed: _Observed, settings: TrackSettings, offsets: dict[int, float]) -> _Solved:
    """First poses, the graph, outliers left out, the graph again with covariances."""
    scene, dropped = observed.scene, observed.dropped.copy()
    decisions = _decisions(settings)
    state = initialise(scene, decisions=decisions)
    known = priors(scene) | {tag_key(i): Prior(np.eye(4), None) for i in state.gauge}
    used = np.ones(len(scene.step), dtype=bool)
    hangs = any(body.hinge is not None for body in scene.bodies)
    if calibrates(scene, known):
        # first what is static, then what moves anew by that, and all of it together
        state = solve(scene, state, used, known=known).state
        place(scene, state, decisions=decisions, bold=True, again=True)
        solution = solve(scene, state, used, known=known)
    elif hangs:
        solution = solve(scene, state, used, known=known)
    else:  # each step's first poses are its best already
        solution = unsolved(state, np.zeros(len(scene.cameras)))
    free = np.isin(np.arange(len(scene.cameras)), list(offsets))
    plain = _settled(scene, known, settings, free, solution)
    fit = _flawed(scene, known, settings, free, plain) or plain
    suspects = check_set_up(scene, given(scene)) if _amiss(fit.errors, fit.used) else []
    used = fit.used & np.isfinite(fit.errors.pixels)
    if not fit.used.all():
        dropped["contradicts the other tags"] = int(np.sum(~fit.used))
    scale = fit.errors.scale(scene, used)
    told = scale if abs(np.log(scale)) > np.log(AS_PROMISED) else 1.0
    alone = fit.motion is None and not calibrates(scene, known)
    solution = solve(
        scene,
        fit.solution.state,
        used,
        scale=told,
        known=known,
        motion=fit.motion,
        flaws=fit.flaws,
        covariances=True,
        solved=hangs and alone and bool((used == fit.used).all()),
    )
    errors = reproject(scene, solution.state, fit.motion, swell=fit.flaws.swell)
    return _Solved(scene, solution, errors, used, scale, fit.flaws, dropped, suspects)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Poses of the sightings used (d,), how bodies move while frames of a step differ, and flaws taken into account."""

    solution: Solution
    used: Bools
    motion: Motion | None
    errors: Errors
    flaws: Flaws


def _settled(scene: Scene, known: dict[int, Prior], settings: TrackSettings, free: Bools, solution: Solution) -> _Fit:
    """First poses solved anew until nothing contradicts them."""
    used, motion = np.ones(len(scene.step), dtype=bool), None
    for _ in range(3):
        motion = _motion(scene, solution, settings, free)
        outlier = _outliers(scene, reproject(scene, solution.state, motion), used, settings)
        if not outlier.any() and motion is None:
            break
        used &= ~outlier
        # steps that share nothing unknown are solved anew only where something was left out
        alone = motion is None and not calibrates(scene, known)
        changed = np.unique(scene.step[outlier]) if alone else None
        solution = solve(scene, solution.state, used, known=known, motion=motion, steps=changed)
        if not outlier.any() and not free.any():
            break
    return _Fit(solution, used, motion, reproject(scene, solution.state, motion), NO_FLAWS)


def _flawed(scene: Scene, known: dict[int, Prior], settings: TrackSettings, free: Bools, plain: _Fit) -> _Fit | None:
    """The same with what flaws the residuals show taken into account, if that explains much of them."""
    flaws, errors, fit = NO_FLAWS, plain.errors, plain
    used = np.ones(len(scene.step), dtype=bool)
    for _ in range(PASSES):
        outlier = _outliers(scene, errors, used, settings)
        used = used & ~outlier
        before, flaws = flaws, find_flaws(scene, errors, used, flaws)
        if flaws == NO_FLAWS or (settled(before, flaws) and not outlier.any()):
            break
        solution = solve(scene, fit.solution.state, used, known=known, motion=fit.motion, flaws=flaws)
        motion = _motion(scene, solution, settings, free)
        errors = reproject(scene, solution.state, motion, swell=flaws.swell)
        fit = _Fit(solution, used, motion, errors, flaws)
    explained = fit.errors.scale(scene, fit.used) < BETTER * plain.errors.scale(scene, plain.used)
    return fit if fit is not plain and explained else None


def _amiss(errors: Errors, used: Bools) -> bool:
    """Whether the residuals are larger than noise: then the set-up is looked at."""
    left_out = float(np.mean(~used))
    good = used & np.isfinite(errors.whitened)
    return left_out > AMISS_SHARE or bool(good.any() and np.sqrt(np.mean(errors.whitened[good] ** 2)) > AMISS)


def _outliers(scene: Scene, errors: Errors, used: Bools, settings: TrackSettings) -> Bools:
    """Of each step with several tags, the worst one if it contradicts the others."""
    scale = max(errors.scale(scene, used), 1e-3)
    counts = np.bincount(scene.step[used], minlength=len(scene.t))
    whitened = np.where(used, np.nan_to_num(errors.whitened, nan=np.inf), 0.0)
    whitened[~np.isfinite(errors.pixels)] = 0.0
    worst = np.zeros(len(scene.t))
    np.maximum.at(worst, scene.step, whitened)
    outlier = used & (whitened > settings.outlier * scale) & (errors.pixels > 0.5) & (counts[scene.step] > 1)
    return np.asarray(outlier & (whitened >= worst[scene.step]))


def _motion(scene: Scene, solution: Solution, settings: TrackSettings, free: Bools) -> Motion | None:
    """How bodies move while frames of one step differ in time; None if none differs, and no clock is to be found.

    Args:
        free: (cameras,) whose clock offset is to be found.
    """
    if np.abs(scene.late).max() < 1e-6 and not free.any():
        return None
    twists = []
    for T in solution.state.world:
        twist = np.zeros((len(T), 6))
        index = np.flatnonzero(there(T)) if len(T) > 1 else np.zeros(0, dtype=np.int64)
        if len(index) > 1:
            quat = matrix_to_quat(T[index, :3, :3])
            dt = np.diff(scene.t[index])
            rate = (
                np.concatenate(
                    [
                        quat_boxminus(quat[1:], quat[:-1]),
                        np.squeeze(np.swapaxes(T[index[:-1], :3, :3], 1, 2) @ np.diff(T[index, :3, 3:], axis=0), -1),
                    ],
                    axis=1,
                )
                / np.maximum(dt, 1e-9)[:, None]
            )
            rate[dt > settings.max_gap] = np.nan
            sides = np.stack([np.vstack([rate, rate[:1] * np.nan]), np.vstack([rate[:1] * np.nan, rate])])
            count = np.isfinite(sides).sum(axis=0)
            twist[index] = np.nansum(sides, axis=0) / np.maximum(count, 1)
        twists.append(twist)
    return Motion(twists, solution.clock.copy(), free)


def _tracked(
    solved: _Solved,
    settings: TrackSettings,
    layout: TagLayout,
    name: str | None,
    clocks: dict[str, tuple[float, float]],
) -> Tracked:
    """Tracks of what is to be believed, and the report."""
    scene, solution, errors, used = solved.scene, solved.solution, solved.errors, solved.used
    dropped, suspects, scale = solved.dropped, solved.suspects, solved.scale
    tracks: dict[str, PoseTrack] = {}
    reasons: Counter[str] = Counter()
    believed = used.copy()
    n_steps = n_poses = 0
    moving = [b for b, body in enumerate(scene.bodies) if not body.is_static and body.hinge is None]
    for b in moving:
        tree = [b, *limbs(scene.bodies, b)]
        rows = np.isin(scene.body[scene.tag], tree) | (scene.rig[scene.camera] == b)
        seen = np.bincount(scene.step[rows], minlength=len(scene.t)) > 0
        if not seen.any():
            continue
        steps = believed_tree(scene, solution, errors, rows & used, seen, tree, settings)
        n_steps, n_poses = n_steps + int(seen.sum()), n_poses + int(steps.kept.sum())
        reasons += steps.reasons
        believed &= ~rows | steps.kept[scene.step]
        keep = np.flatnonzero(steps.kept)
        body = scene.bodies[b].name
        if len(keep) >= 2:
            label = name if name is not None and len(moving) == 1 else body
            tracks[body] = pose_track(label, scene, solution, tree, keep)
    if moving and not tracks:
        why = "; ".join([words(reasons + dropped), *(suspect.message for suspect in suspects)])
        raise InputError(f"only {n_poses} of {n_steps} time steps gave a pose ({why})")
    frames = frame_errors(scene, errors, believed)
    report = make_report(
        scene,
        solution,
        errors,
        believed,
        frames,
        scale,
        n_steps=n_steps,
        n_poses=n_poses,
        dropped_steps=reasons,
        dropped_tags=dropped,
        clocks=clocks,
        suspects=suspects,
        flaws=solved.flaws,
    )
    cameras, layout = found(scene, solution, layout)
    return Tracked(tracks, cameras, layout, frames, report)
