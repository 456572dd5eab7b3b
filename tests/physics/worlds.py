"""Cubes that fly, lie and slide in a world."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel, corner_positions
from tossid.physics import Simulation, simulate
from tossid.physics.effects import RecordingErrors, World

Array = NDArray[np.float64]

DT = 1 / 148
HALF = 0.0524
"""Half an edge of the cube [m]."""
STRANGE_RECORDING = RecordingErrors(
    length_scale=1.1, clock_rate=0.9, frame_offset=(0.01, -0.02, 0.03), world_tilt=(-0.06, 0.1)
)


def run(
    world: World, q: list[float], v: list[float], *, seconds: float, substeps: int = 4, dt: float = DT
) -> Simulation:
    system = world.system()
    return simulate(system, np.array([q]), np.array([v]), n_steps=round(seconds / dt), dt=dt, substeps=substeps)


def flat(height: float = HALF, *, x: float = 0.0) -> list[float]:
    """A cube that lies flat."""
    return [x, 0.0, height, 1.0, 0.0, 0.0, 0.0]


def slide(world: World, *, speed: float, heading: float = 0.0, seconds: float = 0.3, substeps: int = 8) -> Array:
    """Velocity (T + 1, 2) of a cube that slides flat without turning: its inertia is made large."""
    heavy = world.object.with_changes(inertia=1e6 * world.object.inertia)
    v = [speed * np.cos(heading), speed * np.sin(heading), 0, 0, 0, 0]
    done = run(World(**{**world.__dict__, "object": heavy}), flat(), v, seconds=seconds, substeps=substeps)
    return done.v[0, :, :2]


def states(count: int) -> tuple[Array, Array]:
    """States (count, 7), (count, 6) in the air."""
    rng = np.random.default_rng(3)
    q = np.concatenate([rng.uniform(-0.2, 0.2, (count, 3)), rng.normal(size=(count, 4))], axis=1)
    q[:, 2] += 0.5
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    return q, rng.normal(size=(count, 6)) * [1, 1, 1, 5, 5, 5]


def energy(model: ObjectModel, q: Array, v: Array) -> Array:
    """Kinetic, potential and the springs' (*b,) [J], of a body whose frame is at its centre of mass."""
    spin = np.einsum("...i,ij,...j->...", v[..., 3:], model.inertia[0], v[..., 3:])
    total = 0.5 * (spin + model.mass[0] * (v[..., :3] ** 2).sum(-1)) + model.mass[0] * 9.81 * q[..., 2]
    if model.compliance > 0:
        total += 0.5 / model.compliance * (np.minimum(corner_positions(model, q)[..., 2], 0) ** 2).sum(-1)
    return np.asarray(total)
