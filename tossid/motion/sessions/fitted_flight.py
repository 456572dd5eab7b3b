"""Free flight of a rigid body that is fitted to a few frames, and continued beyond them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel
from tossid.rotations import quat_boxminus, quat_exp, quat_mul, quat_rotate
from tossid.types import PoseTrack

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FittedFlight:
    """Free flight of a rigid body: x = c + u s - g s²/2 e_z, R = R_0 exp(w s + a s²/2), s = t - t_0.

    Attributes:
        t: t_0 [s].
        line: c and u, (2, 3).
        quat: R_0, (4,).
        turn: Rotation vector at t_0 and w, in the body's frame, (2, 3).
        spin_rate: a: what Euler's equations make of w, (3,).
        gravity: g [m/s²].
        com: Centre of mass in the body's frame [m], (3,).
    """

    t: float
    line: Array
    quat: Array
    turn: Array
    spin_rate: Array
    gravity: float
    com: Array

    @classmethod
    def fitted(cls, track: PoseTrack, some: slice, model: ObjectModel, gravity: float) -> FittedFlight:
        """The flight that is nearest to some frames, in least squares of places and of attitudes.

        Args:
            track: As recorded.
            some: Which frames.
            model: The object, without joints.
            gravity: [m/s²].
        """
        t, q, I = track.t[some], track.q[some], model.inertia[0]
        middle, quat = float(t.mean()), q[len(q) // 2, 3:7]
        s = (t - middle)[:, None]
        line = np.linalg.pinv(np.hstack([np.ones_like(s), s]))
        c = q[:, :3] + quat_rotate(q[:, 3:7], model.com[0])
        c[:, 2:] += 0.5 * gravity * s**2
        turned, spin_rate = quat_boxminus(q[:, 3:7], quat), np.zeros(3)
        for _ in range(3):
            turn = line @ (turned - 0.5 * spin_rate * s**2)
            spin_rate = np.linalg.solve(I, np.cross(I @ turn[1], turn[1]))
        return cls(middle, line @ c, quat, turn, spin_rate, gravity, model.com[0])

    def at(self, t: Array) -> tuple[Array, Array]:
        """Centre of mass (m, 3) and attitude (m, 4).

        Args:
            t: (m,) times [s].
        """
        s = (t - self.t)[:, None]
        c = self.line[0] + s * self.line[1]
        c[:, 2:] -= 0.5 * self.gravity * s**2
        return c, quat_mul(self.quat, quat_exp(self.turn[0] + s * self.turn[1] + 0.5 * s**2 * self.spin_rate))

    def distance(self, other: FittedFlight, t: Array, other_t: Array, arm: float) -> Array:
        """From another flight at other times, rotations times an arm [m], (m, 6).

        Args:
            other: The other flight.
            t: (m,) times of this one [s].
            other_t: (m,) times of the other [s].
            arm: [m].
        """
        (c, quat), (other_c, other_quat) = self.at(t), other.at(other_t)
        return np.hstack([other_c - c, arm * quat_boxminus(other_quat, quat)])

    def off(self, t: Array, q: Array, arm: float) -> Array:
        """How far poses are from the flight, rotations times an arm [m], (m, 6).

        Args:
            t: (m,) times [s].
            q: (m, 7) poses.
            arm: [m].
        """
        c, quat = self.at(t)
        return np.hstack([q[:, :3] + quat_rotate(q[:, 3:7], self.com) - c, arm * quat_boxminus(q[:, 3:7], quat)])

    def misfit(self, track: PoseTrack, some: slice, arm: float) -> float:
        """Root mean square distance of frames from the flight [m].

        Args:
            track: As recorded.
            some: Which frames.
            arm: With which rotations count [m].
        """
        return float(np.sqrt((self.off(track.t[some], track.q[some], arm) ** 2).sum(axis=1).mean()))
