"""Reports of tracking: reprojection, what was left out, and the calibrated cameras and layout."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import geodesic_angle, matrix_to_quat
from tossid.vision.cameras.camera import Camera
from tossid.vision.pose_graph.reprojection import ReprojectionErrors
from tossid.vision.pose_graph.robust import SolvedScene
from tossid.vision.pose_graph.scene import Scene
from tossid.vision.pose_graph.setup_checks import Suspect
from tossid.vision.pose_graph.state import Solution, State, is_known
from tossid.vision.setup.layout import TagLayout

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

CONTRADICTS = "contradicts the other tags"
"""Why an outlier is left out."""


@dataclass(frozen=True, slots=True)
class PoseChange:
    """A camera or tag whose pose the graph estimated.

    Attributes:
        distance: From the given pose [m]; None where none was given.
        angle: Likewise [rad].
        sigma: Largest standard deviation along any axis [m].
        angle_sigma: Likewise [rad].
    """

    distance: float | None
    angle: float | None
    sigma: float
    angle_sigma: float


@dataclass(frozen=True, slots=True)
class TrackReport:
    """What became of the detections.

    Attributes:
        n_steps: Time steps with detections of a moving body, summed over bodies.
        n_poses: Poses that were accepted.
        rms: Reprojection of all accepted corners, the root of their mean squared distance [px].
        rms_by_camera: The same by camera's name [px].
        rms_by_tag: The same by tag's id [px].
        noise_scale: Standard deviation of the residuals over what the detections' covariances say.
        sightings: Detections of the scene's tags by camera's name, for all cameras.
        left_out: Of these, the ones that no accepted pose rests on: counts by camera's name and reason.
        dropped_steps: Time steps without a pose, by reason.
        dropped_tags: Detections left out, by reason.
        rms_axis: `rms` along one axis [px].
        worst_frames: Time, camera and rms of the ten frames with the largest.
        cameras: Those calibrated.
        tags: Those calibrated.
        unplaced: What was never seen with anything of known pose.
        clocks: Offset of each camera's clock that was found to be apart, and its standard deviation [s]; subtracted.
        clock_doubts: Of cameras whose clocks can neither be compared nor be taken to agree: by name, why.
        suspects: Parts of the set-up that the images contradict.
        spread: Standard deviation of how far tags' edges spread in an image, where that explains much of the residuals
            [px], else 0.
        rms_bare: `rms` with the spread left in [px].
        prints: Tags found to be distorted: by what shares they are wider, higher, and twisted out of their plane.
    """

    n_steps: int = 0
    n_poses: int = 0
    rms: float = float("nan")
    rms_by_camera: dict[str, float] = field(default_factory=dict)
    rms_by_tag: dict[int, float] = field(default_factory=dict)
    noise_scale: float = 1.0
    sightings: dict[str, int] = field(default_factory=dict)
    left_out: dict[str, dict[str, int]] = field(default_factory=dict)
    dropped_steps: dict[str, int] = field(default_factory=dict)
    dropped_tags: dict[str, int] = field(default_factory=dict)
    rms_axis: float = 0.0
    worst_frames: list[tuple[float, str, float]] = field(default_factory=list)
    cameras: dict[str, PoseChange] = field(default_factory=dict)
    tags: dict[int, PoseChange] = field(default_factory=dict)
    unplaced: list[str] = field(default_factory=list)
    clocks: dict[str, tuple[float, float]] = field(default_factory=dict)
    clock_doubts: dict[str, str] = field(default_factory=dict)
    suspects: list[Suspect] = field(default_factory=list)
    spread: float = 0.0
    rms_bare: float = 0.0
    prints: dict[int, tuple[float, float, float]] = field(default_factory=dict)


def make_report(solved: SolvedScene, accepted: Bools, frames: FrameErrors) -> TrackReport:
    """The report of a solved scene, but for its clocks and counts of what was left out.

    Args:
        solved: Poses and residuals.
        accepted: Sightings that the accepted poses rest on, (d,).
        frames: Reprojection of each frame.
    """
    scene, solution, errors, scale = solved.scene, solved.solution, solved.errors, solved.scale

    def rms(index: Bools, pixels: Array = errors.pixels) -> float:
        weights = scene.count[index]
        return float(np.sqrt(np.average(pixels[index] ** 2, weights=weights))) if index.any() else float("nan")

    cameras, tags = enumerate(scene.cameras), enumerate(scene.tags)
    by_camera = {camera.name: rms(accepted & (scene.camera == c)) for c, camera in cameras}
    by_tag = {tag.id: rms(accepted & (scene.tag == i)) for i, tag in tags}
    state = solution.state
    of_cameras = {
        camera.name: _change(state.camera[c], solution.camera_cov[c], camera.T_rig_cam)
        for c, camera in enumerate(scene.cameras)
    }
    of_tags = {tag.id: _change(state.tag[i], solution.tag_cov[i], tag.T_body_tag) for i, tag in enumerate(scene.tags)}
    worst = np.argsort(-frames.rms, kind="stable")[:10]
    per_camera = np.bincount(scene.camera, scene.count, minlength=len(scene.cameras)).astype(int)
    whole = rms(accepted)
    return TrackReport(
        rms=whole,
        rms_by_camera={name: value for name, value in by_camera.items() if np.isfinite(value)},
        rms_by_tag={tag_id: value for tag_id, value in by_tag.items() if np.isfinite(value)},
        noise_scale=scale,
        sightings={camera.name: n for camera, n in zip(scene.cameras, per_camera.tolist(), strict=True)},
        rms_axis=whole / 2**0.5,
        worst_frames=[(float(frames.t[i]), scene.cameras[frames.camera[i]].name, float(frames.rms[i])) for i in worst],
        cameras={name: change for name, change in of_cameras.items() if change is not None},
        tags={tag_id: change for tag_id, change in of_tags.items() if change is not None},
        unplaced=_unplaced(scene, state),
        suspects=list(solved.suspects),
        spread=solved.tag_model.spread_sigma * scale,
        rms_bare=rms(accepted, errors.raw_pixels),
        prints={scene.tags[i].id: tuple(state.prints[i].tolist()) for i in sorted(solved.tag_model.prints)},
    )


def sightings_left_out(solved: SolvedScene, accepted: Bools, gated: NDArray[np.object_]) -> dict[str, dict[str, int]]:
    """How many sightings no accepted pose rests on, by camera's name and reason.

    Args:
        solved: Poses and residuals.
        accepted: Sightings that the accepted poses rest on, (d,).
        gated: Why the pose in each sighting's step was not accepted, empty where it was, (d,).
    """
    scene, state = solved.scene, solved.solution.state
    why = np.where(gated == "", "without a pose", gated)
    why[~solved.used & np.isfinite(solved.errors.pixels)] = CONTRADICTS
    why[~is_known(state.tag)[scene.tag]] = "of a tag that was not placed"
    why[~is_known(state.camera)[scene.camera]] = "the camera was not placed"
    found: dict[str, dict[str, int]] = {}
    for c, reason in sorted(set(zip(scene.camera[~accepted].tolist(), why[~accepted].tolist(), strict=True))):
        rows = ~accepted & (scene.camera == c) & (why == reason)
        found.setdefault(scene.cameras[c].name, {})[reason] = int(scene.count[rows].sum())
    return found


@dataclass(frozen=True, eq=False)
class FrameErrors:
    """Reprojection by frame.

    Attributes:
        t: Time [s], (f,).
        camera: Number of the camera, (f,).
        rms: Root mean square over its tags [px], (f,).
        tags: Number of tags, (f,).
    """

    t: Array
    camera: Ints
    rms: Array
    tags: Ints


def frame_errors(scene: Scene, errors: ReprojectionErrors, rows: Bools) -> FrameErrors:
    """The reprojection of each frame with any of some sightings.

    Args:
        scene: The sightings.
        errors: Their reprojection.
        rows: Which sightings count, (d,).
    """
    index = np.flatnonzero(rows)
    frame, group = np.unique(np.stack([scene.step[index], scene.camera[index]]), axis=1, return_inverse=True)
    n, group = frame.shape[1], group.reshape(-1)
    tags = np.bincount(group, minlength=n)
    count = np.maximum(tags, 1)
    delay = np.bincount(group, scene.delay[index], minlength=n) / count
    rms = np.sqrt(np.bincount(group, errors.pixels[index] ** 2, minlength=n) / count)
    return FrameErrors(scene.t[frame[0]] + delay, frame[1], rms, tags)


def _change(T: Array, cov: Array, given: Array | None) -> PoseChange | None:
    """How far a pose is from the given one; None where it was exactly given or never found."""
    if not np.isfinite(cov).all() or not cov.any():
        return None
    sigma, angle = (float(np.sqrt(np.linalg.eigvalsh(part)[-1])) for part in (cov[3:, 3:], cov[:3, :3]))
    if given is None:
        return PoseChange(None, None, sigma, angle)
    turn = geodesic_angle(matrix_to_quat(T[:3, :3]), matrix_to_quat(given[:3, :3]))
    return PoseChange(float(np.linalg.norm(T[:3, 3] - given[:3, 3])), float(turn), sigma, angle)


def _unplaced(scene: Scene, state: State) -> list[str]:
    seen_tags, seen_cameras = np.unique(scene.tag), np.unique(scene.camera)
    names = [f"camera {scene.cameras[c].name}" for c in seen_cameras if not is_known(state.camera[c])]
    names += [f"tag {scene.tags[i].id}" for i in seen_tags if not is_known(state.tag[i])]
    names += [f"body {body.name}" for b, body in enumerate(scene.bodies) if _is_unplaced(scene, state, b)]
    return names


def _is_unplaced(scene: Scene, state: State, b: int) -> bool:
    involved = (scene.body[scene.tag] == b).any() or (scene.rig[scene.camera] == b).any()
    return bool(involved and not is_known(state.world[b]).any())


def calibrated(scene: Scene, solution: Solution, layout: TagLayout) -> tuple[tuple[Camera, ...], TagLayout]:
    """Cameras and layout with the poses and uncertainties that the graph found."""
    state = solution.state

    def sigmas(cov: Array) -> tuple[Array | None, Array | None]:
        if not np.isfinite(cov).all() or not cov.any():
            return None, None
        return np.sqrt(np.diag(cov)[3:]), np.sqrt(np.diag(cov)[:3])

    cameras = []
    for c, camera in enumerate(scene.cameras):
        rig = int(scene.rig[c])
        T_world_rig = state.world[rig][0] if scene.bodies[rig].is_static and is_known(state.world[rig][0]) else None
        cov = solution.camera_cov[c]
        found = is_known(state.camera[c])
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
            T = state.tag[i] if is_known(state.tag[i]) else None
            position, rotation = sigmas(solution.tag_cov[i])
            tags.append(replace(scene.tags[i], T_body_tag=T, position_noise=position, rotation_noise=rotation))
        fixed = body.is_static and bool(is_known(state.world[b][0]))
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
