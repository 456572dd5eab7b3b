"""The hinge between two links, from tracked poses of both and nothing else.

In link 1's frame, link 2 has the rotation Q = R₁ᵀ R₂ and its origin at d = R₁ᵀ (p₂ - p₁). A hinge leaves two things as
they are in all frames: its axis, e₁ = Q e₂ in the frames of link 1 and link 2, and a point of it, d + Q b = a.

Σ |e₁ - Q e₂|² is least for the singular vectors of the mean of Q that belong to its largest singular value. The other
two singular values say how much the joint moves: they are 1 where it does not. The point follows from linear least
squares. Along the axis any point will do; the one nearest to the origins of the two frames is taken. Frames that are
lost get little weight (Huber).

Poses of both links then give the configuration q (first link's pose, angle) of least squares: thirteen numbers are
measured where seven are free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.objects.unstated import Hinge
from tossid.rotations import (
    matrix_to_quat,
    matrix_to_rotvec,
    quat_exp,
    quat_mul,
    quat_rotate,
    quat_to_matrix,
    rotvec_to_matrix,
    skew,
)
from tossid.settings.motion import HingeSettings
from tossid.types import PoseTrack

Array = NDArray[np.float64]

DEFAULT = HingeSettings()


@dataclass(frozen=True)
class FoundHinge:
    """A hinge that poses have shown.

    Attributes:
        hinge: In the links' frames, as tracked; at angle zero the joint is in the middle of what it went through.
        spread: Circular standard deviation of its angle [rad].
        tilt: Root mean square angle between the axis as link 1 and as link 2 carries it [rad].
        offset: Root mean square distance of the point, as each link carries it [m].
    """

    hinge: Hinge
    spread: float
    tilt: float
    offset: float


def find_hinge(
    first: Sequence[PoseTrack], second: Sequence[PoseTrack], settings: HingeSettings = DEFAULT
) -> FoundHinge:
    """The hinge between two links.

    Args:
        first: Tracks of link 1, (n, 7) each.
        second: Tracks of link 2 at the same times.
        settings: What is no hinge.

    Raises:
        InputError: The joint never moves, or it is no hinge.
    """
    Q, d = _relative(np.concatenate([track.q for track in first]), np.concatenate([track.q for track in second]))
    weights = np.ones(len(Q))
    for _ in range(settings.iterations):
        U, size, Vt = np.linalg.svd(np.einsum("n,nij->ij", weights / weights.sum(), Q))
        axis_1, axis_2 = U[:, 0], Vt[0]
        tilt = np.linalg.norm(axis_1 - Q @ axis_2, axis=1)
        weights = _huber(tilt, settings)
    spread = float(np.sqrt(-2 * np.log(np.clip(size[1], 1e-12, 1.0))))
    if spread < settings.least_spread:
        raise InputError(
            f"the joint hardly moves: its angle varies by {np.rad2deg(spread):.1f}° (standard deviation), and a hinge "
            f"needs {np.rad2deg(settings.least_spread):.0f}°; links that are fixed to each other are object.links=1"
        )
    a, b, offset = _point(Q, d, np.concatenate([axis_1, axis_2]), settings)
    tilt_rms, offset_rms = (float(np.sqrt(np.mean(x**2))) for x in (tilt, offset))
    _need_hinge(tilt, offset, settings)
    zero = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    hinge = Hinge(a - zero @ b, matrix_to_quat(zero), b, axis_2)
    return FoundHinge(hinge, spread, tilt_rms, offset_rms)


def hinged_tracks(
    first: Sequence[PoseTrack], second: Sequence[PoseTrack], found: FoundHinge, settings: HingeSettings = DEFAULT
) -> list[PoseTrack]:
    """Tracks of both links as one of link 1 and the hinge's angle, (n, 8) each, by least squares of all poses.

    Args:
        first: Tracks of link 1, (n, 7) each.
        second: Tracks of link 2 at the same times.
        found: Their hinge. What it leaves of the poses shows how much rotations and positions count.
        settings: Smallest noise.
    """
    hinge = found.hinge
    arms = hinge.pos @ hinge.pos + np.sum((hinge.body_pos + quat_rotate(hinge.body_quat, hinge.pos)) ** 2)
    angle_sd: float = max(found.tilt / 2, settings.least_angle_noise)  # two directions, two rotations
    left = max(found.offset**2 - 2 * angle_sd**2 * float(arms), 0.0)
    place_sd = max(float(np.sqrt(left / 6)), settings.least_noise)
    return [
        PoseTrack(one.name, one.t, _fused(one.q, two.q, hinge, place_sd, angle_sd))
        for one, two in zip(first, second, strict=True)
    ]


def _relative(q1: Array, q2: Array) -> tuple[Array, Array]:
    """Link 2 in link 1's frame: rotation (n, 3, 3) and origin (n, 3) [m]."""
    R1, R2 = quat_to_matrix(q1[:, 3:7]), quat_to_matrix(q2[:, 3:7])
    return R1.swapaxes(1, 2) @ R2, np.einsum("nji,nj->ni", R1, q2[:, :3] - q1[:, :3])


def _huber(size: Array, settings: HingeSettings) -> Array:
    """Weights (n,) of residuals of some sizes."""
    return np.asarray(1 / np.maximum(1, size / (settings.huber * max(float(np.median(size)), 1e-12))))


def _point(Q: Array, d: Array, axis: Array, settings: HingeSettings) -> tuple[Array, Array, Array]:
    """A point of the axis in link 1's and link 2's frame (3,), and how far apart they are in each frame (n,) [m].

    axis: (6,) in both frames. Along it nothing is determined: the point is the one nearest to both origins.
    """
    across = np.linalg.svd(axis[None])[2][1:].T
    J = np.concatenate([np.broadcast_to(np.eye(3), Q.shape), -Q], axis=2) @ across
    weights = np.ones(len(Q))
    for _ in range(settings.iterations):
        H = np.einsum("n,nki,nkj->ij", weights, J, J)
        z = np.linalg.solve(H, np.einsum("n,nki,nk->i", weights, J, d))
        offset = np.linalg.norm(J @ z - d, axis=1)
        weights = _huber(offset, settings)
    return (across @ z)[:3], (across @ z)[3:], offset


def _need_hinge(tilt: Array, offset: Array, settings: HingeSettings) -> None:
    """Refuse what is no hinge: a fifth of the frames is off by too much.

    Raises:
        InputError: It is not.
    """
    turned, apart = (float(np.quantile(x, settings.judged)) for x in (tilt, offset))
    if turned > settings.most_tilt:
        raise InputError(
            f"the joint is no hinge: the links' common axis is off by {np.rad2deg(turned):.1f}° or more in "
            f"{100 * (1 - settings.judged):.0f} % of the frames (more than one axis, or a body frame that moves)"
        )
    if apart > settings.most_offset:
        raise InputError(
            f"the joint is no hinge: the links' common point is off by {1e3 * apart:.1f} mm or more in "
            f"{100 * (1 - settings.judged):.0f} % of the frames (a slide, or a body frame that moves)"
        )


def _fused(q1: Array, q2: Array, hinge: Hinge, place_sd: float, angle_sd: float) -> Array:
    """Configurations (n, 8) nearest to poses of both links, by Gauss and Newton."""
    zero = quat_to_matrix(hinge.body_quat)
    a = hinge.body_pos + zero @ hinge.pos
    Q, _ = _relative(q1, q2)
    turn = zero.T @ Q
    sine, across = np.einsum("nij,ij->n", turn, skew(hinge.axis)), np.trace(turn, axis1=1, axis2=2)
    angle = np.unwrap(np.arctan2(sine, across - hinge.axis @ turn @ hinge.axis))
    p, quat, n = q1[:, :3].copy(), q1[:, 3:7].copy(), len(q1)
    measured = [quat_to_matrix(q[:, 3:7]) for q in (q1, q2)]
    scale = np.repeat([1 / place_sd, 1 / angle_sd] * 2, 3)
    for _ in range(2):
        R1 = quat_to_matrix(quat)
        between = zero @ rotvec_to_matrix(angle[:, None] * hinge.axis)
        R2 = R1 @ between
        r, J = np.empty((n, 12)), np.zeros((n, 12, 7))
        r[:, :3] = q1[:, :3] - p
        r[:, 3:6] = matrix_to_rotvec(R1.swapaxes(1, 2) @ measured[0])
        r[:, 6:9] = q2[:, :3] - (p + R1 @ a - R2 @ hinge.pos)
        r[:, 9:] = matrix_to_rotvec(R2.swapaxes(1, 2) @ measured[1])
        J[:, :3, :3] = J[:, 6:9, :3] = J[:, 3:6, 3:6] = np.eye(3)
        J[:, 9:, 3:6], J[:, 9:, 6] = between.swapaxes(1, 2), hinge.axis
        J[:, 6:9, 3:6] = -R1 @ skew(a) + R2 @ skew(hinge.pos) @ between.swapaxes(1, 2)
        J[:, 6:9, 6] = R2 @ np.cross(hinge.pos, hinge.axis)
        J *= scale[:, None]
        step = np.linalg.solve(J.swapaxes(1, 2) @ J, J.swapaxes(1, 2) @ (scale * r)[..., None])[..., 0]
        p += step[:, :3]
        quat = quat_mul(quat, quat_exp(step[:, 3:6]))
        angle += step[:, 6]
    return np.column_stack([p, quat, angle])
