"""Tosses of known truth."""

from __future__ import annotations

import numpy as np

from tossid.models.predictor import Simulator
from tossid.objects import ObjectModel
from tossid.physics import make_system, simulate
from tossid.settings.training import ModelSettings
from tossid.types import Toss

DT = 1 / 148


def thrown(rng: np.random.Generator, count: int, n_joints: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """States (count, nq), (count, nv) above the ground, turned and thrown anyhow."""
    q = np.zeros((count, 7 + n_joints))
    q[:, 2] = rng.uniform(0.12, 0.3, count)
    q[:, 3:7] = rng.normal(size=(count, 4))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    v = np.concatenate([rng.normal(size=(count, 3)), 4 * rng.normal(size=(count, 3))], axis=1)
    q[:, 7:] = rng.uniform(-3, 3, (count, n_joints))
    return q, np.concatenate([v, 4 * rng.normal(size=(count, n_joints))], axis=1)


def toss_of(
    name: str,
    q: np.ndarray,
    v: np.ndarray | None = None,
    *,
    dt: float = DT,
    cov: float | np.ndarray = 0.0,
    phase: int | np.ndarray = 0,
) -> Toss:
    """A toss of poses (n, nq), exactly known and without velocity unless it is stated.

    cov: of poses and of velocities alike, (nv, nv) or a variance.
    """
    n, nv = len(q), q.shape[1] - 1
    covs = np.tile(cov * np.eye(nv) if np.ndim(cov) == 0 else cov, (n, 1, 1))
    phases = np.broadcast_to(np.asarray(phase, dtype=np.uint8), n).copy()
    return Toss(name, dt * np.arange(n), q, np.zeros((n, nv)) if v is None else v, covs, covs, phases)


def tosses(model: ObjectModel, count: int, *, seed: int, frames: int = 70, substeps: int = 1) -> list[Toss]:
    """Tosses by the LCP engine, without noise. Impacts happen where steps end, unless rollouts take these steps."""
    q, v = thrown(np.random.default_rng(seed), count, model.n_joints)
    parts = ModelSettings.impact_parts if substeps == ModelSettings.substeps else 1
    simulator = Simulator(make_system(model), substeps=substeps, impact_parts=parts)
    run = simulator.rollout(q, v, n_steps=frames, dt=DT)
    return [toss_of(str(i), run.q[i], run.v[i]) for i in range(count)]


def flights(model: ObjectModel, count: int, *, noise: float = 0.0) -> list[Toss]:
    """Tosses that come nowhere near the ground, with noise [m/s] of the base's velocity."""
    rng = np.random.default_rng(0)
    q, v = thrown(rng, count, model.n_joints)
    q[:, 2] += 1.0
    run = simulate(make_system(model), q, v, n_steps=30, dt=DT, substeps=16)
    run.v[..., :3] += noise * rng.normal(size=(count, 31, 3))
    return [toss_of(str(i), run.q[i], run.v[i]) for i in range(count)]
