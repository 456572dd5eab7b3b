"""Resection: a pose from tags seen from known places, by candidates of each tag and a joint fit.

One function serves all unknown poses of a scene. Of every sighting (a tag in an image), the poses from the camera to
the parent of the unknown pose, T_cam_parent, and from the unknown frame to the tag, T_target_tag, are known:

    x_cam = T_cam_parent · T_parent_target · T_target_tag · x_tag

The unknown T_parent_target can so be a body's pose, a rig's, a tag's or a camera's. Arrays have a row for each
sighting, sorted by the unknown pose ("group") that it belongs to; all groups are computed together.

Corners are in normalised image coordinates (X/Z, Y/Z), undistorted once (docs/method/pose-graph.md). A pose's tangent
is GTSAM's: (rotation, translation) in the target's own frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from tossid.rotations import (
    geodesic_angle,
    matrix_to_quat,
    quat_exp,
    quat_to_matrix,
    transform_from_rotvec,
    transform_inv,
    transform_points,
)
from tossid.vision.pose_graph.corner_projection import HUBER, contradictions, normal_equations, whitened_sizes
from tossid.vision.setup.layout import SQUARE

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

ITERATIONS = 8
"""Gauss-Newton steps of a fit, which starts at a candidate of a single tag."""
DISTINCT_ANGLE = np.deg2rad(20.0)
"""Angle above which two poses are two hypotheses, not one pose with an error [rad]."""
PROPOSING_TAGS, JUDGING_SIGHTINGS = 24, 96
"""Of one unknown pose, so many of the largest tags propose candidates, and so many sightings judge these."""


@dataclass(frozen=True, eq=False)
class Sightings:
    """Tags in images, sorted by group.

    Attributes:
        group: Number of the unknown pose, (d,).
        T_cam_parent: (d, 4, 4).
        T_target_tag: (d, 4, 4).
        half: Half of the tag's size [m], (d,).
        seen: Corners in normalised coordinates, (d, 4, 2).
        whiten: Takes their errors to unit variance, (d, 4, 2, 2).
        T_cam_tag: The two poses that each tag alone allows (`tag_poses`), (d, 2, 4, 4).
    """

    group: Ints
    T_cam_parent: Array
    T_target_tag: Array
    half: Array
    seen: Array
    whiten: Array
    T_cam_tag: Array

    def take(self, index: Ints | Bools, group: Ints) -> Sightings:
        """Some of the sightings, with new group numbers, sorted."""
        arrays = (self.T_cam_parent, self.T_target_tag, self.half, self.seen, self.whiten, self.T_cam_tag)
        return Sightings(group, *(array[index] for array in arrays))

    @property
    def points(self) -> Array:
        """Corners in the target's frame [m], (d, 4, 3)."""
        return transform_points(self.T_target_tag, self.half[:, None, None] * SQUARE)


@dataclass(frozen=True, eq=False)
class Resection:
    """Two hypotheses of the pose T_parent_target of each of g groups, the one of less cost first.

    Attributes:
        T: (g, 2, 4, 4); the first one again where there is no second.
        cost: Robust sum of squared whitened residuals, (g, 2); infinite where there is no second.
        known: Whether there is a pose at all, (g,).
        count: Sightings of each group, (g,).
    """

    T: Array
    cost: Array
    known: Bools
    count: Ints

    def ordered(self, cost: Array) -> Resection:
        """The same by other costs (g, 2), in the order of these."""
        order = np.argsort(cost, axis=1, kind="stable")
        T, cost = np.take_along_axis(self.T, order[..., None, None], axis=1), np.take_along_axis(cost, order, axis=1)
        return replace(self, T=T, cost=cost)

    @property
    def gain(self) -> Array:
        """Cost of the second hypothesis less that of the first; infinite where there is no second, (g,)."""
        return np.asarray(self.cost[:, 1] - self.cost[:, 0])

    def noise_scale(self) -> float:
        """Noise of residuals over the corners' own, by `chi2_scale`; 1 of fewer than five groups."""
        if self.known.sum() < 5:
            return 1.0
        return chi2_scale(self.cost[self.known, 0], 8.0 * self.count[self.known] - 6)


def chi2_scale(square: NDArray[np.number], freedom: NDArray[np.number]) -> float:
    """The root of the median over groups of χ² by its degrees of freedom; robust where single groups are wrong.

    Args:
        square: χ² of each group, (g,).
        freedom: Its degrees of freedom k, (g,); χ²'s median is about k (1 - 2/(9k))³.
    """
    return float(np.clip(np.sqrt(np.median(square / (freedom * (1 - 2 / (9 * freedom)) ** 3))), 0.05, 30.0))


def tag_poses(seen: Array, half: Array) -> Array:
    """The two poses T_cam_tag that a tag alone allows, by IPPE (Collins and Bartoli 2014).

    The second one has the reflected tilt, which a small or distant tag cannot exclude.

    Args:
        seen: Normalised corners, (d, 4, 2).
        half: Half of the tag's size [m], (d,).

    Returns:
        (d, 2, 4, 4), NaN where there is none.
    """
    rotvecs, shifts = np.full((len(seen), 2, 3), np.nan), np.full((len(seen), 2, 3), np.nan)
    square, eye = SQUARE[::-1].copy(), np.eye(3)  # IPPE_SQUARE wants top-left first
    for row in np.flatnonzero(np.isfinite(seen).all(axis=(1, 2))):
        count, rotations, translations, _ = cv2.solvePnPGeneric(
            half[row] * square, seen[row, ::-1].copy(), eye, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        for k in range(min(int(count), 2)):
            rotvecs[row, k], shifts[row, k] = rotations[k][:, 0], translations[k][:, 0]
    T = transform_from_rotvec(shifts, rotvecs)
    T[~np.isfinite(T).all(axis=(2, 3)) | (T[..., 2, 3] <= 0)] = np.nan
    return T


def retract(T: Array, tangent: Array) -> Array:
    """T · (exp(θ^), v), the pose after a step in its own frame, (*b, 4, 4).

    Args:
        T: (*b, 4, 4).
        tangent: Rotation θ [rad] and translation v [m], (*b, 6).
    """
    out = T.copy()
    out[..., :3, 3] += np.squeeze(T[..., :3, :3] @ tangent[..., 3:, None], -1)
    out[..., :3, :3] = T[..., :3, :3] @ quat_to_matrix(quat_exp(tangent[..., :3]))
    return out


def fit(s: Sightings, T: Array) -> tuple[Array, Array, Bools]:
    """The poses that minimise Huber's loss of each group's whitened corner residuals, by reweighted Gauss-Newton steps.

    In the first half of the steps the loss is linear only beyond twice a group's median residual, so that a poor start
    is not mistaken for outliers.

    Args:
        s: The sightings; every group needs one.
        T: Start of each group, (g, 4, 4).

    Returns:
        T (g, 4, 4) and cost (g,) as `Resection` has them, and whether the normal equations could be solved (g,).
    """
    T = T.copy()
    n = len(T)
    start = np.searchsorted(s.group, np.arange(n))
    ok = np.isfinite(T).all(axis=(1, 2))
    T[~ok] = np.eye(4)
    seen = (s.points, np.ascontiguousarray(s.seen), np.ascontiguousarray(s.whiten))
    for iteration in range(ITERATIONS + 1):
        T_cam_target = s.T_cam_parent @ T[s.group]
        size = whitened_sizes(T_cam_target, *seen)
        if iteration == ITERATIONS:
            break
        last = iteration >= ITERATIONS // 2
        limit = np.full(n, HUBER) if last else np.maximum(HUBER, 2 * _median(size, start))
        information, gradient = normal_equations(s.group, n, T_cam_target, *seen, size, limit)
        spread = np.linalg.eigvalsh(information)
        ok &= spread[:, 0] > 1e-14 * spread[:, -1]
        damped = information + 1e-9 * np.trace(information, axis1=1, axis2=2)[:, None, None] * np.eye(6)
        damped[~ok] = np.eye(6)
        move = np.where(ok[:, None], -np.linalg.solve(damped, gradient[..., None])[..., 0], 0.0)
        # a step turns by half a radian and moves by half of the distance to the tags at most
        reach = 0.5 * np.add.reduceat(np.abs(s.T_cam_tag[:, 0, 2, 3]), start) / np.diff(np.append(start, len(size)))
        reach = np.where(np.isfinite(reach), reach, 0.25)
        over = np.maximum(np.linalg.norm(move[:, :3], axis=1) / 0.5, np.linalg.norm(move[:, 3:], axis=1) / reach)
        T = retract(T, move / np.maximum(over, 1.0)[:, None])
    ok = np.asarray(ok & np.isfinite(T).all(axis=(1, 2)))
    return T, np.add.reduceat(huber_loss(size).sum(axis=1), start), ok


def huber_loss(size: Array) -> Array:
    """Huber's loss of whitened residuals' sizes, of any shape: twice the usual ρ, so squares up to `HUBER`."""
    return np.where(size <= HUBER, size**2, 2 * HUBER * size - HUBER**2)


def _median(size: Array, start: Ints) -> Array:
    """Median over the corners of each group. (d, 4), (g,) -> (g,)."""
    counts = np.diff(np.append(start, len(size)))
    order = np.lexsort((size.reshape(-1), np.repeat(np.arange(len(start)), 4 * counts)))
    return np.asarray(size.reshape(-1)[order][4 * start + 2 * counts])


def resect(s: Sightings, n: int) -> Resection:
    """The pose of each group that explains all its sightings best, and the best one that is another hypothesis.

    Args:
        s: The sightings; every group needs one.
        n: Number of groups.
    """
    T_parent_target = transform_inv(s.T_cam_parent)[:, None] @ s.T_cam_tag @ transform_inv(s.T_target_tag)[:, None]
    first, second, exists = _choose(s, T_parent_target, n)
    best, best_cost, known = fit(s, first)
    T, cost = np.stack([best, best], axis=1), np.stack([best_cost, np.full(n, np.inf)], axis=1)
    again_at = np.flatnonzero(exists & known)
    if len(again_at):
        number = np.full(n, -1, dtype=np.int64)
        number[again_at] = np.arange(len(again_at))
        own = number[s.group] >= 0
        again, again_cost, ok = fit(s.take(own, number[s.group[own]]), second[again_at])
        # a second start that converged to the first pose is no alternative
        apart = ok & (_angle(again, best[again_at]) > DISTINCT_ANGLE)
        T[again_at[apart], 1], cost[again_at[apart], 1] = again[apart], again_cost[apart]
    return Resection(T, cost, known, np.bincount(s.group)).ordered(cost)


def _angle(A: Array, B: Array) -> Array:
    return geodesic_angle(matrix_to_quat(A[..., :3, :3]), matrix_to_quat(B[..., :3, :3]))


def _choose(s: Sightings, T: Array, n: int) -> tuple[Array, Array, Bools]:
    """The candidate of each group that explains its sightings best, and the best one of another hypothesis.

    T: candidates (d, 2, 4, 4). Returns both (n, 4, 4), and whether there is another hypothesis (n,).
    """
    edge = np.linalg.norm(np.roll(s.seen, -1, axis=1) - s.seen, axis=-1).mean(axis=1)
    # the largest tags of a group first
    order = np.lexsort((-edge, s.group))
    start = np.searchsorted(s.group, np.arange(n))
    counts = np.diff(np.append(start, len(edge)))
    place = np.arange(len(edge)) - np.repeat(start, counts)
    sources = order[place < PROPOSING_TAGS]
    stride = np.maximum(1, -(-counts // JUDGING_SIGHTINGS))
    judges = np.arange(len(edge))[place % np.repeat(stride, counts) == 0]
    first_judge = np.searchsorted(s.group[judges], np.arange(n))
    n_judges = np.diff(np.append(first_judge, len(judges)))
    repeat = n_judges[s.group[sources]]
    source = np.repeat(np.arange(len(sources)), repeat)
    offset = np.arange(len(source)) - np.repeat(np.cumsum(repeat) - repeat, repeat)
    judge = judges[first_judge[s.group[sources[source]]] + offset]
    T_cam_parent, corners = np.ascontiguousarray(s.T_cam_parent), np.ascontiguousarray(s.seen)
    cost = np.empty((len(sources), 2))
    for k in range(2):
        candidates = np.ascontiguousarray(T[sources, k])
        cost[:, k] = contradictions(candidates, source, judge, T_cam_parent, s.points, corners, 0.2 * edge)
    cost[~np.isfinite(T[sources, :, 0, 0])] = np.inf
    flat, group = T[sources].reshape(-1, 4, 4), np.repeat(s.group[sources], 2)
    first = _least(cost.reshape(-1), group, n)
    usable = np.isfinite(flat[:, 0, 0])
    safe = np.where(usable[:, None, None], flat, np.eye(4))
    apart = usable & (_angle(safe, safe[first][group]) > DISTINCT_ANGLE)
    others = np.where(apart & np.isfinite(cost.reshape(-1)), cost.reshape(-1), np.inf)
    second = _least(others, group, n)
    return flat[first], flat[second], np.isfinite(others[second])


def _least(cost: Array, group: Ints, n: int) -> Ints:
    """Index of the least cost of each group (groups sorted)."""
    order = np.lexsort((cost, group))
    return np.asarray(order[np.searchsorted(group[order], np.arange(n))])
