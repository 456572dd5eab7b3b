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

from dataclasses import dataclass, fields

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
FITS_AT_ONCE = 1000
"""Unknown poses that are fitted together; bounds the memory."""


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

    def take(self, index: Ints | Bools, group: Ints | None = None) -> Sightings:
        """Some of the sightings.

        Args:
            index: Which.
            group: Their new group numbers, sorted; None to keep them.
        """
        return Sightings(
            self.group[index] if group is None else group,
            self.T_cam_parent[index],
            self.T_target_tag[index],
            self.half[index],
            self.seen[index],
            self.whiten[index],
            self.T_cam_tag[index],
        )

    @property
    def points(self) -> Array:
        """Corners in the target's frame [m], (d, 4, 3)."""
        return transform_points(self.T_target_tag, self.half[:, None, None] * SQUARE)


@dataclass(frozen=True, eq=False)
class Resection:
    """Poses T_parent_target of g groups, and the best alternative of each.

    Attributes:
        T: (g, 4, 4).
        information: In the tangent (rotation, translation) of the target, (g, 6, 6).
        cost: Robust sum of squared whitened residuals, (g,).
        known: Whether there is a pose at all, (g,).
        other: The alternative pose, (g, 4, 4).
        other_information: (g, 6, 6).
        other_cost: (g,).
        ambiguous: Whether there is an alternative, (g,).
        count: Sightings of each group, (g,).
    """

    T: Array
    information: Array
    cost: Array
    known: Bools
    other: Array
    other_information: Array
    other_cost: Array
    ambiguous: Bools
    count: Ints

    @property
    def gain(self) -> Array:
        """Cost of the alternative less that of the pose; infinite where there is no alternative, (g,)."""
        return np.where(self.ambiguous, self.other_cost - self.cost, np.inf)


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


@dataclass(frozen=True, eq=False)
class Fit:
    """Refined poses of g groups.

    Attributes:
        T: As in `Resection`, (g, 4, 4).
        information: As in `Resection`, (g, 6, 6).
        cost: As in `Resection`, (g,).
        whitened: Root mean square whitened residual of each sighting, (d,).
        ok: Whether the normal equations could be solved, (g,).
    """

    T: Array
    information: Array
    cost: Array
    whitened: Array
    ok: Bools


def fit(s: Sightings, T: Array) -> Fit:
    """The poses that minimise Huber's loss of each group's whitened corner residuals, by reweighted Gauss-Newton steps.

    In the first half of the steps the loss is linear only beyond twice a group's median residual, so that a poor start
    is not mistaken for outliers.

    Args:
        s: The sightings; every group needs one.
        T: Start of each group, (g, 4, 4).
    """
    T = T.copy()
    n = len(T)
    start = np.searchsorted(s.group, np.arange(n))
    ok = np.isfinite(T).all(axis=(1, 2))
    T[~ok] = np.eye(4)
    information = np.zeros((n, 6, 6))
    seen = (s.points, np.ascontiguousarray(s.seen), np.ascontiguousarray(s.whiten))
    for iteration in range(ITERATIONS + 1):
        T_cam_target = s.T_cam_parent @ T[s.group]
        size = whitened_sizes(T_cam_target, *seen)
        last = iteration >= ITERATIONS // 2
        limit = np.full(n, HUBER) if last else np.maximum(HUBER, 2 * _median(size, start))
        information, gradient = normal_equations(s.group, n, T_cam_target, *seen, size, limit)
        if iteration == ITERATIONS:
            break
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
    robust = huber_loss(size)
    ok = np.asarray(ok & np.isfinite(T).all(axis=(1, 2)))
    return Fit(T, information, np.add.reduceat(robust.sum(axis=1), start), np.sqrt(np.mean(size**2, axis=1) / 2), ok)


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
    parts = []
    for a in range(0, max(n, 1), FITS_AT_ONCE):
        own = np.arange(*np.searchsorted(s.group, (a, min(a + FITS_AT_ONCE, n))))
        parts.append(_resect(s.take(own, s.group[own] - a), min(FITS_AT_ONCE, n - a)))
    return (
        parts[0]
        if len(parts) == 1
        else Resection(*(np.concatenate([getattr(part, item.name) for part in parts]) for item in fields(Resection)))
    )


def _resect(s: Sightings, n: int) -> Resection:
    """The same for all groups at once."""
    T_parent_target = transform_inv(s.T_cam_parent)[:, None] @ s.T_cam_tag @ transform_inv(s.T_target_tag)[:, None]
    first, second, exists = _choose(s, T_parent_target, n)
    best = fit(s, first)
    other, other_information, other_cost = first.copy(), np.tile(np.eye(6), (n, 1, 1)), np.full(n, np.inf)
    ambiguous = np.zeros(n, dtype=bool)
    again_at = np.flatnonzero(exists & best.ok)
    T, information, cost = best.T.copy(), best.information.copy(), best.cost.copy()
    if len(again_at):
        number = np.full(n, -1, dtype=np.int64)
        number[again_at] = np.arange(len(again_at))
        own = number[s.group] >= 0
        again = fit(s.take(own, number[s.group[own]]), second[again_at])
        # a second start that converged to the first pose is no alternative
        apart = again.ok & (_angle(again.T, best.T[again_at]) > DISTINCT_ANGLE)
        at = again_at[apart]
        other[at], other_cost[at] = again.T[apart], again.cost[apart]
        other_information[at] = again.information[apart]
        ambiguous[at] = True
        swap = ambiguous & (other_cost < cost)
        for mine, theirs in ((T, other), (cost, other_cost), (information, other_information)):
            mine[swap], theirs[swap] = theirs[swap], mine[swap].copy()
    ambiguous &= best.ok
    return Resection(
        T, information, cost, best.ok, other, other_information, other_cost, ambiguous, np.bincount(s.group)
    )


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
