"""First poses of everything in a scene, from what is known outward.

Whatever is seen together with known things becomes known: a body through its known tags, a rig through known
tags around it, then their unknown tags, and cameras that see what other cameras have placed, at any time, so
that no two cameras need a common view. A tag alone allows two poses (IPPE); which one holds is left open until
all cameras of the time step, all sightings of a tag or a camera, or the neighbours in time decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.rotations import geodesic_angle, matrix_to_quat, transform_inv
from tossid.vision.resect import DIFFERENT, Resection, Sightings, resect
from tossid.vision.scene import Scene

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

HUNCH = 2.0
"""Difference in scaled squared residuals that decides between two poses where nothing else does."""

CLEAR = 3.0
"""Least ratio of squared residuals at which the images alone decide between two poses: errors that a tag's
sightings share (of a lens model, of a print) weigh on both."""


@dataclass(frozen=True, slots=True)
class Decisions:
    """When two poses are told apart.

    evidence: least difference in robust squared residuals (over the noise) for the images alone to decide.
    max_spin [rad/s]: turn between frames that is still believed. max_gap: longest time [s] over which a
    neighbour decides.
    """

    evidence: float = 25.0
    max_spin: float = 50.0
    max_gap: float = 0.06


DEFAULT = Decisions()


@dataclass(eq=False)
class State:
    """Poses of a scene; NaN where unknown.

    camera: (cameras, 4, 4) T_rig_cam. tag: (tags, 4, 4) T_body_tag. world: for each body T_world_body,
    (n, 4, 4) by time step if it moves, else (1, 4, 4). gauge: tags that define the frame of a body none of
    whose tags is known. prints: (tags, 3) how each tag differs from a flat square of its stated size (`factors`).
    """

    camera: Array
    tag: Array
    world: list[Array]
    prints: Array
    gauge: list[int] = field(default_factory=list)

    def at(self, body: Ints, step: Ints) -> Array:
        """T_world_body of each row's body in its step. (d, 4, 4)."""
        out = np.full((len(body), 4, 4), np.nan)
        for b, T in enumerate(self.world):
            own = body == b
            out[own] = T[step[own] if len(T) > 1 else np.zeros(own.sum(), dtype=np.int64)]
        return out

    def copy(self) -> State:
        """Another one to change."""
        return State(
            self.camera.copy(), self.tag.copy(), [T.copy() for T in self.world], self.prints.copy(), list(self.gauge)
        )


def there(T: Array) -> Bools:
    """Which poses are known. (*b, 4, 4) -> (*b,)."""
    return np.asarray(np.isfinite(T[..., 0, 0]))


def given(scene: Scene) -> State:
    """What the set-up says."""
    unknown = np.full((4, 4), np.nan)

    def stack(poses: Sequence[Array | None]) -> Array:
        return np.array([unknown if T is None else T for T in poses]).reshape(-1, 4, 4)

    world = []
    for body in scene.bodies:
        T = unknown if body.T_map_body is None else body.T_map_body
        # two rows at least tell a moving body from a static one
        world.append(T[None].copy() if body.is_static else np.full((max(len(scene.t), 2), 4, 4), np.nan))
    cameras, tags = stack([c.T_rig_cam for c in scene.cameras]), stack([t.T_body_tag for t in scene.tags])
    return State(cameras, tags, world, np.zeros((len(tags), 3)))


def initialise(scene: Scene, *, decisions: Decisions = DEFAULT) -> State:
    """First poses of all that can be placed.

    Raises:
        InputError: no camera can be placed at all.
    """
    state = given(scene)
    while True:
        place(scene, state, decisions=decisions, again=True)
        if _statics(scene, state, decisions, bold=False):
            continue
        place(scene, state, decisions=decisions, bold=True)
        if _statics(scene, state, decisions, bold=False) or _statics(scene, state, decisions, bold=True):
            continue
        if not _anchor(scene, state):
            break
    if not any(there(state.world[b]).any() and there(T) for b, T in zip(scene.rig, state.camera, strict=True)):
        raise InputError(
            "no camera can be placed: give the pose of a rig and of one camera on it, or of a body with a known tag"
        )
    return state


def place(scene: Scene, state: State, *, decisions: Decisions, bold: bool = False, again: bool = False) -> None:
    """Place bodies (and rigs) in the world by what is known of them.

    Args:
        bold: also where only a hunch tells two poses apart. again: place anew what moves and is known already.
    """
    for b, body in enumerate(scene.bodies):
        if again and not body.is_static:
            if b in scene.rig and (scene.body == b).any():
                continue  # both seeing and seen: there is no telling which sightings placed it
            state.world[b][:] = np.nan
        open_ = ~there(state.world[b])
        if not open_.any():
            continue
        on_body, on_rig = scene.body[scene.tag] == b, scene.rig[scene.camera] == b
        slot = np.zeros_like(scene.step) if body.is_static else scene.step
        usable = there(state.camera)[scene.camera] & there(state.tag)[scene.tag] & (on_body ^ on_rig) & open_[slot]
        other = state.at(np.where(on_body, scene.rig[scene.camera], scene.body[scene.tag]), scene.step)
        rows = np.flatnonzero(usable & there(other))
        if not len(rows):
            continue
        T_cam_rig, T_body_tag = transform_inv(state.camera[scene.camera[rows]]), state.tag[scene.tag[rows]]
        seen_from_world = on_body[rows]
        # seen: the target is the body. Seeing: the parent is the rig, and the target the world
        A = np.where(seen_from_world[:, None, None], T_cam_rig @ transform_inv(other[rows]), T_cam_rig)
        B = np.where(seen_from_world[:, None, None], T_body_tag, other[rows] @ T_body_tag)
        for seen, own in ((True, seen_from_world), (False, ~seen_from_world)):
            if not own.any():
                continue
            slots, group = np.unique(slot[rows[own]], return_inverse=True)
            found = _resect(scene, rows[own], A[own], B[own], group, len(slots))
            if seen and not body.is_static:
                found = _hung(scene, state, b, slots, found)
            chosen, sure = choose(found, scene.t[slots] if not body.is_static else None, decisions, bold=bold)
            T = chosen if seen else transform_inv(chosen)
            new = sure & ~there(state.world[b][slots])
            state.world[b][slots[new]] = T[new]


def _hung(scene: Scene, state: State, b: int, steps: Ints, found: Resection) -> Resection:
    """Both poses of a body judged also by how far they miss its hinges with bodies that are placed already."""
    miss, own = np.zeros((2, len(steps))), scene.bodies[b]
    for other, body in enumerate(scene.bodies):
        if body.hinge is not None and body.hinge.parent == own.name:
            hinge, outward = body.hinge, False
        elif own.hinge is not None and own.hinge.parent == body.name:
            hinge, outward = own.hinge, True
        else:
            continue
        T_world_other = state.world[other][steps]
        for row, T in enumerate((found.T, found.other)):
            pair = (T_world_other, T) if outward else (T, T_world_other)
            miss[row] += np.nan_to_num(hinge.miss(transform_inv(pair[0]) @ pair[1]))
    if not miss.any():
        return found
    miss *= noise_scale(found) ** 2  # as decisions are made on squares over the noise
    cost, other_cost = found.cost + miss[0], found.other_cost + miss[1]
    swap = found.ambiguous & (other_cost < cost)

    def swapped(a: Array, c: Array) -> tuple[Array, Array]:
        return np.where(_along(swap, a), c, a), np.where(_along(swap, a), a, c)

    (T, other_T), (cost, other_cost) = swapped(found.T, found.other), swapped(cost, other_cost)
    information, other_information = swapped(found.information, found.other_information)
    return Resection(
        T, information, cost, found.known, other_T, other_information, other_cost, found.ambiguous, found.count
    )


def _along(rows: Bools, values: Array) -> Bools:
    """Rows as a mask that broadcasts over values."""
    return rows.reshape(-1, *(1,) * (values.ndim - 1))


def _resect(scene: Scene, rows: Ints, A: Array, B: Array, group: Ints, n: int) -> Resection:
    order = np.argsort(group, kind="stable")
    rows = rows[order]
    whiten = scene.whiten[rows] / np.sqrt(scene.count[rows])[:, None, None, None]
    sightings = Sightings(
        group[order], A[order], B[order], scene.half[rows], scene.seen[rows], whiten, scene.T_cam_tag[rows]
    )
    return resect(sightings, n)


def _statics(scene: Scene, state: State, decisions: Decisions, *, bold: bool) -> int:
    """Place unknown tags on their bodies, or else an unknown camera on its rig; returns how many became known.

    What was found before is found anew, by all that sees it now. Of cameras the one with the most to go by is
    placed, one at a time, as the tags that two cameras see then place the next one better.
    """
    T_rig_body = transform_inv(state.at(scene.rig[scene.camera], scene.step)) @ state.at(
        scene.body[scene.tag], scene.step
    )
    placed, start = there(T_rig_body), given(scene)
    for what in ("tag", "camera"):
        index = scene.tag if what == "tag" else scene.camera
        poses, first = (state.tag, start.tag) if what == "tag" else (state.camera, start.camera)
        known = there(state.camera)[scene.camera] if what == "tag" else there(state.tag)[scene.tag]
        open_ = ~there(first)
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
        found = _resect(scene, rows, A, B, group, len(which))
        chosen, sure = choose(found, None, decisions, bold=bold)
        new = sure & ~there(poses[which])
        if new.sum() > 1 and (bold or what == "camera"):
            merit = found.gain if bold else found.count.astype(float)
            sure &= ~new | (np.arange(len(sure)) == np.argmax(np.where(new, merit, -np.inf)))
            new &= sure
        poses[which[sure]] = chosen[sure] if what == "tag" else transform_inv(chosen[sure])
        if new.any():
            return int(new.sum())
    return 0


def _anchor(scene: Scene, state: State) -> bool:
    """Let the tag most often seen by placed cameras define the frame of a body none of whose tags is known."""
    placed = there(state.camera)[scene.camera] & there(state.at(scene.rig[scene.camera], scene.step))
    for b in np.unique(scene.body[scene.tag[placed]]):
        own = scene.body == b
        if not scene.bodies[b].is_static and not there(state.tag[own]).any():
            counts = np.bincount(scene.tag[placed], minlength=len(scene.tags))
            first = int(np.argmax(np.where(own, counts, -1)))
            state.tag[first] = np.eye(4)
            state.gauge.append(first)
            return True
    return False


def choose(found: Resection, t: Array | None, decisions: Decisions, *, bold: bool = False) -> tuple[Array, Bools]:
    """Which pose of each group holds, and for which groups that is sure.

    Args:
        t: (g,) times [s] where the groups are one motion: its sure poses then decide their neighbours.
        bold: where all else fails, neighbours further away decide, and hunches.
    """
    noise2 = noise_scale(found) ** 2
    gain = found.gain / noise2
    clear = (gain > decisions.evidence) & (found.other_cost > CLEAR * found.cost)
    sure = found.known & (clear | ~found.ambiguous)
    T = found.T.copy()
    if t is not None:
        quat, other = matrix_to_quat(T[:, :3, :3]), matrix_to_quat(found.other[:, :3, :3])
        reach = (10 if bold else 1) * decisions.max_gap
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
                allowed = 0.5 * DIFFERENT + decisions.max_spin * abs(t[i] - t[last])
                if angles[near] < allowed and angles[far] > (1.2 if bold else 2.0) * angles[near]:
                    sure[i], last = True, i
                    if near == 1:
                        T[i], quat[i] = found.other[i], other[i]
    if bold:
        sure |= found.known & (gain > HUNCH)
    return T, sure


def noise_scale(found: Resection) -> float:
    """Residuals over their promised size: root of the median over groups of χ² by its degrees of freedom."""
    freedom = 8.0 * found.count - 6
    enough = found.known
    if enough.sum() < 5:
        return 1.0
    ratio = found.cost[enough] / (freedom[enough] * (1 - 2 / (9 * freedom[enough])) ** 3)
    return float(np.clip(np.sqrt(np.median(ratio)), 0.05, 30.0))
