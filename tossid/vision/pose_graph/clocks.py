"""Offsets between cameras' clocks, from what they see of the same motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import matrix_to_quat, quat_boxminus, quat_exp, quat_mul, transform, transform_inv
from tossid.settings.tracking import TrackSettings
from tossid.vision.cameras.camera import Camera
from tossid.vision.pose_graph.corner_projection import corner_errors
from tossid.vision.pose_graph.initial import choose
from tossid.vision.pose_graph.resect import Sightings, resect
from tossid.vision.pose_graph.scene import Scene, gap
from tossid.vision.pose_graph.state import State, is_known
from tossid.vision.setup.layout import Body

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

REACH = 0.25
"""Largest offset that is looked for once clocks were set coarsely, at any offset, from all that is seen [s]."""
SEARCH_STEPS = 0.004, 0.001, 0.00025
"""Steps of the offsets that are tried, from coarse to fine [s]."""
STRETCHES, STRETCH_STEPS = 10, 120
"""Stretches of the recording that are used, and time steps of each."""
FEWEST_STEPS = 20
"""Time steps in which one camera alone has to place a body, for the others to be compared with it."""
FEWEST_SIGHTINGS = 40
"""Sightings of a tag of that body from which another camera's clock is looked for."""
SOFT_PIXELS = 5.0
"""Reprojection at which a corner's weight is halved (Geman and McClure) [px]."""
MISFIT_SHARE = 0.6
"""An offset must bring the misfit below this share of the misfit without it."""
SAME = 0.0005
"""Clocks that are no further apart are one [s]."""
SIGMAS = 5.0
"""The pose graph confirms an offset that is so many of its standard deviations from zero."""
PLACING = 200
"""Sightings that place a camera of unknown pose."""


def clock_offsets(scene: Scene, state: State, *, settings: TrackSettings) -> dict[int, float]:
    """Offsets of cameras' clocks [s] by camera's number: how much later than most cameras' a frame's time stamp is.

    Only offsets that differ from zero are given. The camera that sees most gives the motion of a body alone. That
    motion, taken at shifted times, is projected into each other camera. Where the pose between the two is unknown, the
    other camera is placed anew for each shift. Tags must be known, and frames must follow each other within `max_gap`.

    Args:
        scene: The sightings.
        state: Poses of cameras, tags and static bodies (`initial.given`).
        settings: Of the choice between two poses.
    """
    found: dict[int, float] = {}
    n = len(scene.t)
    starts = np.linspace(0, max(n - STRETCH_STEPS, 0), STRETCHES).astype(np.int64)
    sampled = np.zeros(n, dtype=bool)
    for start in starts:
        sampled[start : start + STRETCH_STEPS] = True
    usable = sampled[scene.step] & is_known(state.tag)[scene.tag] & (scene.count == 1)
    for b, body in enumerate(scene.bodies):
        rows = np.flatnonzero(usable & (scene.body[scene.tag] == b))
        if body.is_static or not len(rows):
            continue
        counts = np.bincount(scene.camera[rows], minlength=len(scene.cameras))
        reference = int(np.argmax(counts))
        own = rows[scene.camera[rows] == reference]
        motion = Motion(*lone_motion(scene, own, state.tag[scene.tag[own]], settings), settings.max_gap)
        if len(motion.t) < FEWEST_STEPS:
            continue
        for c in map(int, np.flatnonzero(counts >= FEWEST_SIGHTINGS)):
            if (
                c != reference
                and c not in found
                and stand_together(scene.cameras[reference], scene.cameras[c], scene.bodies)
            ):
                T_cam_reference = _between(scene, state, c, reference)
                offset = _offset(scene, state, rows[scene.camera[rows] == c], motion, T_cam_reference)
                if offset is not None:
                    found[c] = offset
        if found:
            found = most_at_zero({int(c): found.get(int(c), 0.0) for c in np.flatnonzero(counts)}, SAME)
    return found


def most_at_zero(clocks: dict[int, float], same: float) -> dict[int, float]:
    """Clocks that differ from the offset that most cameras share; of two cameras, the first one's counts as zero.

    Args:
        clocks: Offsets [s] by camera's number.
        same: Clocks that are no further apart are one [s].
    """
    agreed = min(clocks.values(), key=lambda one: sum(abs(one - other) > same for other in clocks.values()))
    return {c: offset - agreed for c, offset in clocks.items() if abs(offset - agreed) > same}


def stand_together(a: Camera, c: Camera, bodies: Sequence[Body]) -> bool:
    """Whether the pose between two cameras never changes."""
    rigs = {a.rig_body, c.rig_body}
    return len(rigs) == 1 or all(body.is_static for body in bodies if body.name in rigs)


def lone_motion(scene: Scene, rows: Ints, T_target_tag: Array, settings: TrackSettings) -> tuple[Array, Array]:
    """Something's motion by one camera alone: times (m,) and T_cam_target (m, 4, 4), where that is certain.

    Args:
        scene: The sightings.
        rows: Those of the camera of the target's tags, (k,).
        T_target_tag: Pose of each row's tag on the target, (k, 4, 4).
        settings: Of the choice between two poses.
    """
    if not len(rows):
        return np.zeros(0), np.zeros((0, 4, 4))
    steps, group = np.unique(scene.step[rows], return_inverse=True)
    s = _sightings(scene, rows, np.broadcast_to(np.eye(4), (len(rows), 4, 4)), T_target_tag, group)
    poses = resect(s, len(steps))
    t = scene.t[steps] + scene.delay[rows[np.searchsorted(group, np.arange(len(steps)))]]
    T, certain = choose(poses, t, settings)
    return t[certain], T[certain]


def _sightings(scene: Scene, rows: Ints, T_cam_parent: Array, T_target_tag: Array, group: Ints) -> Sightings:
    half, seen, whiten = scene.half[rows], scene.seen[rows], scene.whiten[rows]
    return Sightings(group, T_cam_parent, T_target_tag, half, seen, whiten, scene.T_cam_tag[rows])


def _between(scene: Scene, state: State, a: int, c: int) -> Array | None:
    """The pose of camera c in the frame of camera a, None where it is unknown."""
    T = [state.camera[k] for k in (a, c)]
    if scene.rig[a] != scene.rig[c]:
        T = [state.world[scene.rig[k]][0] @ state.camera[k] for k in (a, c)]
    T_a_c = transform_inv(T[0]) @ T[1]
    return T_a_c if is_known(T_a_c) else None


def _offset(scene: Scene, state: State, rows: Ints, motion: Motion, T_cam_reference: Array | None) -> float | None:
    """The offset at which a motion fits one camera's sightings best, None if zero fits nearly as well."""
    if T_cam_reference is None:
        rows = rows[:: -(-len(rows) // PLACING)]
    own = scene.t[scene.step[rows]] + scene.delay[rows]

    def misfits(offsets: Array) -> tuple[Array, Ints]:
        T_reference_body, good = motion.at((own - offsets[:, None]).reshape(-1))
        which, at = np.divmod(np.flatnonzero(good), len(rows))
        counts = np.bincount(which, minlength=len(offsets))
        groups, group = np.unique(which, return_inverse=True)
        T_reference_tag = T_reference_body[good] @ state.tag[scene.tag[rows[at]]]
        s = _sightings(scene, rows[at], np.broadcast_to(np.eye(4), T_reference_tag.shape), T_reference_tag, group)
        if T_cam_reference is None and len(groups):
            T = resect(s, len(groups)).T[group]
        else:
            T = np.broadcast_to(np.eye(4) if T_cam_reference is None else T_cam_reference, T_reference_tag.shape)
        r = corner_errors(np.ascontiguousarray(T), s.points, s.seen)
        square = np.sum(np.squeeze(scene.to_pixels[rows[at]] @ r[..., None], -1) ** 2, axis=-1)
        each = np.nan_to_num(square / (square + SOFT_PIXELS**2), nan=1.0).mean(axis=-1)
        total = np.bincount(which, each, minlength=len(offsets))
        return np.asarray(np.where(counts > 0, total / np.maximum(counts, 1), np.inf)), counts

    grid: Array = np.arange(-REACH, REACH + 1e-9, SEARCH_STEPS[0])
    curve, counts = misfits(grid)
    curve[counts < 0.5 * counts.max()] = np.inf
    best = float(grid[np.argmin(curve)])
    for step in SEARCH_STEPS[1:]:
        near = best + step * np.linspace(-4.0, 4.0, 9)
        best = float(near[np.argmin(misfits(near)[0])])
    there, here = misfits(np.array([best, 0.0]))[0]
    return best if there < MISFIT_SHARE * here and abs(best) > SAME else None


class Motion:
    """Poses of a body over time, interpolated.

    Attributes:
        t: Times of the poses [s], (m,).
    """

    def __init__(self, t: Array, T: Array, max_gap: float) -> None:
        """Through poses (m, 4, 4) at times (m,) [s], in order, where those beside are nearer than a `gap`."""
        self.t, self._position = t, T[:, :3, 3]
        self._quat = matrix_to_quat(T[:, :3, :3])
        self._turn = quat_boxminus(self._quat[1:], self._quat[:-1])
        self._gap = gap(t, max_gap)

    def at(self, times: Array) -> tuple[Array, Bools]:
        """Poses at some times, and which of them lie within no gap.

        Args:
            times: [s], (k,).
        """
        if len(self.t) < 2:
            return np.broadcast_to(np.eye(4), (len(times), 4, 4)), np.zeros(len(times), dtype=bool)
        after = np.clip(np.searchsorted(self.t, times), 1, len(self.t) - 1)
        before = after - 1
        step = self.t[after] - self.t[before]
        share = (times - self.t[before]) / step
        good = (share >= 0) & (share <= 1) & (step <= self._gap)
        share = np.clip(share, 0, 1)[:, None]
        turn = quat_mul(self._quat[before], quat_exp(share * self._turn[before]))
        return transform(self._position[before] * (1 - share) + self._position[after] * share, turn), np.asarray(good)
