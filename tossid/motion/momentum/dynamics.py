"""Newton's and Euler's equations of a tree about its common centre of mass: mass matrix, free motion, a frame ahead.

States are (position of the common centre of mass, orientation of the base, joints) and their velocities. So the
momentum of the whole is by itself, and an impulse within a step leaves no error in it. The kinematics are those of
`tossid.physics.batch`; they do not depend on inertia, which is (n_b, 3, 3) of each body about its centre of mass, in
its frame [kg m²].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.motion.kinematics import center_of_mass, com_velocities
from tossid.motion.smoothing.system import difference, moved
from tossid.objects import ObjectModel
from tossid.physics.batch import TreeBatch, tree_batch
from tossid.physics.identifiable import energy_rows
from tossid.physics.system import make_system

Array = NDArray[np.float64]
HalfWay = tuple[TreeBatch, TreeBatch]
"""Kinematics where a step begins, and in its middle."""

SMALL = 1e-6
"""Step of differences in angle [rad], spin [rad/s], joint position and rate."""


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
        return np.concatenate([center_of_mass(self._model, q), q[..., 3:]], axis=-1)

    def com_velocity(self, q: Array, v: Array) -> Array:
        """Velocity of the common centre of mass (*s, 3) [m/s], of velocities (*s, nv) of the base and its joints."""
        return np.asarray(np.einsum("b,...bi->...i", self._share, com_velocities(self._model, q, v)))

    def at_origin(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Configurations and velocities of the base's origin, from those of the common centre of mass."""
        arm = center_of_mass(self._model, _with_first(q, np.zeros(3)))
        speed = self.com_velocity(q, _with_first(v, np.zeros(3)))
        return _with_first(q, q[..., :3] - arm), _with_first(v, v[..., :3] - speed)

    def com_jacobian(self, q: Array) -> Array:
        """Velocity of the common centre of mass by that of the base's origin, its spin and joint rates, (*s, 3, nv)."""
        unit = np.eye(self._model.nv)
        columns = [self.com_velocity(q, np.broadcast_to(e, (*q.shape[:-1], len(e)))) for e in unit]
        return np.stack(columns, axis=-1)

    def kinematics(self, q: Array, v: Array) -> TreeBatch:
        """What depends on the motion alone, at q (N, nq), v (N, nv); where the whole is and goes is left out."""
        return tree_batch(self._system, _with_first(q, np.zeros(3)), _with_first(v, np.zeros(3)))

    def mass_matrix(self, motion: TreeBatch, inertia: Array) -> Array:
        """M(q) of the base's origin, its spin and joint rates, (N, nv, nv)."""
        rows = energy_rows(motion, self._model, inertia)
        return np.asarray(rows.mT @ rows)

    def acceleration(self, at: TreeBatch, inertia: Array) -> Array:
        """dv/dt without contact, (N, nv)."""
        model, arm, w = self._model, self._model.com, at.omega
        # forces and torques that would keep dv/dt at 0, in units of the rows of kinetic energy
        a = at.xdd + np.cross(at.alpha, arm) + np.cross(w, np.cross(w, arm))
        n = np.einsum("bij,nbj->nbi", inertia, at.alpha) + np.cross(w, np.einsum("bij,nbj->nbi", inertia, w))
        root_inverse = np.linalg.inv(np.linalg.cholesky(inertia))
        y = np.concatenate([np.sqrt(model.mass)[:, None] * a, np.einsum("bij,nbj->nbi", root_inverse, n)], axis=-1)
        rows = energy_rows(at, model, inertia)
        found = -np.linalg.solve(rows.mT @ rows, rows.mT @ y.reshape(len(y), -1, 1))[..., 0]
        return _with_first(found, np.array([0.0, 0.0, -self._gravity]))

    def half_way(self, q: Array, v: Array, h: Array, inertia: Array) -> HalfWay:
        """Kinematics of states q (N, nq), v (N, nv) and of those h / 2 later, h (N,) [s]."""
        first, step = self.kinematics(q, v), h[:, None]
        middle = v + 0.5 * step * self.acceleration(first, inertia)
        return first, self.kinematics(moved(q, 0.25 * step * (v + middle)), middle)

    def ahead(self, q: Array, v: Array, h: Array, inertia: Array, by: HalfWay) -> tuple[Array, Array]:
        """The states a time h later, by the midpoint rule; `by`: of `half_way`, for this inertia or a near one."""
        first, middle = by
        step = h[:, None]
        velocity = v + 0.5 * step * self.acceleration(first, inertia)
        return moved(q, step * velocity), v + step * self.acceleration(middle, inertia)

    def transition(self, q: Array, v: Array, h: Array, inertia: Array) -> Array:
        """Derivatives of `ahead` by the error of the state (N, 2 nv, 2 nv), in tangent spaces."""
        nv = v.shape[-1]

        def ahead(q: Array, v: Array) -> tuple[Array, Array]:
            return self.ahead(q, v, h, inertia, self.half_way(q, v, h, inertia))

        F = np.broadcast_to(np.eye(2 * nv), (len(h), 2 * nv, 2 * nv)).copy()
        F[:, :3, nv : nv + 3] += h[:, None, None] * np.eye(3)  # where it is and how fast enter nothing else
        q_next, v_next = ahead(q, v)
        for i in (*range(3, nv), *range(nv + 3, 2 * nv)):
            error = SMALL * np.eye(2 * nv)[i]
            q_off, v_off = ahead(moved(q, np.broadcast_to(error[:nv], v.shape)), v + error[nv:])
            F[..., i] = np.concatenate([difference(q_off, q_next), v_off - v_next], axis=-1) / SMALL
        return F


def _with_first(x: Array, first: Array) -> Array:
    """Vectors (*s, n) with other first three numbers."""
    return np.concatenate([np.broadcast_to(first, (*x.shape[:-1], 3)), x[..., 3:]], axis=-1)
