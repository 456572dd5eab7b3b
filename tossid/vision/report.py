"""What the pose graph found, and what became of every detection: for people and for the next run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import geodesic_angle, matrix_to_quat
from tossid.vision.camera import Camera
from tossid.vision.checks import Suspect
from tossid.vision.factors import Flaws
from tossid.vision.initial import State, there
from tossid.vision.layout import TagLayout
from tossid.vision.reprojection import Errors
from tossid.vision.scene import Scene
from tossid.vision.solution import Solution

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Moved:
    """A camera or tag whose pose the graph found: how far from what was given [m, rad] (None: it was not given),
    and the largest standard deviation along any axis [m, rad]."""

    distance: float | None
    angle: float | None
    sigma: float
    angle_sigma: float


@dataclass(frozen=True, slots=True)
class TrackReport:
    """What became of the detections.

    n_steps: time steps with detections of a moving body, over all of these. n_poses: poses kept. rms:
    reprojection of all kept corners, the root of their mean squared distance [px]; rms_by_camera, rms_by_tag:
    the same in parts; worst_frames: the ten (time, camera, rms) with the largest. rms_axis: along one axis.
    noise_scale: standard deviation of the residuals over what the detections' covariances promise (the poses'
    covariances are scaled with it). dropped_steps: time steps without a pose, by reason. dropped_tags: detections
    left out, by reason. cameras, tags: those calibrated. unplaced: what never was seen with anything known.
    clocks: offset of each camera's clock that was found to be apart, taken off, and its standard deviation [s].
    suspects: what of the set-up the images contradict, where the residuals are larger than noise.
    spread: standard deviation of how far tags' edges spread in an image, where that explains much of the residuals
    [px], else 0; rms then is what is left without it, and rms_bare what is left with it. prints: tags found to be no
    flat squares of their stated size: by what share they are wider, higher, and twisted out of their plane.
    """

    n_steps: int
    n_poses: int
    rms: float
    rms_by_camera: dict[str, float]
    rms_by_tag: dict[int, float]
    noise_scale: float
    dropped_steps: dict[str, int] = field(default_factory=dict)
    dropped_tags: dict[str, int] = field(default_factory=dict)
    rms_axis: float = 0.0
    worst_frames: list[tuple[float, str, float]] = field(default_factory=list)
    cameras: dict[str, Moved] = field(default_factory=dict)
    tags: dict[int, Moved] = field(default_factory=dict)
    unplaced: list[str] = field(default_factory=list)
    clocks: dict[str, tuple[float, float]] = field(default_factory=dict)
    suspects: list[Suspect] = field(default_factory=list)
    spread: float = 0.0
    rms_bare: float = 0.0
    prints: dict[int, tuple[float, float, float]] = field(default_factory=dict)


def make_report(
    scene: Scene,
    solution: Solution,
    errors: Errors,
    believed: Bools,
    frames: Frames,
    scale: float,
    *,
    n_steps: int,
    n_poses: int,
    dropped_steps: Mapping[str, int],
    dropped_tags: Mapping[str, int],
    clocks: Mapping[str, tuple[float, float]],
    suspects: Sequence[Suspect],
    flaws: Flaws,
) -> TrackReport:
    """The report of a solved scene.

    Args:
        believed: (d,) sightings that the poses rest on. frames: their reprojection by frame.
    """

    def rms(index: Bools, pixels: Array = errors.pixels) -> float:
        weights = scene.count[index]
        return float(np.sqrt(np.average(pixels[index] ** 2, weights=weights))) if index.any() else float("nan")

    cameras, tags = enumerate(scene.cameras), enumerate(scene.tags)
    by_camera = {camera.name: rms(believed & (scene.camera == c)) for c, camera in cameras}
    by_tag = {tag.id: rms(believed & (scene.tag == i)) for i, tag in tags}
    state = solution.state
    moved_cameras = {
        camera.name: _moved(state.camera[c], solution.camera_cov[c], camera.T_rig_cam)
        for c, camera in enumerate(scene.cameras)
    }
    moved_tags = {tag.id: _moved(state.tag[i], solution.tag_cov[i], tag.T_body_tag) for i, tag in enumerate(scene.tags)}
    worst = np.argsort(-frames.rms, kind="stable")[:10]
    return TrackReport(
        n_steps,
        n_poses,
        rms(believed),
        {name: value for name, value in by_camera.items() if np.isfinite(value)},
        {tag_id: value for tag_id, value in by_tag.items() if np.isfinite(value)},
        scale,
        dict(dropped_steps),
        dict(dropped_tags),
        rms(believed) / 2**0.5,
        [(float(frames.t[i]), scene.cameras[frames.camera[i]].name, float(frames.rms[i])) for i in worst],
        {name: moved for name, moved in moved_cameras.items() if moved is not None},
        {tag_id: moved for tag_id, moved in moved_tags.items() if moved is not None},
        _unplaced(scene, state),
        dict(clocks),
        list(suspects),
        flaws.swell * scale,
        rms(believed, errors.bare),
        {scene.tags[i].id: tuple(state.prints[i].tolist()) for i in sorted(flaws.printed)},
    )


@dataclass(frozen=True, eq=False)
class Frames:
    """Reprojection by frame: t (f,) [s], camera (f,) index, rms (f,) [px], tags (f,) how many it is of."""

    t: Array
    camera: Ints
    rms: Array
    tags: Ints


def frame_errors(scene: Scene, errors: Errors, rows: Bools) -> Frames:
    """The rms of each frame that has one of the sightings."""
    index = np.flatnonzero(rows)
    frame, group = np.unique(np.stack([scene.step[index], scene.camera[index]]), axis=1, return_inverse=True)
    n, group = frame.shape[1], group.reshape(-1)
    tags = np.bincount(group, minlength=n)
    count = np.maximum(tags, 1)
    late = np.bincount(group, scene.late[index], minlength=n) / count
    rms = np.sqrt(np.bincount(group, errors.pixels[index] ** 2, minlength=n) / count)
    return Frames(scene.t[frame[0]] + late, frame[1], rms, tags)


def _moved(T: Array, cov: Array, given: Array | None) -> Moved | None:
    """None for a pose that was exactly given, or never found."""
    if not np.isfinite(cov).all() or not cov.any():
        return None
    sigma, angle = (float(np.sqrt(np.linalg.eigvalsh(part)[-1])) for part in (cov[3:, 3:], cov[:3, :3]))
    if given is None:
        return Moved(None, None, sigma, angle)
    turn = geodesic_angle(matrix_to_quat(T[:3, :3]), matrix_to_quat(given[:3, :3]))
    return Moved(float(np.linalg.norm(T[:3, 3] - given[:3, 3])), float(turn), sigma, angle)


def _unplaced(scene: Scene, state: State) -> list[str]:
    seen_tags, seen_cameras = np.unique(scene.tag), np.unique(scene.camera)
    names = [f"camera {scene.cameras[c].name}" for c in seen_cameras if not there(state.camera[c])]
    names += [f"tag {scene.tags[i].id}" for i in seen_tags if not there(state.tag[i])]
    names += [f"body {body.name}" for b, body in enumerate(scene.bodies) if _lost(scene, state, b)]
    return names


def _lost(scene: Scene, state: State, b: int) -> bool:
    involved = (scene.body[scene.tag] == b).any() or (scene.rig[scene.camera] == b).any()
    return bool(involved and not there(state.world[b]).any())


def found(scene: Scene, solution: Solution, layout: TagLayout) -> tuple[tuple[Camera, ...], TagLayout]:
    """Cameras and layout with the poses and uncertainties that the graph found."""
    state = solution.state

    def sigmas(cov: Array) -> tuple[Array | None, Array | None]:
        if not np.isfinite(cov).all() or not cov.any():
            return None, None
        return np.sqrt(np.diag(cov)[3:]), np.sqrt(np.diag(cov)[:3])

    cameras = []
    for c, camera in enumerate(scene.cameras):
        rig = int(scene.rig[c])
        T_world_rig = state.world[rig][0] if scene.bodies[rig].is_static and there(state.world[rig][0]) else None
        cov = solution.camera_cov[c]
        found = there(state.camera[c])
        cameras.append(
            replace(
                camera,
                T_rig_cam=state.camera[c] if found else None,
                T_rig_cam_cov=cov if found and np.isfinite(cov).all() and cov.any() else None,
                T_world_rig=T_world_rig,
            )
        )
    bodies = []
    for b, body in enumerate(scene.bodies):
        tags = []
        for i in np.flatnonzero(scene.body == b):
            T = state.tag[i] if there(state.tag[i]) else None
            position, rotation = sigmas(solution.tag_cov[i])
            tags.append(replace(scene.tags[i], T_body_tag=T, position_noise=position, rotation_noise=rotation))
        fixed = body.is_static and bool(there(state.world[b][0]))
        position, rotation = sigmas(solution.world_cov[b][0]) if fixed else (None, None)
        bodies.append(
            replace(
                body,
                tags=tuple(tags),
                T_map_body=state.world[b][0] if fixed else None,
                position_noise=position,
                rotation_noise=rotation,
            )
        )
    return tuple(cameras), replace(layout, bodies=tuple(bodies))
