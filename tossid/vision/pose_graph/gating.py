"""Gating: which poses of a moving body are accepted, and its track of these."""

from __future__ import annotations

import itertools
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import geodesic_angle, matrix_to_quat, quat_continuous, transform_inv
from tossid.settings.tracking import TrackSettings
from tossid.types import PoseTrack
from tossid.vision.pose_graph.reprojection import ReprojectionErrors
from tossid.vision.pose_graph.scene import Scene
from tossid.vision.pose_graph.state import Solution, is_known

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# limits that bend with what a recording can give, beside the fixed ones of `TrackSettings`
RMS_SIGMAS = 6.0
"""A time step's rms reprojection passes within so many standard deviations of its corners."""
SIGMA_MEDIANS = 50.0
"""A pose's standard deviation passes within so many times the track's median."""
JUMP_ANGLE, JUMP_DISTANCE = np.deg2rad(10.0), 0.02
"""Turn [rad] and distance [m] between two poses that are no jump, whatever the time between them."""
SHORTEST_RUN = 5
"""Poses between two jumps that are left out if they are fewer."""


class Gate:
    """Which time steps' poses are accepted, and why the others are not.

    Attributes:
        accepted: (n,).
        reasons: How many steps each reason rejected.
        rejected: For each reason, the steps that it rejected, (n,).
    """

    def __init__(self, candidates: Bools) -> None:
        """Begin with all candidates accepted, (n,)."""
        self.accepted = candidates.copy()
        self.reasons: Counter[str] = Counter()
        self.rejected: dict[str, Bools] = {}

    def reject(self, bad: Bools, reason: str) -> None:
        """Reject steps (n,); a step counts for the first reason that rejects it."""
        fresh = bad & self.accepted
        self.rejected[reason] = self.rejected.get(reason, np.zeros_like(fresh)) | fresh
        if fresh.any():
            self.reasons[reason] += int(fresh.sum())
        self.accepted &= ~bad


def gate_steps(
    scene: Scene,
    solution: Solution,
    errors: ReprojectionErrors,
    rows: Bools,
    seen: Bools,
    tree: list[int],
    settings: TrackSettings,
) -> Gate:
    """Which time steps have an accepted pose of a moving body and of every body that hangs on it.

    Args:
        scene: The sightings.
        solution: Poses with covariances.
        errors: Their reprojection.
        rows: Sightings of any of the bodies, (d,).
        seen: Steps with detections of any of them, (n,).
        tree: Numbers of the bodies, the root first.
        settings: The limits.
    """
    gate, n = Gate(seen), len(scene.t)
    own = [rows if len(tree) == 1 else rows & (scene.body[scene.tag] == b) for b in tree]
    counts = [np.bincount(scene.step[of_body], minlength=n) for of_body in own]
    if len(tree) > 1:
        gate.reject(seen & (np.min(counts, axis=0) == 0), "a body out of sight")
    for b, of_body, count in zip(tree, own, counts, strict=True):
        T, cov = solution.state.world[b][:n], solution.world_cov[b][:n]
        gate.reject(seen & ~is_known(T), "ambiguous")
        step = scene.step[of_body]
        with np.errstate(invalid="ignore", divide="ignore"):
            rms, expected = (
                np.sqrt(np.bincount(step, pixels[of_body] ** 2, minlength=n) / count)
                for pixels in (errors.pixels, errors.expected_pixels)
            )
        gate.reject(seen & ((count == 0) | ~np.isfinite(cov[:, 0, 0])), "no pose fits")
        gate.reject(seen & ~(rms < np.maximum(settings.max_rms, RMS_SIGMAS * expected)), "reprojection")
        safe = np.where(np.isfinite(cov), cov, 0.0)
        for part, limit in ((slice(3, 6), settings.max_sigma), (slice(0, 3), settings.max_angle_sigma)):
            sigma = np.sqrt(np.maximum(np.linalg.eigvalsh(safe[:, part, part])[:, -1], 0.0))
            typical = float(np.median(sigma[gate.accepted])) if gate.accepted.any() else 0.0
            gate.reject(seen & (sigma > max(limit, SIGMA_MEDIANS * typical)), "too uncertain")
        gate.reject(_jumps(scene.t, T, gate.accepted, settings), "jump")
    return gate


def _jumps(t: Array, T: Array, accepted: Bools, settings: TrackSettings) -> Bools:
    """Steps in short runs that are too far from their neighbours in time on both sides."""
    index = np.flatnonzero(accepted)
    bad = np.zeros(len(t), dtype=bool)
    if len(index) < 3:
        return bad
    dt = np.diff(t[index])
    quat = matrix_to_quat(T[index, :3, :3])
    turn = geodesic_angle(quat[1:], quat[:-1])
    distance = np.linalg.norm(np.diff(T[index, :3, 3], axis=0), axis=1)
    broken = turn > JUMP_ANGLE + settings.max_spin * dt
    broken |= distance > JUMP_DISTANCE + settings.max_speed * dt
    # a short run between two breaks is wrong, not its longer neighbours
    edges = np.concatenate([[0], np.flatnonzero(broken) + 1, [len(index)]])
    longest = np.diff(edges).max()
    for a, b in itertools.pairwise(edges):
        if b - a < min(SHORTEST_RUN, longest):
            bad[index[a:b]] = True
    return bad


def pose_track(name: str, scene: Scene, solution: Solution, tree: list[int], keep: Ints) -> PoseTrack:
    """The track of a body and of the bodies that hang on it, with covariances.

    Args:
        name: Of the track.
        scene: The sightings.
        solution: Poses with covariances.
        tree: Numbers of the bodies, the root first.
        keep: Time steps of the track, (k,).
    """
    root, links = tree[0], tree[1:]
    T = solution.state.world[root][keep]
    cov = solution.tree_cov[root][keep] if links else solution.world_cov[root][keep]
    # from the tangent (rotation, translation in the body's frame) to (position in the world, rotation)
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
