"""First poses of everything in a scene, from the known to the unknown.

What is seen together with something known becomes known: a body through its known tags, a rig through known tags
around it, then their unknown tags, then cameras that see what other cameras have placed. This may be at any time, so
no two cameras need a common view. A tag alone allows two poses (IPPE). The choice is left open until all cameras of
the time step, all sightings of the tag or camera, or the neighbours in time decide.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.rotations import geodesic_angle, matrix_to_quat, transform_inv
from tossid.settings.tracking import TrackSettings
from tossid.vision.pose_graph.resect import DISTINCT_ANGLE, Resection, resect
from tossid.vision.pose_graph.scene import Scene
from tossid.vision.pose_graph.state import State, given, is_known

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

DEFAULT = TrackSettings()
COST_RATIO = 3.0
"""Least ratio of two poses' squared residuals for the images alone to decide: errors that all sightings of a tag share
(of a lens model, of a print) add to both."""
LAST_RESORT = 2.0
"""Difference of squared residuals over the noise that decides where nothing else does."""


def initialise(scene: Scene, *, settings: TrackSettings = DEFAULT) -> State:
    """First poses of all that can be placed.

    Raises:
        InputError: No camera can be placed.
    """
    state = given(scene)
    while True:
        place(scene, state, settings=settings, refresh=True)
        if _statics(scene, state, settings, last_resort=False):
            continue
        place(scene, state, settings=settings, last_resort=True)
        if _statics(scene, state, settings, last_resort=False) or _statics(scene, state, settings, last_resort=True):
            continue
        if not _anchor(scene, state):
            break
    if not any(is_known(state.world[b]).any() and is_known(T) for b, T in zip(scene.rig, state.camera, strict=True)):
        raise InputError(
            "no camera can be placed: give the pose of a rig and of one camera on it, or of a body with a known tag"
        )
    return state


def place(
    scene: Scene, state: State, *, settings: TrackSettings, last_resort: bool = False, refresh: bool = False
) -> None:
    """Place bodies and rigs in the world, where enough around them is known.

    Args:
        scene: The sightings.
        state: The poses so far; changed.
        settings: When one of two poses is chosen.
        last_resort: Choose also where only weak evidence decides.
        refresh: Forget the poses of moving bodies first.
    """
    for b, body in enumerate(scene.bodies):
        if refresh and not body.is_static:
            if b in scene.rig and (scene.body == b).any():
                continue  # a rig with tags: which sightings placed it is not known
            state.world[b][:] = np.nan
        open_ = ~is_known(state.world[b])
        if not open_.any():
            continue
        on_body, on_rig = scene.body[scene.tag] == b, scene.rig[scene.camera] == b
        slot = np.zeros_like(scene.step) if body.is_static else scene.step
        usable = (
            is_known(state.camera)[scene.camera] & is_known(state.tag)[scene.tag] & (on_body ^ on_rig) & open_[slot]
        )
        other = state.at(np.where(on_body, scene.rig[scene.camera], scene.body[scene.tag]), scene.step)
        rows = np.flatnonzero(usable & is_known(other))
        if not len(rows):
            continue
        T_cam_rig, T_body_tag = transform_inv(state.camera[scene.camera[rows]]), state.tag[scene.tag[rows]]
        seen_from_world = on_body[rows]
        # of a body that is seen, the target is the body; of a rig that sees, the parent is the rig and the target
        # the world
        A = np.where(seen_from_world[:, None, None], T_cam_rig @ transform_inv(other[rows]), T_cam_rig)
        B = np.where(seen_from_world[:, None, None], T_body_tag, other[rows] @ T_body_tag)
        for seen, own in ((True, seen_from_world), (False, ~seen_from_world)):
            if not own.any():
                continue
            slots, group = np.unique(slot[rows[own]], return_inverse=True)
            found = resect(scene.sightings(rows[own], A[own], B[own], group), len(slots))
            if seen and not body.is_static:
                found = _with_hinges(scene, state, b, slots, found)
            chosen, sure = choose(
                found, scene.t[slots] if not body.is_static else None, settings, last_resort=last_resort
            )
            T = chosen if seen else transform_inv(chosen)
            new = sure & ~is_known(state.world[b][slots])
            state.world[b][slots[new]] = T[new]


def _with_hinges(scene: Scene, state: State, b: int, steps: Ints, found: Resection) -> Resection:
    """Both poses of a body, with the squared error of its hinges to bodies that are placed added to their costs."""
    hinge_cost, own = np.zeros((len(steps), 2)), scene.bodies[b]
    for other, body in enumerate(scene.bodies):
        if body.hinge is not None and body.hinge.parent == own.name:
            hinge, outward = body.hinge, False
        elif own.hinge is not None and own.hinge.parent == body.name:
            hinge, outward = own.hinge, True
        else:
            continue
        T_world_other = state.world[other][steps][:, None]
        pair = (T_world_other, found.T) if outward else (found.T, T_world_other)
        hinge_cost += np.nan_to_num(hinge.misfit(transform_inv(pair[0]) @ pair[1]))
    return found.ordered(found.cost + found.noise_scale() ** 2 * hinge_cost)  # costs are compared over the noise


def _statics(scene: Scene, state: State, settings: TrackSettings, *, last_resort: bool) -> int:
    """Place unknown tags on their bodies, or else an unknown camera on its rig; returns how many became known.

    Poses found before are fitted again to all sightings that are usable now. Cameras are placed one at a time, the one
    with the most sightings first, since the tags that two cameras see then place the next one better.
    """
    T_rig_body = transform_inv(state.at(scene.rig[scene.camera], scene.step)) @ state.at(
        scene.body[scene.tag], scene.step
    )
    placed, start = is_known(T_rig_body), given(scene)
    for what in ("tag", "camera"):
        index = scene.tag if what == "tag" else scene.camera
        poses, first = (state.tag, start.tag) if what == "tag" else (state.camera, start.camera)
        known = is_known(state.camera)[scene.camera] if what == "tag" else is_known(state.tag)[scene.tag]
        open_ = ~is_known(first)
        if what == "tag":
            open_[state.gauge] = False
        rows = np.flatnonzero(placed & known & open_[index])
        if not len(rows):
            continue
        eye = np.broadcast_to(np.eye(4), (len(rows), 4, 4))
        if what == "tag":
            A, B = transform_inv(state.camera[scene.camera[rows]]) @ T_rig_body[rows], eye
        else:
            A, B = eye, T_rig_body[rows] @ state.tag[scene.tag[rows]]
        which, group = np.unique(index[rows], return_inverse=True)
        found = resect(scene.sightings(rows, A, B, group), len(which))
        chosen, sure = choose(found, None, settings, last_resort=last_resort)
        new = sure & ~is_known(poses[which])
        if new.sum() > 1 and (last_resort or what == "camera"):
            merit = found.gain if last_resort else found.count.astype(float)
            sure &= ~new | (np.arange(len(sure)) == np.argmax(np.where(new, merit, -np.inf)))
            new &= sure
        poses[which[sure]] = chosen[sure] if what == "tag" else transform_inv(chosen[sure])
        if new.any():
            return int(new.sum())
    return 0


def _anchor(scene: Scene, state: State) -> bool:
    """Let the tag most often seen by placed cameras define the frame of a body none of whose tags is known."""
    placed = is_known(state.camera)[scene.camera] & is_known(state.at(scene.rig[scene.camera], scene.step))
    for b in np.unique(scene.body[scene.tag[placed]]):
        own = scene.body == b
        if not scene.bodies[b].is_static and not is_known(state.tag[own]).any():
            counts = np.bincount(scene.tag[placed], minlength=len(scene.tags))
            first = int(np.argmax(np.where(own, counts, -1)))
            state.tag[first] = np.eye(4)
            state.gauge.append(first)
            return True
    return False


def choose(
    found: Resection, t: Array | None, settings: TrackSettings, *, last_resort: bool = False
) -> tuple[Array, Bools]:
    """Which of the two poses each group has, (g, 4, 4), and for which groups that is certain, (g,).

    Args:
        found: The poses and their alternatives.
        t: Times [s], (g,), where the groups are one body's motion and certain poses decide their neighbours; else None.
        settings: What decides.
        last_resort: Neighbours further away decide too, and weak evidence where nothing else does.
    """
    gain = found.gain / found.noise_scale() ** 2
    sure = found.known & (gain > settings.evidence) & (found.cost[:, 1] > COST_RATIO * found.cost[:, 0])
    T = found.T[:, 0].copy()
    if t is not None:
        quat, other = (matrix_to_quat(found.T[:, k, :3, :3]) for k in (0, 1))
        reach = (10 if last_resort else 1) * settings.max_gap
        for order in (range(len(t)), range(len(t) - 1, -1, -1)):
            last = -1
            for i in order:
                if sure[i]:
                    last = i
                    continue
                if not found.known[i] or last < 0 or abs(t[i] - t[last]) > reach:
                    continue
                angles = geodesic_angle(np.stack([quat[i], other[i]]), quat[last])
                near, far = int(np.argmin(angles)), int(np.argmax(angles))
                allowed = 0.5 * DISTINCT_ANGLE + settings.max_spin * abs(t[i] - t[last])
                if angles[near] < allowed and angles[far] > (1.2 if last_resort else 2.0) * angles[near]:
                    sure[i], last = True, i
                    if near == 1:
                        T[i], quat[i] = found.T[i, 1], other[i]
    if last_resort:
        sure |= found.known & (gain > LAST_RESORT)
    return T, sure
