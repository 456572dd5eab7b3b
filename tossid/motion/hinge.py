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
from tossid.robust import in_medians, reweighted
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
from tossid.types import PoseTrack

Array = NDArray[np.float64]

ITERATIONS = 6
"""Reweightings."""
OUTLIER = 3.0
"""Residual, in medians over frames, from which a frame counts less."""
LEAST_SPREAD = 0.1
"""Circular standard deviation of the angle below which the joint does not move [rad]."""
JUDGED = 0.8
"""Share of the frames in which a hinge keeps the next two limits."""
MOST_TILT, MOST_OFFSET = 0.05, 4e-3
"""Largest angle between the axis [rad], and distance between the point [m], as either link carries them."""
LEAST_ANGLE_NOISE, LEAST_NOISE = 1e-5, 1e-6
"""Smallest standard deviations of rotations [rad] and positions [m] that weigh them."""


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


def find_hinge(first: Sequence[PoseTrack], second: Sequence[PoseTrack]) -> FoundHinge:
    """The hinge between two links.

    Args:
        first: Tracks of link 1, (n, 7) each.
        second: Tracks of link 2 at the same times.

    Raises:
        InputError: The joint never moves, or it is no hinge.
    """
    Q, d = _relative(np.concatenate([track.q for track in first]), np.concatenate([track.q for track in second]))

    def common_axis(weights: Array) -> tuple[tuple[Array, Array, Array, Array], Array]:
        U, size, Vt = np.linalg.svd(np.einsum("n,nij->ij", weights / weights.sum(), Q))
        tilt = np.linalg.norm(U[:, 0] - Q @ Vt[0], axis=1)
        return (U, size, Vt, tilt), in_medians(tilt)

    # Σ |e₁ - Q e₂|² = 2 Σ (1 - e₁ᵀ Q e₂): least for the first singular vectors of the mean of Q
    (U, size, Vt, tilt), _ = reweighted(common_axis, len(Q), limit=OUTLIER, iterations=ITERATIONS)
    # the other singular values are the mean cosine of the angle, and a circular deviation is sqrt(-2 log) of it
    spread = float(np.sqrt(-2 * np.log(np.clip(size[1], 1e-12, 1.0))))
    if spread < LEAST_SPREAD:
        raise InputError(
            f"the joint hardly moves: its angle varies by {np.rad2deg(spread):.1f}° (standard deviation), and a hinge "
            f"needs {np.rad2deg(LEAST_SPREAD):.0f}°; links that are fixed to each other are object.links=1"
        )
    # along the axis, the point is not determined: the one nearest to both origins is taken
    across = np.linalg.svd(np.concatenate([U[:, 0], Vt[0]])[None])[2][1:].T
    J = np.concatenate([np.broadcast_to(np.eye(3), Q.shape), -Q], axis=2) @ across

    def common_point(weights: Array) -> tuple[tuple[Array, Array], Array]:
        H = np.einsum("n,nki,nkj->ij", weights, J, J)
        z = np.linalg.solve(H, np.einsum("n,nki,nk->i", weights, J, d))
        offset = np.linalg.norm(J @ z - d, axis=1)
        return (across @ z, offset), in_medians(offset)

    (points, offset), _ = reweighted(common_point, len(Q), limit=OUTLIER, iterations=ITERATIONS)
    _need_hinge(tilt, offset)
    a, b = points[:3], points[3:]
    zero = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    hinge = Hinge(a - zero @ b, matrix_to_quat(zero), b, Vt[0])
    return FoundHinge(hinge, spread, *(float(np.sqrt(np.mean(x**2))) for x in (tilt, offset)))


def hinged_tracks(first: Sequence[PoseTrack], second: Sequence[PoseTrack], found: FoundHinge) -> list[PoseTrack]:
    """Tracks of both links as one of link 1 and the hinge's angle, (n, 8) each, by least squares of all poses.

    Args:
        first: Tracks of link 1, (n, 7) each.
        second: Tracks of link 2 at the same times.
        found: Their hinge. What it leaves of the poses shows how much rotations and positions count.
    """
    hinge = found.hinge
    arms = hinge.pos @ hinge.pos + np.sum((hinge.body_pos + quat_rotate(hinge.body_quat, hinge.pos)) ** 2)
    angle_sd: float = max(found.tilt / 2, LEAST_ANGLE_NOISE)  # two directions, two rotations
    left = max(found.offset**2 - 2 * angle_sd**2 * float(arms), 0.0)
    place_sd = max(float(np.sqrt(left / 6)), LEAST_NOISE)
    return [
        PoseTrack(one.name, one.t, _fused(one.q, two.q, hinge, place_sd, angle_sd))
        for one, two in zip(first, second, strict=True)
    ]


def _relative(q1: Array, q2: Array) -> tuple[Array, Array]:
    """Link 2 in link 1's frame: rotation (n, 3, 3) and origin (n, 3) [m]."""
    R1, R2 = quat_to_matrix(q1[:, 3:7]), quat_to_matrix(q2[:, 3:7])
    return R1.swapaxes(1, 2) @ R2, np.einsum("nji,nj->ni", R1, q2[:, :3] - q1[:, :3])


def _need_hinge(tilt: Array, offset: Array) -> None:
    """Refuse what is no hinge: a fifth of the frames is off by too much.

    Raises:
        InputError: It is not.
    """
    turned, distance = (float(np.quantile(x, JUDGED)) for x in (tilt, offset))
    share = f"in {100 * (1 - JUDGED):.0f} % of the frames"
    if turned > MOST_TILT:
        raise InputError(
            f"the joint is no hinge: the links' common axis is off by {np.rad2deg(turned):.1f}° or more {share} (more "
            "than one axis, or a body frame that moves)"
        )
    if distance > MOST_OFFSET:
        raise InputError(
            f"the joint is no hinge: the links' common point is off by {1e3 * distance:.1f} mm or more {share} (a "
            "slide, or a body frame that moves)"
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
