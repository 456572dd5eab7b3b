"""Where something stands, from tags seen from known places: candidates of each tag, and the joint fit.

One engine for all unknown poses of a scene. Of every sighting (a tag in an image) the way from the camera to
the parent of the unknown pose, T_cam_parent, and from the unknown frame to the tag, T_target_tag, are known:

    x_cam = T_cam_parent · T_parent_target · T_target_tag · x_tag

so that the unknown can be a body's pose, a rig's, a tag's or a camera's. Everything runs over all unknown poses
at once, on flat arrays with a row for each sighting, sorted by the unknown pose ("group") it tells of.

Corners are in normalised image coordinates (X/Z, Y/Z), undistorted once, with their whitening carried along
(`docs/adr/0009-pose-graph.md`). A pose's tangent is GTSAM's: (rotation, translation) in the target's own frame.
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
    skew,
    transform_from_rotvec,
    transform_inv,
    transform_points,
)

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

HUBER = 3.0
"""Whitened residual of a corner beyond which its weight falls off."""
DIFFERENT = np.deg2rad(20.0)
"""Poses further apart than this are different hypotheses, not one pose with an error."""
SOURCES, WITNESSES = 24, 96
"""Of one unknown pose, so many of the largest tags propose it, and so many sightings judge the proposals."""
TOGETHER = 1000
"""Unknown poses that are fitted at once."""

SQUARE = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
"""Corners of a tag of half size 1: bottom-left, bottom-right, top-right, top-left. (4, 3)."""


@dataclass(frozen=True, eq=False)
class Sightings:
    """Tags in images, sorted by group.

    group: (d,). T_cam_parent, T_target_tag: (d, 4, 4). half: (d,) half the tag's size [m]. seen: (d, 4, 2)
    corners in normalised coordinates. whiten: (d, 4, 2, 2) takes their errors to unit variance.
    T_cam_tag: (d, 2, 4, 4) what each tag alone allows (`tag_poses`).
    """

    group: Ints
    T_cam_parent: Array
    T_target_tag: Array
    half: Array
    seen: Array
    whiten: Array
    T_cam_tag: Array

    def take(self, index: Ints | Bools, group: Ints | None = None) -> Sightings:
        """Some of them, with new group numbers if given (sorted)."""
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
        """Corners in the target's frame [m]. (d, 4, 3)."""
        return transform_points(self.T_target_tag, self.half[:, None, None] * SQUARE)


@dataclass(frozen=True, eq=False)
class Resection:
    """Poses T_parent_target of g groups, and the best alternative of each.

    T: (g, 4, 4). information: (g, 6, 6) in the tangent (rotation, translation) of the target.
    cost: (g,) robust sum of squared whitened residuals. known: (g,) whether there is a pose at all.
    other, other_information, other_cost: the alternative, where `ambiguous` says that there is one.
    count: (g,) sightings of each.
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
        """How much better the pose is than its alternative (infinite where there is none). (g,)."""
        return np.where(self.ambiguous, self.other_cost - self.cost, np.inf)


def tag_poses(seen: Array, half: Array) -> Array:
    """Both poses T_cam_tag that a tag alone allows: IPPE (Collins and Bartoli 2014).

    The second one is the reflected tilt that a small or distant tag cannot exclude.

    Args:
        seen: (d, 4, 2) normalised corners. half: (d,) half the size [m].

    Returns:
        (d, 2, 4, 4), NaN where there is none.
    """
    rotvecs, shifts = np.full((len(seen), 2, 3), np.nan), np.full((len(seen), 2, 3), np.nan)
    square, eye = SQUARE[::-1].copy(), np.eye(3)  # IPPE_SQUARE wants top-left first
    for row in np.flatnonzero(np.isfinite(seen).all(axis=(1, 2))):
        count, turns, ways, _ = cv2.solvePnPGeneric(
            half[row] * square, seen[row, ::-1].copy(), eye, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        for k in range(min(int(count), 2)):
            rotvecs[row, k], shifts[row, k] = turns[k][:, 0], ways[k][:, 0]
    T = transform_from_rotvec(shifts, rotvecs)
    T[~np.isfinite(T).all(axis=(2, 3)) | (T[..., 2, 3] <= 0)] = np.nan
    return T


def residuals(s: Sightings, T: Array, *, jacobian: bool = False) -> tuple[Array, Array | None]:
    """Projected minus seen corners, normalised, under the pose of each sighting's row.

    Args:
        T: (d, 4, 4) T_parent_target.

    Returns:
        (d, 4, 2), and with `jacobian` its derivative (d, 4, 2, 6) by the target's tangent. NaN behind the lens.
    """
    points = s.points
    T_cam_target = s.T_cam_parent @ T
    x = transform_points(T_cam_target, points)
    z = np.where(x[..., 2] > 0, x[..., 2], np.nan)
    flat = x[..., :2] / z[..., None]
    if not jacobian:
        return flat - s.seen, None
    J_flat = np.zeros((*flat.shape, 3))
    J_flat[..., 0, 0] = J_flat[..., 1, 1] = 1 / z
    J_flat[..., 2] = -flat / z[..., None]
    J_point = J_flat @ T_cam_target[:, None, :3, :3]
    return flat - s.seen, np.concatenate([-J_point @ skew(points), J_point], axis=-1)


def retract(T: Array, tangent: Array) -> Array:
    """T · (exp(θ^), v): a step (rotation θ [rad], translation v [m]) in the target's frame. (*b, 4, 4), (*b, 6)."""
    out = T.copy()
    out[..., :3, 3] += np.squeeze(T[..., :3, :3] @ tangent[..., 3:, None], -1)
    out[..., :3, :3] = T[..., :3, :3] @ quat_to_matrix(quat_exp(tangent[..., :3]))
    return out


@dataclass(frozen=True, eq=False)
class Fit:
    """Refined poses: as in `Resection`; ok: (g,) whether the normal equations could be solved."""

    T: Array
    information: Array
    cost: Array
    whitened: Array
    ok: Bools


def fit(s: Sightings, T: Array, *, iterations: int = 8) -> Fit:
    """Gauss-Newton over all corners of each group, with Huber's loss on whitened corner residuals.

    The threshold starts at twice each group's median residual, so that a poor start is not mistaken for
    outliers, and is `HUBER` in the second half of the iterations.

    Args:
        T: (g, 4, 4) start of each group; every group needs a sighting.
    """
    T = T.copy()
    n = len(T)
    start = np.searchsorted(s.group, np.arange(n))
    ok = np.isfinite(T).all(axis=(1, 2))
    T[~ok] = np.eye(4)
    information = np.zeros((n, 6, 6))
    for iteration in range(iterations + 1):
        r, J = residuals(s, T[s.group], jacobian=True)
        assert J is not None
        bad = ~np.isfinite(r).all(axis=(1, 2))
        r[bad], J[bad] = 0.0, 0.0
        r = np.squeeze(s.whiten @ r[..., None], -1)
        J = s.whiten @ J
        size = np.linalg.norm(r, axis=-1)
        size[bad] = 1e6
        last = iteration >= iterations // 2
        limit = np.full(len(size), HUBER) if last else np.maximum(HUBER, 2 * _median(size, start))[s.group]
        weight = np.minimum(1.0, limit[:, None] / np.maximum(size, 1e-12))
        weight[bad] = 0.0
        rows = J.reshape(len(J), 8, 6)
        weighted = np.swapaxes(rows * np.repeat(weight, 2, axis=1)[..., None], -1, -2)
        information = np.add.reduceat(weighted @ rows, start, axis=0)
        gradient = np.add.reduceat(np.squeeze(weighted @ r.reshape(-1, 8, 1), -1), start, axis=0)
        if iteration == iterations:
            break
        ok &= np.linalg.cond(information) < 1e14
        damped = information + 1e-9 * np.trace(information, axis1=1, axis2=2)[:, None, None] * np.eye(6)
        damped[~ok] = np.eye(6)
        move = np.where(ok[:, None], -np.linalg.solve(damped, gradient[..., None])[..., 0], 0.0)
        # never more than half a radian, or half of the distance to the tags, at once
        reach = 0.5 * np.add.reduceat(np.abs(s.T_cam_tag[:, 0, 2, 3]), start) / np.diff(np.append(start, len(size)))
        reach = np.where(np.isfinite(reach), reach, 0.25)
        over = np.maximum(np.linalg.norm(move[:, :3], axis=1) / 0.5, np.linalg.norm(move[:, 3:], axis=1) / reach)
        T = retract(T, move / np.maximum(over, 1.0)[:, None])
    robust = np.where(size <= HUBER, size**2, 2 * HUBER * size - HUBER**2)
    ok = np.asarray(ok & np.isfinite(T).all(axis=(1, 2)))
    return Fit(T, information, np.add.reduceat(robust.sum(axis=1), start), np.sqrt(np.mean(size**2, axis=1) / 2), ok)


def _median(size: Array, start: Ints) -> Array:
    """Median over the corners of each group. (d, 4), (g,) -> (g,)."""
    counts = np.diff(np.append(start, len(size)))
    order = np.lexsort((size.reshape(-1), np.repeat(np.arange(len(start)), 4 * counts)))
    return np.asarray(size.reshape(-1)[order][4 * start + 2 * counts])


def resect(s: Sightings, n: int) -> Resection:
    """The pose of each group that explains all its sightings best, and the best one that lies elsewhere.

    Groups are fitted `TOGETHER` many at a time, so that what a fit needs meanwhile does not grow with their number.

    Args:
        n: number of groups; every group needs a sighting.
    """
    parts = []
    for a in range(0, max(n, 1), TOGETHER):
        own = np.arange(*np.searchsorted(s.group, (a, min(a + TOGETHER, n))))
        parts.append(_resect(s.take(own, s.group[own] - a), min(TOGETHER, n - a)))
    if len(parts) == 1:
        return parts[0]
    return Resection(*(np.concatenate([getattr(part, item.name) for part in parts]) for item in fields(Resection)))


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
        # a second start that ran to the first pose is no alternative
        apart = again.ok & (_angle(again.T, best.T[again_at]) > DIFFERENT)
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
    """Of all candidates (d, 2, 4, 4) of a group the one that explains its sightings best, and the best elsewhere."""
    edge = np.linalg.norm(np.roll(s.seen, -1, axis=1) - s.seen, axis=-1).mean(axis=1)
    # the largest tags of a group first
    order = np.lexsort((-edge, s.group))
    start = np.searchsorted(s.group, np.arange(n))
    counts = np.diff(np.append(start, len(edge)))
    place = np.arange(len(edge)) - np.repeat(start, counts)
    sources = order[place < SOURCES]
    stride = np.maximum(1, -(-counts // WITNESSES))
    witnesses = np.arange(len(edge))[place % np.repeat(stride, counts) == 0]
    first_witness = np.searchsorted(s.group[witnesses], np.arange(n))
    n_witnesses = np.diff(np.append(first_witness, len(witnesses)))
    repeat = n_witnesses[s.group[sources]]
    source = np.repeat(np.arange(len(sources)), repeat)
    offset = np.arange(len(source)) - np.repeat(np.cumsum(repeat) - repeat, repeat)
    witness = witnesses[first_witness[s.group[sources[source]]] + offset]
    cost = np.full((len(sources), 2), np.inf)
    block = 50_000
    for k in range(2):
        total = np.zeros(len(sources))
        for a in range(0, len(source), block):
            own, by = source[a : a + block], witness[a : a + block]
            candidate = T[sources[own], k]
            usable = np.isfinite(candidate[:, 0, 0])
            r, _ = residuals(s.take(by), np.where(usable[:, None, None], candidate, np.eye(4)))
            square = np.sum(r**2, axis=-1) / (0.2 * edge[by, None]) ** 2
            share = np.where(np.isfinite(square), square / (1 + square), 1.0)  # Geman and McClure
            total += np.bincount(own, np.where(usable, share.sum(axis=1), np.inf), minlength=len(sources))
        cost[:, k] = total
    cost[~np.isfinite(T[sources, :, 0, 0])] = np.inf
    flat, group = T[sources].reshape(-1, 4, 4), np.repeat(s.group[sources], 2)
    first = _least(cost.reshape(-1), group, n)
    usable = np.isfinite(flat[:, 0, 0])
    safe = np.where(usable[:, None, None], flat, np.eye(4))
    apart = usable & (_angle(safe, safe[first][group]) > DIFFERENT)
    elsewhere = np.where(apart & np.isfinite(cost.reshape(-1)), cost.reshape(-1), np.inf)
    second = _least(elsewhere, group, n)
    return flat[first], flat[second], np.isfinite(elsewhere[second])


def _least(cost: Array, group: Ints, n: int) -> Ints:
    """Index of the least cost of each group (groups sorted)."""
    order = np.lexsort((cost, group))
    return np.asarray(order[np.searchsorted(group[order], np.arange(n))])
