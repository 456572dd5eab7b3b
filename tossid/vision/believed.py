"""Which of a moving body's poses are to be believed, and its track of these."""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import geodesic_angle, matrix_to_quat, quat_continuous, transform_inv
from tossid.types import PoseTrack
from tossid.vision.initial import there
from tossid.vision.reprojection import Errors
from tossid.vision.resect import DIFFERENT
from tossid.vision.scene import Scene
from tossid.vision.solution import Solution

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

PROMISE = 6.0
"""A frame's rms reprojection is never too large while within so many standard deviations of its corners."""


TYPICAL = 50.0
"""A pose is never too uncertain while within so many times the median uncertainty of its track."""


@dataclass(frozen=True, slots=True)
class TrackSettings:
    """When to believe a pose.

    max_rms: largest rms reprojection of a time step [px], where the corners' covariances do not promise less.
    max_sigma [m], max_angle_sigma [rad]: largest standard deviation of a pose along any axis, where the track's
    own median is not of that order (`TYPICAL`).
    outlier: rms residual over the noise beyond which one tag among several is dropped.
    evidence: least difference in robust squared residuals between two hypotheses for the images alone to decide.
    max_spin [rad/s], max_speed [m/s]: motion between frames that is still believed.
    max_gap: longest time [s] over which a neighbour decides between hypotheses.
    clocks: look whether cameras' clocks are apart, and find by how much.
    """

    max_rms: float = 1.5
    max_sigma: float = 0.005
    max_angle_sigma: float = 0.06
    outlier: float = 6.0
    evidence: float = 25.0
    max_spin: float = 50.0
    max_speed: float = 10.0
    max_gap: float = 0.06
    clocks: bool = True


class Kept:
    """Which steps are left, and why the others are not."""

    def __init__(self, kept: Bools) -> None:
        self.kept = kept.copy()
        self.reasons: Counter[str] = Counter()
        self.bad: dict[str, Bools] = {}

    def mark(self, bad: Bools, reason: str) -> None:
        fresh = bad & self.kept
        self.bad[reason] = self.bad.get(reason, np.zeros_like(fresh)) | fresh
        if fresh.any():
            self.reasons[reason] += int(fresh.sum())
        self.kept &= ~bad


def believed_tree(
    scene: Scene, solution: Solution, errors: Errors, rows: Bools, seen: Bools, tree: list[int], settings: TrackSettings
) -> Kept:
    """Which steps have a pose to be believed of a moving body (the first of `tree`) and of all that hangs on it.

    Args:
        rows: (d,) sightings of any of these. seen: (n,) steps with detections of any.
    """
    if len(tree) == 1:
        return believed_steps(scene, solution, errors, rows, seen, tree[0], settings)
    kept, of_body = Kept(seen), scene.body[scene.tag]
    shown = [np.bincount(scene.step[rows & (of_body == b)], minlength=len(scene.t)) > 0 for b in tree]
    kept.mark(seen & ~np.all(shown, axis=0), "a body out of sight")
    for b, of_one in zip(tree, shown, strict=True):
        own = believed_steps(scene, solution, errors, rows & (of_body == b), of_one, b, settings)
        for reason, bad in own.bad.items():
            kept.mark(bad, reason)
    return kept


def believed_steps(
    scene: Scene, solution: Solution, errors: Errors, rows: Bools, seen: Bools, b: int, settings: TrackSettings
) -> Kept:
    """Which of a moving body's steps have a pose that is to be believed."""
    n = len(scene.t)
    T, cov = solution.state.world[b][:n], solution.world_cov[b][:n]
    dropped = Kept(seen)
    dropped.mark(seen & ~there(T), "ambiguous")
    count = np.bincount(scene.step[rows], minlength=n)
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = np.sqrt(np.bincount(scene.step[rows], errors.pixels[rows] ** 2, minlength=n) / count)
        promise = np.sqrt(np.bincount(scene.step[rows], errors.promise[rows] ** 2, minlength=n) / count)
    dropped.mark(seen & ((count == 0) | ~np.isfinite(cov[:, 0, 0])), "no pose fits")
    dropped.mark(seen & ~(rms < np.maximum(settings.max_rms, PROMISE * promise)), "reprojection")
    safe = np.where(np.isfinite(cov), cov, 0.0)
    for part, limit in ((slice(3, 6), settings.max_sigma), (slice(0, 3), settings.max_angle_sigma)):
        sigma = np.sqrt(np.maximum(np.linalg.eigvalsh(safe[:, part, part])[:, -1], 0.0))
        typical = float(np.median(sigma[dropped.kept])) if dropped.kept.any() else 0.0
        dropped.mark(seen & (sigma > max(limit, TYPICAL * typical)), "too uncertain")
    dropped.mark(_jumps(scene.t, T, dropped.kept, settings), "jump")
    return dropped


def _jumps(t: Array, T: Array, kept: Bools, settings: TrackSettings) -> Bools:
    """Steps that neither neighbour in time can have led to or come from."""
    index = np.flatnonzero(kept)
    bad = np.zeros(len(t), dtype=bool)
    if len(index) < 3:
        return bad
    dt = np.diff(t[index])
    quat = matrix_to_quat(T[index, :3, :3])
    turn = geodesic_angle(quat[1:], quat[:-1])
    way = np.linalg.norm(np.diff(T[index, :3, 3], axis=0), axis=1)
    broken = (turn > 0.5 * DIFFERENT + settings.max_spin * dt) | (way > 0.02 + settings.max_speed * dt)
    # runs between breaks; a short run that is cut off on both sides is wrong, not its neighbours
    edges = np.concatenate([[0], np.flatnonzero(broken) + 1, [len(index)]])
    longest = np.diff(edges).max()
    for a, b in itertools.pairwise(edges):
        if b - a < min(5, longest):
            bad[index[a:b]] = True
    return bad


def pose_track(name: str, scene: Scene, solution: Solution, tree: list[int], keep: Ints) -> PoseTrack:
    """Configurations of a body, and of what hangs on it, in some steps, with their covariances."""
    root, links = tree[0], tree[1:]
    T = solution.state.world[root][keep]
    cov = solution.tree_cov[root][keep] if links else solution.world_cov[root][keep]
    # from the graph's tangent (rotation, translation in the body's frame) to (position in the world, rotation)
    J = np.zeros_like(cov)
    J[:, :3, 3:6] = T[:, :3, :3]
    J[:, 3:6, :3] = np.eye(3)
    J[:, 6:, 6:] = np.eye(len(links))
    cov = J @ cov @ np.swapaxes(J, 1, 2)
    angles = np.empty((len(keep), len(links)))
    for k, b in enumerate(links):
        hinge = scene.bodies[b].hinge
        assert hinge is not None
        parent = next(i for i, body in enumerate(scene.bodies) if body.name == hinge.parent)
        angles[:, k] = np.unwrap(
            hinge.angle(transform_inv(solution.state.world[parent][keep]) @ solution.state.world[b][keep])
        )
    q = np.concatenate([T[:, :3, 3], quat_continuous(matrix_to_quat(T[:, :3, :3])), angles], axis=1)
    return PoseTrack(name, scene.t[keep], q, 0.5 * (cov + np.swapaxes(cov, 1, 2)))
