"""Poses of a rigid body from tag corners of many cameras: candidates of each tag, and the joint fit.

Everything runs over all time steps at once, on flat arrays with one row a detection.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tossid.objects import Tag
from tossid.rotations import (
    matrix_to_quat,
    quat_exp,
    quat_mul,
    quat_normalize,
    quat_to_matrix,
    rotvec_to_matrix,
    skew,
    transform_inv,
)
from tossid.types import Detection
from tossid.vision.camera import Camera
from tossid.vision.faces import tag_corners

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

HUBER = 3.0
"""Whitened residual of a corner beyond which its weight falls off."""


@dataclass(frozen=True, eq=False)
class Observations:
    """Detections as flat arrays, sorted by time step.

    step: (d,) time step of each. camera, tag: (d,) indices. points: (d, 4, 3) corners in the
    body's frame [m]. pixels: (d, 4, 2). whiten: (d, 2, 2) W with WᵀW the inverse corner covariance.
    """

    cameras: tuple[Camera, ...]
    step: Ints
    camera: Ints
    tag: Ints
    points: Array
    pixels: Array
    whiten: Array

    def take(self, index: NDArray[np.int64] | NDArray[np.bool_], step: Ints | None = None) -> Observations:
        """Some of them, with new step numbers if given (sorted)."""
        return Observations(
            self.cameras,
            self.step[index] if step is None else step,
            self.camera[index],
            self.tag[index],
            self.points[index],
            self.pixels[index],
            self.whiten[index],
        )


def observations(
    detections: Sequence[Detection], step: Ints, cameras: Sequence[Camera], tags: Sequence[Tag]
) -> Observations:
    """Detections (already sorted by step) of known cameras and tags as arrays."""
    camera_index = {camera.name: i for i, camera in enumerate(cameras)}
    tag_index = {tag.id: i for i, tag in enumerate(tags)}
    corners = np.stack([tag_corners(tag) for tag in tags])
    tag = np.array([tag_index[d.tag_id] for d in detections], dtype=np.int64)
    cov = np.stack([d.corner_cov for d in detections])
    return Observations(
        tuple(cameras),
        step,
        np.array([camera_index[d.camera] for d in detections], dtype=np.int64),
        tag,
        corners[tag],
        np.stack([d.corners for d in detections]),
        np.swapaxes(np.linalg.cholesky(np.linalg.inv(cov)), -1, -2),
    )


def tag_candidates(obs: Observations, tags: Sequence[Tag]) -> tuple[Array, Array]:
    """Both poses of the body that each tag alone allows.

    IPPE (Collins and Bartoli 2014) on undistorted corners; its second solution is
    the reflected tilt that a small or distant tag cannot exclude.

    Returns:
        positions (d, 2, 3) [m] and quaternions (d, 2, 4) of the body in the world; NaN where there is none.
    """
    T_tag_body = [transform_inv(tag.T_body_tag) for tag in tags]
    half = [0.5 * tag.size for tag in tags]
    square = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
    T = np.full((len(obs.step), 2, 4, 4), np.nan)
    eye = np.eye(3)
    for c, camera in enumerate(obs.cameras):
        own = np.flatnonzero(obs.camera == c)
        if not len(own):
            continue
        flat = camera.undistort(obs.pixels[own])
        for row, d in enumerate(own):
            if np.isnan(flat[row]).any():
                continue
            t = obs.tag[d]
            # corners are bottom-left first, IPPE_SQUARE wants top-left first
            count, rotvecs, shifts, _ = cv2.solvePnPGeneric(
                half[t] * square, flat[row, ::-1].copy(), eye, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
            )
            for k in range(min(int(count), 2)):
                T_cam_tag = np.eye(4)
                T_cam_tag[:3, :3] = rotvec_to_matrix(rotvecs[k][:, 0])
                T_cam_tag[:3, 3] = shifts[k][:, 0]
                T[d, k] = camera.T_world_cam @ T_cam_tag @ T_tag_body[t]
    T[~np.isfinite(T).all(axis=(2, 3))] = np.nan
    usable = np.isfinite(T[..., 0, 0])
    quat = np.full((*T.shape[:2], 4), np.nan)
    quat[usable] = matrix_to_quat(T[usable][:, :3, :3])
    return T[..., :3, 3], quat


def residuals(obs: Observations, position: Array, quat: Array, *, jacobian: bool = False) -> tuple[Array, Array | None]:
    """Projected minus seen corners [px] of every detection, for the pose of each detection's row.

    Args:
        position: (d, 3). quat: (d, 4).

    Returns:
        (d, 4, 2), and with `jacobian` its derivative (d, 4, 2, 6) by position [m, world] and
        rotation [rad, body frame, on the right]. NaN for corners behind the lens.
    """
    R = quat_to_matrix(quat)
    world = obs.points @ np.swapaxes(R, -1, -2) + position[:, None]
    out = np.empty_like(obs.pixels)
    J = np.empty((*obs.pixels.shape, 6)) if jacobian else None
    for c, camera in enumerate(obs.cameras):
        own = obs.camera == c
        if not own.any():
            continue
        R_cw = camera.T_cam_world[:3, :3]
        pixels, J_cam = camera.distort(world[own] @ R_cw.T + camera.T_cam_world[:3, 3])
        out[own] = pixels - obs.pixels[own]
        if J is not None:
            J_world = J_cam @ R_cw
            J[own, ..., :3] = J_world
            J[own, ..., 3:] = -J_world @ (R[own][:, None] @ skew(obs.points[own]))
    return out, J


@dataclass(frozen=True, eq=False)
class Fit:
    """Fitted poses. position (n, 3), quat (n, 4), information (n, 6, 6) in the tangent of `residuals`,
    cost (n,) robust sum of squared whitened residuals, whitened (d,) rms whitened residual of each
    detection's corners, pixels (d,) the same in px, ok (n,) whether the normal equations could be solved."""

    position: Array
    quat: Array
    information: Array
    cost: Array
    whitened: Array
    pixels: Array
    ok: NDArray[np.bool_]


def fit_poses(obs: Observations, position: Array, quat: Array, *, iterations: int = 8) -> Fit:
    """Gauss-Newton over all corners of each time step, with Huber's loss on whitened corner residuals.

    The threshold starts at twice each step's median residual, so that a poor
    start is not mistaken for outliers, and falls to `HUBER`.

    Args:
        position, quat: (n, 3), (n, 4) start of each step; every step needs a detection.
    """
    n = len(position)
    position, quat = position.copy(), quat_normalize(quat)
    start = np.searchsorted(obs.step, np.arange(n))
    ok = np.ones(n, dtype=bool)
    information = np.zeros((n, 6, 6))
    for iteration in range(iterations + 1):
        r, J = residuals(obs, position[obs.step], quat[obs.step], jacobian=True)
        assert J is not None
        bad = ~np.isfinite(r).all(axis=(1, 2))
        r[bad], J[bad] = 0.0, 0.0
        r = np.einsum("dij,dcj->dci", obs.whiten, r)
        J = np.einsum("dij,dcjk->dcik", obs.whiten, J)
        size = np.linalg.norm(r, axis=-1)
        size[bad] = 1e6
        limit = np.maximum(HUBER, 2 * _step_median(size, start))[obs.step] if iteration < iterations - 2 else HUBER
        weight = np.minimum(1.0, np.reshape(limit, (-1, 1)) / np.maximum(size, 1e-12))
        weight[bad] = 0.0
        rows = J.reshape(len(J), 8, 6)
        weighted = rows * np.repeat(weight, 2, axis=1)[..., None]
        information = np.add.reduceat(np.swapaxes(weighted, -1, -2) @ rows, start, axis=0)
        gradient = np.add.reduceat(np.squeeze(np.swapaxes(weighted, -1, -2) @ r.reshape(-1, 8, 1), -1), start, axis=0)
        if iteration == iterations:
            break
        ok &= np.linalg.cond(information) < 1e14
        damped = information + 1e-9 * np.trace(information, axis1=1, axis2=2)[:, None, None] * np.eye(6)
        damped[~ok] = np.eye(6)
        move = np.where(ok[:, None], -np.linalg.solve(damped, gradient[..., None])[..., 0], 0.0)
        # never more than a quarter of a metre or half a radian at once
        length = np.maximum(np.linalg.norm(move[:, :3], axis=1) / 0.25, np.linalg.norm(move[:, 3:], axis=1) / 0.5)
        move /= np.maximum(length, 1.0)[:, None]
        position = position + move[:, :3]
        quat = quat_normalize(quat_mul(quat, quat_exp(move[:, 3:])))
    robust = np.where(size <= HUBER, size**2, 2 * HUBER * size - HUBER**2)
    r_px, _ = residuals(obs, position[obs.step], quat[obs.step])
    return Fit(
        position,
        quat,
        information,
        np.add.reduceat(robust.sum(axis=1), start),
        np.sqrt(np.mean(size**2, axis=1) / 2),
        np.sqrt(np.nan_to_num(np.mean(np.sum(r_px**2, axis=-1), axis=1), nan=1e6)),
        ok & np.isfinite(position).all(axis=1) & np.isfinite(quat).all(axis=1),
    )


def _step_median(size: Array, start: Ints) -> Array:
    """Median over the corners of each step. (d, 4), (n,) -> (n,)."""
    counts = np.diff(np.append(start, len(size)))
    table = np.full((len(start), int(counts.max()), 4), np.nan)
    row = np.repeat(np.arange(len(start)), counts)
    table[row, np.arange(len(size)) - start[row]] = size
    return np.asarray(np.nanmedian(table.reshape(len(start), -1), axis=1))
