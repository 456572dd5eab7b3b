"""Newton's and Euler's equations of a tree about its common centre of mass: mass matrix, free motion, a frame ahead.

States are (position of the common centre of mass, orientation of the base, joints) and their velocities. So the
momentum of the whole is by itself, and an impulse within a step leaves no error in it. The kinematics are those of
`tossid.physics.batch`; they do not depend on inertia.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.motion.kinematics import com_velocities
from tossid.motion.smoothing.system import difference, moved
from tossid.objects import ObjectModel, body_poses
from tossid.physics.batch import TreeBatch, tree_batch
from tossid.physics.identifiable import energy_rows
from tossid.physics.system import make_system
from tossid.rotations import quat_rotate

Array = NDArray[np.float64]

SMALL = 1e-6
"""Step of differences in angle [rad], spin [rad/s], joint position and rate."""


class HalfWay(NamedTuple):
    """Kinematics where a step begins, and in its middle."""

    first: TreeBatch
    middle: TreeBatch


class TreeDynamics:
    """Motion of a tree without contact, for any inertia of its bodies.

    Args:
        model: Its masses, centres of mass and joints.
        gravity: Downward acceleration [m/s²].
    """

    def __init__(self, model: ObjectModel, gravity: float) -> None:
        self._model, self._gravity = model, gravity
        self._system = make_system(model)
        self._share = model.mass / model.mass.sum()

    def about_com(self, q: Array) -> Array:
        """Configurations (*s, nq) with the common centre of mass in place of the base's origin."""
        return np.concatenate([q[..., :3] + self._arm(q), q[..., 3:]], axis=-1)

    def about_origin(self, q: Array) -> Array:
        """The inverse of `about_com`."""
        return np.concatenate([q[..., :3] - self._arm(q), q[..., 3:]], axis=-1)

    def com_velocity(self, q: Array, v: Array) -> Array:
        """Velocity of the common centre of mass (*s, 3) [m/s].

        Args:
            q: Configurations, of either kind, (*s, nq).
            v: Velocities of the base's origin, its spin and joint rates, (*s, nv).
        """
        return np.asarray(np.einsum("b,...bi->...i", self._share, com_velocities(self._model, q, v)))

    def at_origin(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Configurations and velocities of the base's origin, from those of the common centre of mass."""
        turning = np.concatenate([np.zeros_like(v[..., :3]), v[..., 3:]], axis=-1)
        first = v[..., :3] - self.com_velocity(q, turning)
        return self.about_origin(q), np.concatenate([first, v[..., 3:]], axis=-1)

    def com_jacobian(self, q: Array) -> Array:
        """Velocity of the common centre of mass by that of the base's origin, its spin and joint rates, (*s, 3, nv)."""
        unit = np.eye(self._model.nv)
        columns = [self.com_velocity(q, np.broadcast_to(e, (*q.shape[:-1], len(e)))) for e in unit]
        return np.stack(columns, axis=-1)

    def kinematics(self, q: Array, v: Array) -> TreeBatch:
        """What depends on the motion alone, at q (N, nq), v (N, nv); where the whole is and goes is left out."""
        fixed = np.zeros(3)
        return tree_batch(self._system, _with_first(q, fixed), _with_first(v, fixed))

    def mass_matrix(self, motion: TreeBatch, inertia: Array) -> Array:
        """M(q) of the base's origin, its spin and joint rates, (N, nv, nv).

        Args:
            motion: Of `kinematics`.
            inertia: (n_b, 3, 3) of each body about its centre of mass, in its frame [kg m²].
        """
        rows = energy_rows(motion, self._model, inertia)
        return np.asarray(rows.swapaxes(-1, -2) @ rows)

    def acceleration(self, at: TreeBatch, inertia: Array) -> Array:
        """dv/dt without contact, (N, nv).

        Args:
            at: Of `kinematics`.
            inertia: As of `mass_matrix`.
        """
        model, I = self._model, inertia
        # forces and torques that would keep dv/dt at 0, in units of the rows
        arm, w = model.com, at.omega
        a = at.xdd + np.cross(at.alpha, arm) + np.cross(w, np.cross(w, arm))
        n = np.einsum("bij,nbj->nbi", I, at.alpha) + np.cross(w, np.einsum("bij,nbj->nbi", I, w))
        root_inverse = np.linalg.inv(np.linalg.cholesky(I))
        y = np.concatenate([np.sqrt(model.mass)[:, None] * a, np.einsum("bij,nbj->nbi", root_inverse, n)], axis=-1)
        rows = energy_rows(at, model, I)
        transposed = rows.swapaxes(-1, -2)
        found = -np.linalg.solve(transposed @ rows, transposed @ y.reshape(len(y), 6 * len(I), 1))[..., 0]
        return _with_first(found, np.array([0.0, 0.0, -self._gravity]))

    def half_way(self, q: Array, v: Array, h: Array, inertia: Array) -> HalfWay:
        """Kinematics of states and of those h / 2 later.

        Args:
            q: Configurations, (N, nq).
            v: Velocities, (N, nv).
            h: Times [s], (N,).
            inertia: As of `mass_matrix`.
        """
        first, step = self.kinematics(q, v), h[:, None]
        middle = v + 0.5 * step * self.acceleration(first, inertia)
        return HalfWay(first, self.kinematics(moved(q, 0.25 * step * (v + middle)), middle))

    def ahead(self, q: Array, v: Array, h: Array, inertia: Array, by: HalfWay) -> tuple[Array, Array]:
        """The state a time h later, by the midpoint rule.

        Args:
            q: Configurations, (N, nq).
            v: Velocities, (N, nv).
            h: Times [s], (N,).
            inertia: As of `mass_matrix`.
            by: Of `half_way`, for this inertia or one that is near.
        """
        step = h[:, None]
        middle = v + 0.5 * step * self.acceleration(by.first, inertia)
        return moved(q, step * middle), v + step * self.acceleration(by.middle, inertia)

    def transition(self, q: Array, v: Array, h: Array, inertia: Array) -> Array:
        """Derivatives of `ahead` by the error of the state (N, 2 nv, 2 nv), in tangent spaces.

        Args:
            q: Configurations, (N, nq).
            v: Velocities, (N, nv).
            h: Times [s], (N,).
            inertia: As of `mass_matrix`.
        """
        nv = v.shape[-1]

        def ahead(q: Array, v: Array) -> tuple[Array, Array]:
            return self.ahead(q, v, h, inertia, self.half_way(q, v, h, inertia))

        F = np.broadcast_to(np.eye(2 * nv), (len(h), 2 * nv, 2 * nv)).copy()
        F[:, :3, nv : nv + 3] += h[:, None, None] * np.eye(3)  # where it is and how fast enter nothing else
        q_next, v_next = ahead(q, v)
        for i in (*range(3, nv), *range(nv + 3, 2 * nv)):
            error = np.zeros(2 * nv)
            error[i] = SMALL
            q_off, v_off = ahead(moved(q, np.broadcast_to(error[:nv], v.shape)), v + error[nv:])
            F[..., i] = np.concatenate([difference(q_off, q_next), v_off - v_next], axis=-1) / SMALL
        return F

    def _arm(self, q: Array) -> Array:
        """From the base's origin to the common centre of mass, (*s, 3) [m]."""
        pos, quat = body_poses(self._model, _with_first(q, np.zeros(3)))
        return np.asarray(np.einsum("b,...bi->...i", self._share, pos + quat_rotate(quat, self._model.com)))


def _with_first(x: Array, first: Array) -> Array:
    """Vectors (*s, n) with other first three numbers."""
    return np.concatenate([np.broadcast_to(first, (*x.shape[:-1], 3)), x[..., 3:]], axis=-1)
