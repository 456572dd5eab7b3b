"""What of a set-up contradicts the images: tags that moved, cameras that did, or were swapped, wrong intrinsics."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import geodesic_angle, matrix_to_quat, transform_inv
from tossid.vision.camera import Camera
from tossid.vision.initial import State, there
from tossid.vision.resect import HUBER, Sightings, resect, residuals
from tossid.vision.scene import Scene, swapped

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

STEPS = 200
"""So many time steps are looked at."""
FAR, TURNED = 0.001, np.deg2rad(0.3)
"""What is off by less than both [m, rad] is not told."""
BETTER = 0.75
"""What is wrong must, left out or put right, bring the misfit of the rest below so much of what it was."""
MOST = 4
"""Most suspects."""
LENS = (("focal length", 0.005), ("principal point's x", 2.0), ("principal point's y", 2.0))
"""Intrinsics that are tried, and by how much (relative, px)."""


@dataclass(frozen=True, slots=True)
class Suspect:
    """Something in the set-up that the images contradict.

    kind: "tag", "camera", "swapped" or "intrinsics". name: the tag's id or camera's name (two, for swapped ones).
    message: in words. distance [m], angle [rad]: how far off it is, None where that is not what is wrong.
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

    For each body among the cameras of one rig, its poses are fitted again without each tag, without each camera
    and with each two cameras swapped. What mends most, if that is much, is wrong; then the rest is looked at again.

    Args:
        state: poses of cameras and tags as given (`initial.given`); what is unknown there is not judged.
    """
    found: list[Suspect] = []
    for b, body in enumerate(scene.bodies):
        on = (scene.body[scene.tag] == b) & there(state.tag)[scene.tag] & there(state.camera)[scene.camera]
        rigs = np.unique(scene.rig[scene.camera[on]])
        if len(rigs) != 1 or (body.is_static and scene.bodies[rigs[0]].is_static):
            continue
        left = scene.take(_sample(scene, np.flatnonzero(on)))
        while len(found) < MOST:
            suspect, left = _worst(left, state)
            if suspect is None:
                break
            found.append(suspect)
    return found


def _sample(scene: Scene, rows: Ints) -> Ints:
    """Rows of at most `STEPS` time steps, of each stretch that with the most of them."""
    counts = np.bincount(scene.step[rows], minlength=len(scene.t))
    steps = np.flatnonzero(counts >= 2)
    if len(steps) > STEPS:
        steps = np.array([stretch[np.argmax(counts[stretch])] for stretch in np.array_split(steps, STEPS)])
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
    made = [(kind, what, trial) for kind, what, trial in trials if trial is not None]
    if not made:
        return None, scene
    kind, what, trial = min(made, key=lambda one: one[2].misfit)
    if trial.misfit > BETTER * base.misfit:
        return None, scene
    names = " and ".join(
        scene.cameras[c].name for c in (cameras if kind == "camera" else what if kind != "tag" else ())
    )
    if kind == "swapped":
        return Suspect(kind, names, f"cameras {names} are swapped"), trial.scene
    out = scene.take(np.flatnonzero((scene.tag if kind == "tag" else scene.camera) == what[0]))
    out = out.take(np.flatnonzero(np.isin(out.step, trial.steps)))
    if len(out.step) < 5:
        return None, scene
    T_rig_body = trial.T_rig_body[np.searchsorted(trial.steps, out.step)]
    if kind == "tag":
        return _moved_tag(out, state, T_rig_body, what[0]), trial.scene
    if len(cameras) == 2:
        return Suspect("camera", names, f"cameras {names} do not agree"), trial.scene
    return _wrong_camera(out, state, T_rig_body, what[0]), trial.scene


def _trial(scene: Scene, state: State) -> _Trial | None:
    """Fit a body's poses; None where too little is left to judge by."""
    counts = np.bincount(scene.step, minlength=len(scene.t))
    scene = scene.take(np.flatnonzero(counts[scene.step] >= 2))
    steps, group = np.unique(scene.step, return_inverse=True)
    if len(steps) < 20:
        return None
    poses = resect(
        _sightings(scene, transform_inv(state.camera[scene.camera]), state.tag[scene.tag], group), len(steps)
    )
    # the mean without the worst twentieth: frames go wrong by themselves
    each = np.sort((poses.cost / (8.0 * poses.count - 6))[poses.known])
    misfit = float(np.mean(each[: max(int(0.95 * len(each)), 1)])) if len(each) else float("inf")
    return _Trial(scene, steps[poses.known], poses.T[poses.known], misfit)


def _sightings(scene: Scene, A: Array, B: Array, group: Ints, seen: Array | None = None) -> Sightings:
    order = np.argsort(group, kind="stable")
    whiten = scene.whiten / np.sqrt(scene.count)[:, None, None, None]
    corners = scene.seen if seen is None else seen
    arrays = (A, B, scene.half, corners, whiten, scene.T_cam_tag)
    return Sightings(group[order], *(array[order] for array in arrays))


def _moved_tag(scene: Scene, state: State, T_rig_body: Array, tag: int) -> Suspect | None:
    """Where the others say that a tag is; None if that is where it should be."""
    A, group = transform_inv(state.camera[scene.camera]) @ T_rig_body, np.zeros(len(T_rig_body), dtype=np.int64)
    T = resect(_sightings(scene, A, np.broadcast_to(np.eye(4), A.shape), group), 1).T[0]
    far, turn = _apart(T, state.tag[tag])
    if far < FAR and turn < TURNED:
        return None
    name, body = str(scene.tags[tag].id), scene.bodies[scene.body[tag]].name
    message = f"tag {name} is {far * 1e3:.1f} mm and {np.rad2deg(turn):.1f}° from where it is said to be on {body}"
    return Suspect("tag", name, message, far, turn)


def _wrong_camera(scene: Scene, state: State, T_rig_body: Array, c: int) -> Suspect | None:
    """Whether another pose or other intrinsics explain what a camera sees of the poses that the others see."""
    B, group = T_rig_body @ state.tag[scene.tag], np.zeros(len(T_rig_body), dtype=np.int64)
    eye, name, model = np.broadcast_to(np.eye(4), B.shape), scene.cameras[c].name, scene.cameras[c]
    T_cam_rig = transform_inv(state.camera[c])
    elsewhere = resect(_sightings(scene, eye, B, group), 1)

    def cost(lens: Camera) -> float:
        s = _sightings(scene, eye, B, group, lens.undistort(scene.pixels))
        r, _ = residuals(s, np.broadcast_to(T_cam_rig, B.shape))
        size = np.linalg.norm(np.squeeze(s.whiten @ np.nan_to_num(r, nan=1e3)[..., None], -1), axis=-1)
        return float(np.sum(np.where(size <= HUBER, size**2, 2 * HUBER * size - HUBER**2)))

    best = (np.inf, "", 0.0)
    for what, step in LENS:
        amounts = step * np.arange(-20, 21)
        costs = [cost(_changed(model, what, amount)) for amount in amounts]
        best = min(best, (min(costs), what, float(amounts[int(np.argmin(costs))])))
    if best[0] < elsewhere.cost[0]:
        size = f"{best[2] * 100:+.1f} %" if best[1] == "focal length" else f"{best[2]:+.0f} px"
        return Suspect("intrinsics", name, f"camera {name}'s images fit another {best[1]} ({size})")
    far, turn = _apart(transform_inv(elsewhere.T[0]), state.camera[c])
    message = f"camera {name} is {far * 1e3:.0f} mm and {np.rad2deg(turn):.1f}° from where it is said to be"
    return Suspect("camera", name, message, far, turn) if far > FAR or turn > TURNED else None


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
