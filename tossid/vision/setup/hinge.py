"""Bodies that hang on others by a hinge: where they are at an angle, and what the angle is.

T_parent_body(θ) = T_parent_body(0) · T(θ), T(θ) the turn by θ about a line that is fixed in the body. In the pose graph
such a body has one variable a time step, its angle; its sightings are factors of its root's pose and of the angles
between (`factors.view_factor`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import kernel
from tossid.rotations import skew, transform_inv

Array = NDArray[np.float64]

AXIS_SLACK, ANCHOR_SLACK = 0.05, 0.005
"""Slack of a hinge [rad, m] between two bodies whose poses were found independently: large enough that only a flipped
pose misfits."""


@dataclass(frozen=True, eq=False)
class Hinge:
    """A hinge between a body and its parent.

    Attributes:
        parent: Name of the body that it hangs on.
        T_parent_body: (4, 4) at angle zero.
        axis: (3,) unit, in the body's own frame.
        anchor: (3,) a point of the axis, in the body's own frame [m].
    """

    parent: str
    T_parent_body: Array
    axis: Array
    anchor: Array

    def angle(self, T_parent_body: Array) -> Array:
        """The angle [rad] whose turn is nearest to that of any pose. (*b, 4, 4) -> (*b,)."""
        R = self.T_parent_body[:3, :3].T @ T_parent_body[..., :3, :3]
        sine = np.einsum("...ij,ij->...", R, skew(self.axis))
        across = np.trace(R, axis1=-2, axis2=-1) - self.axis @ R @ self.axis
        return np.asarray(np.arctan2(sine, across))

    def misfit(self, T_parent_body: Array) -> Array:
        """The squared misfit of poses to the hinge, in units of the slack. (*b, 4, 4) -> (*b,)."""
        T = transform_inv(self.T_parent_body) @ T_parent_body
        tilt = np.linalg.norm(np.cross(T[..., :3, :3] @ self.axis, self.axis), axis=-1)
        tilt = np.where(T[..., :3, :3] @ self.axis @ self.axis < 0, 2.0, tilt)
        shift = np.linalg.norm(T[..., :3, :3] @ self.anchor + T[..., :3, 3] - self.anchor, axis=-1)
        return np.asarray((tilt / AXIS_SLACK) ** 2 + (shift / ANCHOR_SLACK) ** 2)


def stacked(hinges: Sequence[Hinge]) -> tuple[Array, Array, Array]:
    """A chain of m hinges outwards from a body: T_parent_body (m, 4, 4) at angle zero, axis and anchor (m, 3)."""
    T_parent_body, axis, anchor = ([getattr(h, name) for h in hinges] for name in ("T_parent_body", "axis", "anchor"))
    return np.reshape(T_parent_body, (-1, 4, 4)), np.reshape(axis, (-1, 3)), np.reshape(anchor, (-1, 3))


@kernel
def swing(T_root: Array, at_zero: Array, axis: Array, anchor: Array, angles: Array) -> tuple[Array, Array]:
    """The pose of a chain's last body, and how it depends on the root and the angles.

    Args:
        T_root: (4, 4) pose of the root.
        at_zero: (m, 4, 4) T_parent_body of each hinge at angle zero.
        axis: (m, 3) of each, as `Hinge` has it.
        anchor: (m, 3) of each, likewise.
        angles: (m,) of the hinges [rad].

    Returns:
        T_world_body (4, 4), and the derivative (6, 6 + m) of its tangent with respect to the root's tangent and to
        each angle.
    """
    m = len(angles)
    T, J = T_root.copy(), np.zeros((6, 6 + m))
    for i in range(6):
        J[i, i] = 1.0
    move, turn = np.zeros((6, 6)), np.eye(4)
    for k in range(m):
        a, p = axis[k], anchor[k]
        K = np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])
        turn[:3, :3] = np.eye(3) + np.sin(angles[k]) * K + (1 - np.cos(angles[k])) * (K @ K)
        for i in range(3):
            turn[i, 3] = p[i] - turn[i, 0] * p[0] - turn[i, 1] * p[1] - turn[i, 2] * p[2]
        H = at_zero[k] @ turn
        T = T @ H
        # the adjoint of H⁻¹ takes the tangent on
        Rt = H[:3, :3].T.copy()
        x, y, z = H[0, 3], H[1, 3], H[2, 3]
        move[:3, :3] = Rt
        move[3:, 3:] = Rt
        move[3:, :3] = -Rt @ np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        J = move @ J
        J[:3, 6 + k] = a
        J[3, 6 + k] = a[2] * p[1] - a[1] * p[2]
        J[4, 6 + k] = a[0] * p[2] - a[2] * p[0]
        J[5, 6 + k] = a[1] * p[0] - a[0] * p[1]
    return T, J
