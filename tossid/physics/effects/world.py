"""A simulator together with the way its motion is recorded: what an effect changes.

Recorded motion and the simulator's are tied by a `Recording`: lengths, clock, the frame on the body and the
world's tilt. Ground that is tilted or not at z = 0 is handled as a change of frame too: the simulator's ground stays
z = 0, and gravity is what tilts.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.objects import GRAVITY, ObjectModel
from tossid.physics.forces import Forces, Law
from tossid.physics.stepping import simulate
from tossid.physics.system import Residual, System, make_system
from tossid.rotations import quat_conj, quat_exp, quat_mul, quat_rotate

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Recording:
    """From true motion to recorded.

    length_scale: recorded length per true. clock_rate: recorded time per true. frame_offset (3,) [m]: the recorded
    frame's origin in the body's true frame. world_tilt (2,) [rad]: turn about x and y from the true world to the
    recorded one.
    """

    length_scale: float = 1.0
    clock_rate: float = 1.0
    frame_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    world_tilt: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class World:
    """An object, what pulls at it, what it lands on, and how that is recorded. SI units.

    gravity: downward [m/s²]. ground_height [m] and ground_tilt (2,) [rad about x, y] of the ground in the true world.
    """

    object: ObjectModel
    gravity: float = GRAVITY
    forces: Forces = field(default_factory=Forces)
    law: Law = field(default_factory=Law)
    ground_height: float = 0.0
    ground_tilt: tuple[float, float] = (0.0, 0.0)
    recording: Recording = field(default_factory=Recording)
    residual: Residual | None = None

    def with_changes(self, **changes: Any) -> World:
        """A copy with other values; those of `forces`, `law`, `recording` and the object by their own names."""
        return replace(self, **changes)

    def system(self) -> System:
        """The simulator, in the ground's frame."""
        down = quat_rotate(quat_conj(_tilt(self.ground_tilt)), np.array([0.0, 0.0, -self.gravity]))
        system = make_system(self.object, gravity=down, residual=self.residual)
        return system._replace(forces=np.array(self.forces, dtype=float), law=np.array(self.law, dtype=float))

    def roll_out(
        self,
        q0: Array,
        v0: Array,
        *,
        n_steps: int | NDArray[np.int64],
        dt: float,
        substeps: int,
        n_threads: int = 1,
    ) -> Array:
        """Recorded motions (B, T + 1, nq) from recorded first states (B, nq), (B, nv); NaN where one diverges."""
        r = self.recording
        turn = quat_mul(_tilt(self.ground_tilt, inverse=True), _tilt(r.world_tilt, inverse=True))
        offset = np.array(r.frame_offset)
        lift = np.array([0.0, 0.0, self.ground_height])
        q, v = q0.copy(), v0.copy()
        q[:, 3:7] = quat_mul(turn, q0[:, 3:7])
        v[:, 3:] *= r.clock_rate
        arm = quat_rotate(q[:, 3:7], offset)
        spin = quat_rotate(q[:, 3:7], v[:, 3:6])
        q[:, :3] = quat_rotate(turn, q0[:, :3]) / r.length_scale - arm - lift
        v[:, :3] = quat_rotate(turn, v0[:, :3]) * (r.clock_rate / r.length_scale) - np.cross(spin, arm)
        run = simulate(
            self.system(), q, v, n_steps=n_steps, dt=dt / r.clock_rate, substeps=substeps, n_threads=n_threads
        )
        out = run.q
        back = quat_conj(turn)
        p = out[..., :3] + quat_rotate(out[..., 3:7], offset) + lift
        out[..., :3] = quat_rotate(back, p) * r.length_scale
        out[..., 3:7] = quat_mul(back, out[..., 3:7])
        out[~run.finite] = np.nan
        return out


def _tilt(angles: tuple[float, float], *, inverse: bool = False) -> Array:
    vector = np.array([angles[0], angles[1], 0.0])
    return quat_exp(-vector if inverse else vector)
