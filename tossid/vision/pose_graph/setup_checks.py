"""Which parts of a set-up contradict the images: moved tags, tags of another size, moved or swapped cameras, lenses."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from tossid.rotations import geodesic_angle, matrix_to_quat, transform_inv
from tossid.vision.cameras.camera import Camera
from tossid.vision.pose_graph.corner_projection import whitened_sizes
from tossid.vision.pose_graph.resect import Sightings, huber_loss, resect
from tossid.vision.pose_graph.scene import Scene, swapped
from tossid.vision.pose_graph.state import State, is_known

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

UNITS = (1.0, 1e-3, 1e-2, 0.0254, 10.0, 100.0, 1e3)
"""By what a size may be wrong before it is measured wrongly: in mm, cm, inches, or taken for one of these."""
STEPS, FEWEST_STEPS = 200, 20
"""Time steps that are used, and below which nothing is tried."""
FEWEST_SIGHTINGS = 5
"""Sightings by or of a suspect below which nothing is said of it."""
LEAST_DISTANCE, LEAST_ANGLE = 0.001, np.deg2rad(0.3)
"""What is off by less than both [m, rad] is not reported."""
MISFIT_SHARE = 0.75
"""Correcting the suspect must bring the misfit of the rest below this share of what it was."""
MOST_SUSPECTS = 4
"""Of a body."""
FOCAL_STEP, CENTER_STEP = 0.005, 2.0
"""Steps of the focal lengths, as a share, and of the principal points [px] that are tried; 20 to either side."""
WRONG_SIZE = 0.03
"""Share by which tags have to be larger or smaller than stated to be reported; ink spreads by less."""


@dataclass(frozen=True, slots=True)
class Suspect:
    """A part of the set-up that the images contradict.

    Attributes:
        kind: "tag", "size", "camera", "swapped" or "intrinsics".
        name: The tag's id or the camera's name; both cameras' names where they are swapped; the body's name where all
            its tags have another size.
        message: In words.
        distance: How far it is from its stated place [m]; None where that is not what is wrong.
        angle: Likewise [rad].
    """

    kind: str
    name: str
    message: str
    distance: float | None = None
    angle: float | None = None


@dataclass(frozen=True, eq=False)
class _Trial:
    """The sightings that a hypothesis leaves, and a body's poses in its rig by step, (n, 4, 4)."""

    scene: Scene
    steps: Ints
    T_rig_body: Array
    misfit: float


def check_set_up(scene: Scene, state: State) -> list[Suspect]:
    """Everything suspect, what explains most first.

    For each body that one rig's cameras see, its poses are fitted again without each tag, without each camera, with
    each pair of cameras swapped, and with tags of another size. The change that reduces the misfit most is reported, if
    it reduces it enough. The rest is then checked again.

    Args:
        scene: The sightings.
        state: Poses of cameras and tags as given (`initial.given`); unknown ones are not judged.
    """
    found: list[Suspect] = []
    for b, body in enumerate(scene.bodies):
        on = (scene.body[scene.tag] == b) & is_known(state.tag)[scene.tag] & is_known(state.camera)[scene.camera]
        rigs = np.unique(scene.rig[scene.camera[on]])
        if len(rigs) != 1 or (body.is_static and scene.bodies[rigs[0]].is_static):
            continue
        left = scene.take(_sample(scene, np.flatnonzero(on), STEPS))
        while len(found) < MOST_SUSPECTS:
            suspect, left = _worst(left, state)
            if suspect is None:
                break
            found.append(suspect)
    return found


def _sample(scene: Scene, rows: Ints, most: int) -> Ints:
    """Rows of at most so many time steps: of each stretch of the recording, the step with the most rows."""
    counts = np.bincount(scene.step[rows], minlength=len(scene.t))
    steps = np.flatnonzero(counts >= 2)
    if len(steps) > most:
        steps = np.array([stretch[np.argmax(counts[stretch])] for stretch in np.array_split(steps, most)])
    return rows[np.isin(scene.step[rows], steps)]


def _worst(scene: Scene, state: State) -> tuple[Suspect | None, Scene]:
    """The worst suspect, and the scene without it."""
    base = _trial(scene, state)
    if base is None:
        return None, scene
    tags, cameras = (np.unique(index).tolist() for index in (scene.tag, scene.camera))
    trials: list[tuple[str, tuple[int, ...], _Trial | None]] = []
    for i in tags if len(tags) > 2 else ():
        trials.append(("tag", (i,), _trial(scene.take(np.flatnonzero(scene.tag != i)), state)))
    for c in cameras if len(cameras) > 1 else ():
        trials.append(("camera", (c,), _trial(scene.take(np.flatnonzero(scene.camera != c)), state)))
    for a, c in itertools.combinations(cameras, 2):
        trials.append(("swapped", (a, c), _trial(swapped(scene, a, c), state)))
    factor = _best_factor(lambda factor: _misfit(_trial(_resized(scene, factor), state)))
    trials.append(("size", (), _trial(_resized(scene, factor), state)))
    made = [(kind, what, trial) for kind, what, trial in trials if trial is not None]
    if not made:
        return None, scene
    kind, what, trial = min(made, key=lambda one: one[2].misfit)
    if trial.misfit > MISFIT_SHARE * base.misfit:
        return None, scene
    if kind == "size":
        body = scene.bodies[scene.body[scene.tag[0]]].name
        return _sized(factor, body, f"tags on {body}"), trial.scene
    names = " and ".join(
        scene.cameras[c].name for c in (cameras if kind == "camera" else what if kind != "tag" else ())
    )
    if kind == "swapped":
        return Suspect(kind, names, f"cameras {names} are swapped"), trial.scene
    out = scene.take(np.flatnonzero((scene.tag if kind == "tag" else scene.camera) == what[0]))
    out = out.take(np.flatnonzero(np.isin(out.step, trial.steps)))
    if len(out.step) < FEWEST_SIGHTINGS:
        return None, scene
    T_rig_body = trial.T_rig_body[np.searchsorted(trial.steps, out.step)]
    if kind == "tag":
        return _moved_tag(out, state, T_rig_body, what[0]), trial.scene
    if len(cameras) == 2:
        return Suspect("camera", names, f"cameras {names} do not agree"), trial.scene
    return _wrong_camera(out, state, T_rig_body, what[0]), trial.scene


def _trial(scene: Scene, state: State) -> _Trial | None:
    """A fit of a body's poses; None where too few steps are left."""
    counts = np.bincount(scene.step, minlength=len(scene.t))
    scene = scene.take(np.flatnonzero(counts[scene.step] >= 2))
    steps, group = np.unique(scene.step, return_inverse=True)
    if len(steps) < FEWEST_STEPS:
        return None
    T_cam_rig, T_body_tag = transform_inv(state.camera[scene.camera]), state.tag[scene.tag]
    poses = resect(scene.sightings(np.arange(len(group)), T_cam_rig, T_body_tag, group), len(steps))
    # the mean without the worst twentieth, since single frames may be wrong in any set-up
    each = np.sort((poses.cost[:, 0] / (8.0 * poses.count - 6))[poses.known])
    misfit = float(np.mean(each[: max(int(0.95 * len(each)), 1)])) if len(each) else float("inf")
    return _Trial(scene, steps[poses.known], poses.T[poses.known, 0], misfit)


def _misfit(trial: _Trial | None) -> float:
    return float("inf") if trial is None else trial.misfit


def _best_factor(cost: Callable[[float], float]) -> float:
    """The factor on tags' sizes that costs least: near one of `UNITS`, then to a thousandth."""
    about = min(UNITS, key=cost)
    found = minimize_scalar(
        lambda log: cost(float(np.exp(log))), bounds=np.log([0.4 * about, 2.5 * about]), options={"xatol": 1e-3}
    )
    return float(np.exp(found.x))


def _resized(scene: Scene, factor: float) -> Scene:
    """The scene with tags so many times as large: each alone, a tag is then as much farther away."""
    T_cam_tag = scene.T_cam_tag.copy()
    T_cam_tag[..., :3, 3] *= factor
    return replace(scene, tags=tuple(replace(tag, size=tag.size * factor) for tag in scene.tags), T_cam_tag=T_cam_tag)


def _sized(factor: float, name: str, what: str) -> Suspect | None:
    """Tags of another size than stated; None where that is by little."""
    if abs(np.log(factor)) < WRONG_SIZE:
        return None
    ratio = f"{factor:.2f}" if 0.1 < factor < 10 else f"{factor:.3g}"
    return Suspect(
        "size",
        name,
        f"{what} appear{'s' * what.startswith('tag ')} {ratio} times as large as stated; a size is the length of "
        "the black border's outer edge, in metres",
    )


def _moved_tag(scene: Scene, state: State, T_rig_body: Array, tag: int) -> Suspect | None:
    """A tag whose place or size differs from the stated one by the poses that the other tags give."""
    A, rows = transform_inv(state.camera[scene.camera]) @ T_rig_body, np.arange(len(T_rig_body))
    refitted = resect(scene.sightings(rows, A, np.eye(4), 0 * rows), 1)
    name, body = str(scene.tags[tag].id), scene.bodies[scene.body[tag]].name

    def cost(factor: float) -> float:
        return _cost(_resized(scene, factor).sightings(rows, A, np.eye(4), 0 * rows), state.tag[tag])

    factor = _best_factor(cost)
    if cost(factor) < refitted.cost[0, 0]:
        return _sized(factor, name, f"tag {name} on {body}")
    far, turn = _apart(refitted.T[0, 0], state.tag[tag])
    if far < LEAST_DISTANCE and turn < LEAST_ANGLE:
        return None
    message = f"tag {name} is {far * 1e3:.1f} mm and {np.rad2deg(turn):.1f}° from where it is said to be on {body}"
    return Suspect("tag", name, message, far, turn)


def _cost(s: Sightings, T: Array) -> float:
    """Robust sum of squared whitened residuals under a given pose (4, 4)."""
    size = whitened_sizes(s.T_cam_parent @ T, s.points, s.seen, np.ascontiguousarray(s.whiten))
    return float(np.sum(huber_loss(size)))


def _wrong_camera(scene: Scene, state: State, T_rig_body: Array, c: int) -> Suspect | None:
    """A camera whose sightings another pose or other intrinsics explain, given the poses that the others see."""
    B, rows = T_rig_body @ state.tag[scene.tag], np.arange(len(T_rig_body))
    name, model = scene.cameras[c].name, scene.cameras[c]
    refitted = resect(scene.sightings(rows, np.eye(4), B, 0 * rows), 1)

    def cost(lens: Camera) -> float:
        s = replace(scene, seen=lens.undistort(scene.pixels)).sightings(rows, np.eye(4), B, 0 * rows)
        return _cost(s, transform_inv(state.camera[c]))

    best = (np.inf, "", 0.0)
    for what, step in (
        ("focal length", FOCAL_STEP),
        ("principal point's x", CENTER_STEP),
        ("principal point's y", CENTER_STEP),
    ):
        amounts = step * np.arange(-20, 21)
        costs = [cost(_changed(model, what, amount)) for amount in amounts]
        best = min(best, (min(costs), what, float(amounts[int(np.argmin(costs))])))
    if best[0] < refitted.cost[0, 0]:
        size = f"{best[2] * 100:+.1f} %" if best[1] == "focal length" else f"{best[2]:+.0f} px"
        return Suspect("intrinsics", name, f"camera {name}'s images fit another {best[1]} ({size})")
    far, turn = _apart(transform_inv(refitted.T[0, 0]), state.camera[c])
    message = f"camera {name} is {far * 1e3:.0f} mm and {np.rad2deg(turn):.1f}° from where it is said to be"
    return Suspect("camera", name, message, far, turn) if far > LEAST_DISTANCE or turn > LEAST_ANGLE else None


def _apart(A: Array, B: Array) -> tuple[float, float]:
    """Distance [m] and angle [rad] between two poses."""
    turn = geodesic_angle(matrix_to_quat(A[:3, :3]), matrix_to_quat(B[:3, :3]))
    return float(np.linalg.norm(A[:3, 3] - B[:3, 3])), float(turn)


def _changed(camera: Camera, what: str, amount: float) -> Camera:
    intrinsics = camera.intrinsics.copy()
    if what == "focal length":
        intrinsics[:2] *= 1 + amount
    else:
        intrinsics[2 if what.endswith("x") else 3] += amount
    return replace(camera, intrinsics=intrinsics)
