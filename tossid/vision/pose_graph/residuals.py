"""The graph's residuals: what was seen, measured and known before, less what the poses predict; with derivatives.

Poses are varied in their own frame, T · (exp(θ^), v) as `resect.retract` has it, so a derivative by a pose has six
columns, rotation first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import matrix_to_rotvec, right_jacobian_inv, skew, transform_inv
from tossid.vision.pose_graph.corner_projection import HUBER, corner_residuals
from tossid.vision.pose_graph.reprojection import Chain, printed_corners
from tossid.vision.pose_graph.scene import Scene
from tossid.vision.setup.layout import SQUARE, Measurement

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

BEHIND_LENS = 1e5
"""Whitened residual of a corner behind the lens: a large constant."""


@dataclass(frozen=True, slots=True)
class TagModel:
    """How tags differ from flat squares with sharp edges.

    Attributes:
        spread_sigma: Standard deviation by which a tag's edges spread from image to image, over the noise's scale [px].
        prints: Numbers of the tags whose prints are variables.
    """

    spread_sigma: float = 0.0
    prints: frozenset[int] = frozenset()


IDEAL_TAGS = TagModel()


class Rows(NamedTuple):
    """Residuals of one kind, with their derivatives by the unknowns that they depend on.

    Attributes:
        r: Whitened residuals, (d, k).
        J: Their derivatives, (d, k, m).
        column: The unknown by which each of these is, -1 for a constant, (d, m).
        step: Time step whose own columns are meant, (d,).
    """

    r: Array
    J: Array
    column: Ints
    step: Ints


def adjoint_inv(T: Array) -> Array:
    """Ad(T⁻¹) = [Rᵀ, 0; -Rᵀ p^, Rᵀ]: takes a tangent before T to that after it, T' exp(ξ) T = T' T exp(Ad(T⁻¹) ξ).

    Args:
        T: (*b, 4, 4).

    Returns:
        (*b, 6, 6).
    """
    R_inv = np.swapaxes(T[..., :3, :3], -1, -2)
    out = np.zeros((*T.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = R_inv
    out[..., 3:, :3] = -R_inv @ skew(T[..., :3, 3])
    return out


class ByPoses(NamedTuple):
    """Residuals of sightings, and their derivatives by each transform between camera and tag.

    Attributes:
        r: Whitened residuals of the corners, (d, 8).
        camera: By T_rig_cam, (d, 8, 6).
        rig: By T_world_rig.
        body: By T_world_body.
        tag: By T_body_tag.
        print: By the tag's print, (d, 8, 3).
        delay: By the frame's time after its step, (d, 8, 1).
    """

    r: Array
    camera: Array
    rig: Array
    body: Array
    tag: Array
    print: Array
    delay: Array


def sighting_residuals(
    scene: Scene, chain: Chain, prints: Array, *, rates: tuple[Array, Array], scale: float, spread_sigma: float
) -> ByPoses:
    """Whitened reprojection errors of all sightings.

    Huber's loss ρ is in the residual itself, r √(2ρ(|r|))/|r|, so that half of the sum of squares is the robust error
    and its gradient exact. Corners of a tag whose edges spread by b ~ N(0, σ²) have the covariance I + σ² g gᵀ, g being
    their whitened motion by b; its inverse root whitens them.

    Args:
        scene: The sightings.
        chain: The poses between each one's camera and tag.
        prints: Of each one's tag, (d, 3).
        rates: Motion of its rig and of its body (rotation [rad/s], translation [m/s], in their own frames), (d, 6).
        scale: Standard deviation of corners over what their covariances say.
        spread_sigma: That of the spread of tags' edges, over the noise's scale [px].
    """
    T_cam_tag, d = chain.T_cam_tag, len(scene.step)
    corners = scene.half[:, None, None] * printed_corners(prints)
    whitened, J = corner_residuals(T_cam_tag, corners, scene.seen, scene.whiten / scale)
    in_front = np.isfinite(whitened)
    r = np.where(in_front, whitened, BEHIND_LENS).reshape(d, 8)
    # a print moves the corner within the tag's frame
    x, y, _ = SQUARE.T
    J = np.concatenate([J, J[..., 3:] * np.stack([x, y, x * y], axis=1)[:, None] * scene.half[:, None, None, None]], -1)
    J = J.reshape(d, 8, 9)
    if spread_sigma:
        g = np.where(in_front, np.squeeze(scene.whiten @ scene.edge_growth[..., None], -1), 0.0).reshape(d, 1, 8)
        r, J = _without_spread(r, J, g, spread_sigma)
    r, J = _huber(r, J, HUBER * np.sqrt(scene.count))
    by_tag = J[..., :6]
    T_late_tag = chain.rig_motion_inv @ chain.T_rig_body @ chain.body_motion @ chain.T_body_tag
    rig_rate, body_rate = (
        _tangent(motion, rate)
        for motion, rate in zip((transform_inv(chain.rig_motion_inv), chain.body_motion), rates, strict=True)
    )
    by_delay = adjoint_inv(chain.T_body_tag) @ body_rate - adjoint_inv(T_late_tag) @ rig_rate
    return ByPoses(
        r,
        -by_tag @ adjoint_inv(T_cam_tag),
        -by_tag @ adjoint_inv(chain.T_rig_body @ chain.body_motion @ chain.T_body_tag),
        by_tag @ adjoint_inv(chain.body_motion @ chain.T_body_tag),
        by_tag,
        J[..., 6:],
        by_tag @ by_delay,
    )


def _tangent(motion: Array, rate: Array) -> Array:
    """Tangent of (exp(ω δ), v δ) by δ: (ω, Rᵀ v), (d, 6, 1)."""
    turned = np.swapaxes(motion[:, :3, :3], 1, 2) @ rate[:, 3:, None]
    return np.concatenate([rate[:, :3, None], turned], axis=1)


def _without_spread(r: Array, J: Array, g: Array, spread_sigma: float) -> tuple[Array, Array]:
    """r (d, 8) and J (d, 8, m) times (I + σ² g gᵀ)^(-1/2) = I - (1 - 1/√(1 + σ² |g|²)) g gᵀ/|g|², with g (d, 1, 8)."""
    square = g @ g.mT
    take = (1 - 1 / np.sqrt(1 + spread_sigma**2 * square)) / np.maximum(square, 1e-300) * g.mT
    return r - np.squeeze(take @ (g @ r[..., None]), -1), J - take @ (g @ J)


def _huber(r: Array, J: Array, limit: Array) -> tuple[Array, Array]:
    """r (d, 8) scaled by √(2ρ(|r|))/|r| corner by corner, ρ being Huber's loss, and J (d, 8, m) so that Jᵀr is exact.

    limit: Of each sighting, (d,).
    """
    size = np.maximum(np.linalg.norm(r.reshape(-1, 4, 2), axis=2), limit[:, None])
    value = np.sqrt(2 * limit[:, None] * size - limit[:, None] ** 2) / size
    slope = limit[:, None] / (size * value)
    return r * np.repeat(value, 2, axis=1), J * np.repeat(slope, 2, axis=1)[..., None]


def pose_residuals(T: Array, mean: Array, cov: Array, column: Ints) -> Rows:
    """Whitened differences (log(R̄ᵀR), R̄ᵀ(p - p̄)) of poses from their prior means.

    Args:
        T: Poses (R, p), (d, 4, 4).
        mean: (R̄, p̄), (d, 4, 4).
        cov: Covariance of the tangent, (d, 6, 6).
        column: First column of each pose, (d,).
    """
    difference, J = _difference(transform_inv(mean) @ T)
    W = np.swapaxes(np.linalg.cholesky(np.linalg.inv(0.5 * (cov + np.swapaxes(cov, 1, 2)))), 1, 2)
    return Rows(np.squeeze(W @ difference[..., None], -1), W @ J, columns_of(column, 6), 0 * column)


def between_residuals(A: Array, B: Array, sigma: Array) -> tuple[Array, Array, Array]:
    """Whitened differences of pairs of poses that are nearly equal, (d, 6), and derivatives by both, (d, 6, 6).

    Args:
        A: Poses, (d, 4, 4).
        B: Likewise.
        sigma: Standard deviations of the tangent, (6,).
    """
    T = transform_inv(A) @ B
    difference, J = _difference(T)
    J = J / sigma[:, None]
    return difference / sigma, -J @ adjoint_inv(T), J


def _difference(T: Array) -> tuple[Array, Array]:
    """(log R, p) of poses (d, 4, 4), (d, 6), and the derivative by their tangents, (d, 6, 6)."""
    turn, J = matrix_to_rotvec(T[:, :3, :3]), np.zeros((len(T), 6, 6))
    J[:, :3, :3], J[:, 3:, 3:] = right_jacobian_inv(turn), T[:, :3, :3]
    return np.concatenate([turn, T[:, :3, 3]], axis=1), J


def value_residuals(value: Array, mean: Array, sigma: float, column: Ints) -> Rows:
    """Differences of numbers (d, k) from their prior means (d, k), over their standard deviation."""
    J = np.broadcast_to(np.eye(value.shape[1]) / sigma, (*value.shape, value.shape[1]))
    return Rows((value - mean) / sigma, J, columns_of(column, value.shape[1]), 0 * column)


def length_residual(
    measurement: Measurement, T_world_body: Sequence[Array], T_body_tag: Sequence[Array], half: Sequence[float]
) -> tuple[float, Array]:
    """A measured length's residual over its noise, and its derivative by each point's T_world_body and T_body_tag.

    Args:
        measurement: What was measured.
        T_world_body: Of each point's body, (4, 4).
        T_body_tag: Of the tag on it, (4, 4).
        half: Half of the tag's size [m].

    Returns:
        The residual, and its derivative (points, 2, 6).
    """
    places, by = [], []
    for (_, corner), A, B, h in zip(measurement.points, T_world_body, T_body_tag, half, strict=True):
        x = np.zeros(3) if corner is None else SQUARE[corner] * h
        y = B[:3, :3] @ x + B[:3, 3]
        places.append(A[:3, :3] @ y + A[:3, 3])
        by.append(((A[:3, :3], y), (A[:3, :3] @ B[:3, :3], x)))
    if measurement.direction is None:
        between = places[1] - places[0]
        length = float(np.linalg.norm(between))
        along = [-between / length, between / length]
    else:
        length, along = float(measurement.direction @ places[0]), [measurement.direction]
    J = np.array(
        [
            [np.concatenate([np.cross(x, direction @ R), direction @ R]) for R, x in parts]
            for direction, parts in zip(along, by, strict=True)
        ]
    )
    return (length - measurement.length) / measurement.noise, J / measurement.noise


def columns_of(first: Ints, n: int) -> Ints:
    """The n columns from each of some first ones, -1 where that is -1. (*b,) -> (*b, n)."""
    return np.where(first[..., None] >= 0, first[..., None] + np.arange(n), -1)
