"""Tosses of known truth, as a tracker would see them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tests.models.made import DT, thrown
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.likelihood.states import difference, moved_pose
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.motion import label_phases
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effects_for
from tossid.types import Toss

POSITION, ROTATION = 1.5e-4, 1.5e-3
"""Standard deviations of the noise [m], [rad]."""


def seen(
    world: World, nominal: ObjectModel, count: int, *, seed: int, frames: int = 90, height: float = 0.0
) -> list[Toss]:
    """Tosses of a world, thrown from so much higher than usual, recorded with noise.

    Velocities are those of the truth, off by 3 cm/s and 0.3 rad/s.
    """
    rng = np.random.default_rng(seed)
    q, v = thrown(rng, count, nominal.n_joints)
    q[:, 2] += height
    return recorded(world.roll_out(q, v, n_steps=frames, dt=DT, substeps=32, impact_parts=8), nominal, rng)


def sample_of(tosses: Sequence[Toss], model: ObjectModel) -> Sample:
    return Sample(make_windows(tosses, model), len(tosses))


def recorded(run: np.ndarray, nominal: ObjectModel, rng: np.random.Generator) -> list[Toss]:
    """Motions (B, T + 1, nq) as tosses, with noise."""
    rows, nv = run.shape[1], nominal.nv
    t = np.arange(rows) * DT
    q_cov, v_cov = (
        np.broadcast_to(np.diag([place**2] * 3 + [turn**2] * (nv - 3)), (rows, nv, nv)).copy()
        for place, turn in ((POSITION, ROTATION), (0.03, 0.3))
    )
    out = []
    for i, truth in enumerate(run):
        velocity = np.zeros((rows, nv))
        velocity[:, :3] = np.gradient(truth[:, :3], DT, axis=0) + 0.03 * rng.normal(size=(rows, 3))
        off = [POSITION * rng.normal(size=(rows, 3)), ROTATION * rng.normal(size=(rows, nv - 3))]
        poses = moved_pose(truth, np.concatenate(off, axis=1))
        rate = difference(poses[1:], poses[:-1])[:, 3:] / DT
        velocity[:, 3:] = np.concatenate([rate, rate[-1:]]) + 0.3 * rng.normal(size=(rows, nv - 3))
        phase = label_phases(nominal, t, poses, velocity, gravity=9.81)
        out.append(Toss(str(i), t, poses, velocity, q_cov, v_cov, phase))
    return out


def with_effect(model: ObjectModel, name: str, values: list[float]) -> World:
    effect = next(effect for effect in effects_for(model) if effect.name == name)
    return effect.at(World(model), np.array(values))
