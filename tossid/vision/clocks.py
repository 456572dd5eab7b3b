"""How far cameras' clocks are apart, from what they see of the same motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import matrix_to_quat, quat_boxminus, quat_exp, quat_mul, transform, transform_inv
from tossid.vision.initial import Decisions, State, choose, there
from tossid.vision.resect import Sightings, resect, residuals
from tossid.vision.scene import Scene

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

REACH = 0.25
"""Largest offset that is looked for [s]."""
BLOCKS, BLOCK = 10, 120
"""So many stretches of so many time steps are looked at."""
SOFT = 5.0
"""Reprojection at which a corner hardly counts any more [px]."""
GAIN = 0.6
"""An offset must bring the misfit below so much of what it is without."""
SAME = 0.0005
"""Clocks that are no further apart are one [s]."""


def clock_offsets(scene: Scene, state: State, *, decisions: Decisions) -> dict[int, float]:
    """Offsets of cameras' clocks against most of them [s]: how much later than theirs a frame's time stamp is,
    to a fraction of a frame, where what moves tells one that is not zero.

    The camera that sees most gives the motion of a body alone, and that, taken at other times, is projected into
    the others. Cameras and tags must be known, and frames follow each other within `decisions.max_gap`.

    Args:
        state: poses of cameras, tags and static bodies (`initial.given`).
    """
    found: dict[int, float] = {}
    n = len(scene.t)
    starts = np.linspace(0, max(n - BLOCK, 0), BLOCKS).astype(np.int64)
    looked = np.zeros(n, dtype=bool)
    for start in starts:
        looked[start : start + BLOCK] = True
    T_world_rig = state.at(scene.rig[scene.camera], scene.step)
    usable = looked[scene.step] & there(state.camera)[scene.camera] & there(T_world_rig)
    usable &= there(state.tag)[scene.tag] & (scene.count == 1)
    for b, body in enumerate(scene.bodies):
        rows = np.flatnonzero(usable & (scene.body[scene.tag] == b))
        if body.is_static or not len(rows):
            continue
        counts = np.bincount(scene.camera[rows], minlength=len(scene.cameras))
        reference = int(np.argmax(counts))
        t, T = _alone(scene, state, rows[scene.camera[rows] == reference], T_world_rig, decisions)
        if len(t) < 20:
            continue
        for c in np.flatnonzero(counts >= 40):
            if c != reference and int(c) not in found:
                offset = _offset(scene, state, rows[scene.camera[rows] == c], T_world_rig, t, T, decisions)
                if offset is not None:
                    found[int(c)] = offset
        if found:
            clocks = {int(c): found.get(int(c), 0.0) for c in np.flatnonzero(counts)}
            # the clock that most agree on is the right one, among two the first camera's
            agreed = min(clocks.values(), key=lambda one: sum(abs(one - other) > SAME for other in clocks.values()))
            found = {c: offset - agreed for c, offset in clocks.items() if abs(offset - agreed) > SAME}
    return found


def _sightings(scene: Scene, state: State, rows: Ints, T_world_rig: Array, group: Ints) -> Sightings:
    T_cam_world = transform_inv(T_world_rig[rows] @ state.camera[scene.camera[rows]])
    return Sightings(
        group,
        T_cam_world,
        state.tag[scene.tag[rows]],
        scene.half[rows],
        scene.seen[rows],
        scene.whiten[rows],
        scene.T_cam_tag[rows],
    )


def _alone(scene: Scene, state: State, rows: Ints, T_world_rig: Array, decisions: Decisions) -> tuple[Array, Array]:
    """A body's motion by one camera: times (m,) and T_world_body (m, 4, 4)."""
    if not len(rows):
        return np.zeros(0), np.zeros((0, 4, 4))
    steps, group = np.unique(scene.step[rows], return_inverse=True)
    poses = resect(_sightings(scene, state, rows, T_world_rig, group), len(steps))
    t = scene.t[steps] + scene.late[rows[np.searchsorted(group, np.arange(len(steps)))]]
    T, sure = choose(poses, t, decisions)
    return t[sure], T[sure]


def _offset(
    scene: Scene, state: State, rows: Ints, T_world_rig: Array, t: Array, T: Array, decisions: Decisions
) -> float | None:
    """The offset at which a motion fits one camera's sightings best, None if it is not told from zero."""
    s = _sightings(scene, state, rows, T_world_rig, np.arange(len(rows)))
    own = scene.t[scene.step[rows]] + scene.late[rows]

    def misfit(offset: float) -> tuple[float, int]:
        pose, good = _between(t, T, own - offset, decisions.max_gap)
        if not good.any():
            return np.inf, 0
        r, _ = residuals(s.take(good), pose[good])
        square = np.sum(np.squeeze(scene.to_pixels[rows[good]] @ r[..., None], -1) ** 2, axis=-1)
        return float(np.mean(np.nan_to_num(square / (square + SOFT**2), nan=1.0))), int(good.sum())

    grid = np.arange(-REACH, REACH + 1e-9, 0.004)
    curve, counts = np.array([misfit(offset) for offset in grid]).T
    curve[counts < 0.5 * counts.max()] = np.inf
    best = float(grid[np.argmin(curve)])
    for step in (0.001, 0.00025):
        near = best + step * np.arange(-4, 5)
        best = float(near[np.argmin([misfit(offset)[0] for offset in near])])
    return best if misfit(best)[0] < GAIN * misfit(0.0)[0] and abs(best) > SAME else None


def _between(t: Array, T: Array, at: Array, max_gap: float) -> tuple[Array, NDArray[np.bool_]]:
    """Poses of a motion at some times, and where it has them: between samples no further apart than `max_gap`."""
    after = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    before = after - 1
    step = t[after] - t[before]
    share = (at - t[before]) / step
    good = (share >= 0) & (share <= 1) & (step <= max_gap)
    share = np.clip(share, 0, 1)[:, None]
    quat = matrix_to_quat(T[:, :3, :3])
    turn = quat_mul(quat[before], quat_exp(share * quat_boxminus(quat[after], quat[before])))
    return transform(T[before, :3, 3] * (1 - share) + T[after, :3, 3] * share, turn), np.asarray(good)
