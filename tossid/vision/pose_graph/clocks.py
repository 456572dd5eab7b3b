"""Offsets between cameras' clocks, from what they see of the same motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import matrix_to_quat, quat_boxminus, quat_exp, quat_mul, transform, transform_inv
from tossid.settings.tracking import TrackSettings
from tossid.vision.pose_graph.initial import State, choose, is_known
from tossid.vision.pose_graph.resect import Sightings, resect, residuals
from tossid.vision.pose_graph.scene import Scene

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


def clock_offsets(scene: Scene, state: State, *, settings: TrackSettings) -> dict[int, float]:
    """Offsets of cameras' clocks [s] by camera's number: how much later than most cameras' a frame's time stamp is.

    Only offsets that differ from zero are given. The camera that sees most gives the motion of a body alone. That
    motion, taken at shifted times, is projected into each other camera. Cameras and tags must be known, and frames must
    follow each other within `max_gap`.

    Args:
        scene: The sightings.
        state: Poses of cameras, tags and static bodies (`initial.given`).
        settings: Of the search.
    """
    search = settings.clock_search
    found: dict[int, float] = {}
    n = len(scene.t)
    starts = np.linspace(0, max(n - search.stretch_steps, 0), search.stretches).astype(np.int64)
    sampled = np.zeros(n, dtype=bool)
    for start in starts:
        sampled[start : start + search.stretch_steps] = True
    T_world_rig = state.at(scene.rig[scene.camera], scene.step)
    usable = sampled[scene.step] & is_known(state.camera)[scene.camera] & is_known(T_world_rig)
    usable &= is_known(state.tag)[scene.tag] & (scene.count == 1)
    for b, body in enumerate(scene.bodies):
        rows = np.flatnonzero(usable & (scene.body[scene.tag] == b))
        if body.is_static or not len(rows):
            continue
        counts = np.bincount(scene.camera[rows], minlength=len(scene.cameras))
        reference = int(np.argmax(counts))
        t, T = _alone(scene, state, rows[scene.camera[rows] == reference], T_world_rig, settings)
        if len(t) < search.fewest_steps:
            continue
        for c in np.flatnonzero(counts >= search.fewest_sightings):
            if c != reference and int(c) not in found:
                offset = _offset(scene, state, rows[scene.camera[rows] == c], T_world_rig, t, T, settings)
                if offset is not None:
                    found[int(c)] = offset
        if found:
            clocks = {int(c): found.get(int(c), 0.0) for c in np.flatnonzero(counts)}
            # the offset that most cameras share counts as zero; of two cameras, the first one's
            agreed = min(
                clocks.values(), key=lambda one: sum(abs(one - other) > search.same for other in clocks.values())
            )
            found = {c: offset - agreed for c, offset in clocks.items() if abs(offset - agreed) > search.same}
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


def _alone(scene: Scene, state: State, rows: Ints, T_world_rig: Array, settings: TrackSettings) -> tuple[Array, Array]:
    """A body's motion by one camera: times (m,) and T_world_body (m, 4, 4)."""
    if not len(rows):
        return np.zeros(0), np.zeros((0, 4, 4))
    steps, group = np.unique(scene.step[rows], return_inverse=True)
    poses = resect(_sightings(scene, state, rows, T_world_rig, group), len(steps), settings=settings.resection)
    t = scene.t[steps] + scene.delay[rows[np.searchsorted(group, np.arange(len(steps)))]]
    T, certain = choose(poses, t, settings)
    return t[certain], T[certain]


def _offset(
    scene: Scene, state: State, rows: Ints, T_world_rig: Array, t: Array, T: Array, settings: TrackSettings
) -> float | None:
    """The offset at which a motion fits one camera's sightings best, None if zero fits nearly as well."""
    search, motion = settings.clock_search, _Motion(t, T)
    s = _sightings(scene, state, rows, T_world_rig, np.arange(len(rows)))
    own = scene.t[scene.step[rows]] + scene.delay[rows]

    def misfit(offset: float) -> tuple[float, int]:
        pose, good = motion.at(own - offset, settings.max_gap)
        if not good.any():
            return np.inf, 0
        r, _ = residuals(s.take(good), pose[good])
        square = np.sum(np.squeeze(scene.to_pixels[rows[good]] @ r[..., None], -1) ** 2, axis=-1)
        return float(np.mean(np.nan_to_num(square / (square + search.soft_pixels**2), nan=1.0))), int(good.sum())

    grid = np.arange(-search.reach, search.reach + 1e-9, search.steps[0])
    curve, counts = np.array([misfit(offset) for offset in grid]).T
    curve[counts < 0.5 * counts.max()] = np.inf
    best = float(grid[np.argmin(curve)])
    for step in search.steps[1:]:
        near = best + step * np.arange(-4, 5)
        best = float(near[np.argmin([misfit(offset)[0] for offset in near])])
    better = misfit(best)[0] < search.misfit_share * misfit(0.0)[0]
    return best if better and abs(best) > search.same else None


class _Motion:
    """Poses of a body over time, interpolated."""

    def __init__(self, t: Array, T: Array) -> None:
        """Through T_world_body (m, 4, 4) at times (m,) [s], in order."""
        self._t, self._position = t, T[:, :3, 3]
        self._quat = matrix_to_quat(T[:, :3, :3])
        self._turn = quat_boxminus(self._quat[1:], self._quat[:-1])

    def at(self, times: Array, max_gap: float) -> tuple[Array, NDArray[np.bool_]]:
        """Poses at some times, and where the samples beside them are no further apart than `max_gap`."""
        after = np.clip(np.searchsorted(self._t, times), 1, len(self._t) - 1)
        before = after - 1
        step = self._t[after] - self._t[before]
        share = (times - self._t[before]) / step
        good = (share >= 0) & (share <= 1) & (step <= max_gap)
        share = np.clip(share, 0, 1)[:, None]
        turn = quat_mul(self._quat[before], quat_exp(share * self._turn[before]))
        return transform(self._position[before] * (1 - share) + self._position[after] * share, turn), np.asarray(good)
