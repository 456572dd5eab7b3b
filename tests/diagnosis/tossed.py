"""Tosses of known truth, as a tracker would see them."""

from __future__ import annotations

import numpy as np

from tests.models.made import DT, thrown
from tossid.diagnosis.likelihood.states import difference, moved_pose
from tossid.motion import label_phases
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effects_for
from tossid.rotations import quat_boxminus, quat_exp, quat_mul
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.types import Toss

POSITION, ROTATION = 1.5e-4, 1.5e-3
"""Standard deviations of the noise [m], [rad]."""
ONCE = DiagnoseSettings(repeats=0)
"""No search is repeated, which would take several times as long."""


def seen(world: World, nominal: ObjectModel, count: int, *, seed: int, frames: int = 90) -> list[Toss]:
    """Tosses of a world, recorded with noise; velocities are those of the truth, off by 3 cm/s and 0.3 rad/s."""
    rng = np.random.default_rng(seed)
    q, v = thrown(rng, count)
    return recorded(world.roll_out(q, v, n_steps=frames, dt=DT, substeps=32, impact_parts=8), nominal, rng)


def recorded(run: np.ndarray, nominal: ObjectModel, rng: np.random.Generator) -> list[Toss]:
    """Motions (B, T + 1, 7) of a free body as tosses, with noise."""
    count, frames = len(run), run.shape[1] - 1
    t = np.arange(frames + 1) * DT
    q_cov = np.broadcast_to(np.diag([POSITION**2] * 3 + [ROTATION**2] * 3), (frames + 1, 6, 6)).copy()
    v_cov = np.broadcast_to(np.diag([0.03**2] * 3 + [0.3**2] * 3), (frames + 1, 6, 6)).copy()
    out = []
    for i in range(count):
        poses = run[i].copy()
        speed = np.gradient(poses[:, :3], DT, axis=0) + 0.03 * rng.normal(size=(frames + 1, 3))
        poses[:, :3] += POSITION * rng.normal(size=(frames + 1, 3))
        poses[:, 3:] = quat_mul(poses[:, 3:], quat_exp(ROTATION * rng.normal(size=(frames + 1, 3))))
        velocity = np.concatenate([speed, np.zeros((frames + 1, 3))], axis=1)
        velocity[:, 3:] = _spin(poses) + 0.3 * rng.normal(size=(frames + 1, 3))
        phase = label_phases(nominal, t, poses, velocity, gravity=9.81)
        out.append(Toss(str(i), t, poses, velocity, q_cov, v_cov, phase))
    return out


def _spin(poses: np.ndarray) -> np.ndarray:
    rate = quat_boxminus(poses[1:, 3:], poses[:-1, 3:]) / DT
    return np.concatenate([rate, rate[-1:]])


def seen_with_joint(
    world: World, nominal: ObjectModel, count: int, *, seed: int, frames: int, height: float
) -> list[Toss]:
    """Tosses of a world from so much higher than where a cube is thrown, recorded with noise."""
    rng = np.random.default_rng(seed)
    q, v = thrown(rng, count)
    q = np.concatenate([q, rng.uniform(-3, 3, (count, 1))], axis=1)
    v = np.concatenate([v, 5 * rng.normal(size=(count, 1))], axis=1)
    q[:, 2] += height
    run = world.roll_out(q, v, n_steps=frames, dt=DT, substeps=16, impact_parts=8)
    t = np.arange(frames + 1) * DT
    std = np.array([POSITION] * 3 + [ROTATION] * 4)
    cov = np.broadcast_to(np.diag(std**2), (frames + 1, 7, 7)).copy()
    v_cov = np.broadcast_to(np.diag([0.03**2] * 3 + [0.3**2] * 4), (frames + 1, 7, 7)).copy()
    out = []
    for i in range(count):
        poses = moved_pose(run[i], std * rng.normal(size=(frames + 1, 7)))
        speed = difference(poses[1:], poses[:-1]) / DT
        velocity = np.concatenate([speed, speed[-1:]])
        phase = label_phases(nominal, t, poses, velocity, gravity=9.81)
        out.append(Toss(str(i), t, poses, velocity, cov, v_cov, phase))
    return out


def with_effect(model: ObjectModel, name: str, values: list[float]) -> World:
    effect = next(effect for effect in effects_for(model) if effect.name == name)
    return effect.at(World(model), np.array(values))
