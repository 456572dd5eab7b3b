"""Synthetic tosses: how they begin, how an engine carries them on, where they end, what noise is added."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipelines.schemas import MujocoEngine, NoiseConfig, ReleaseConfig, SynthesizeConfig
from tossid.errors import DivergedError
from tossid.objects import ObjectModel, corner_positions
from tossid.rotations import quat_exp, quat_mul
from tossid.types import Toss

Array = NDArray[np.float64]

REST_SPEED = 0.01
"""[m/s] below which every corner of an object at rest stays."""

_Q_FLOOR, _V_FLOOR = 1e-6, 1e-5
"""Standard deviations stated for exact states: solvers divide by them."""


def draw_releases(
    model: ObjectModel, release: ReleaseConfig, n: int, *, gravity: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """States at which tosses begin.

    Args:
        n: how many.
        gravity: [m/s²], to aim: the object first comes down within `release.landing` of the origin.

    Returns:
        q (n, nq), v (n, nv).
    """
    quat = rng.normal(size=(n, 4))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    q = np.concatenate([np.zeros((n, 3)), quat, rng.uniform(*release.joint, size=(n, model.n_joints))], axis=1)
    v = np.zeros((n, model.nv))
    heading = _directions(rng.uniform(0, 2 * np.pi, n))
    v[:, :2] = rng.uniform(*release.speed, size=(n, 1)) * heading
    v[:, 2] = rng.uniform(*release.climb, size=n)
    axis = rng.normal(size=(n, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    v[:, 3:6] = rng.uniform(*release.spin, size=(n, 1)) * axis
    v[:, 6:] = rng.uniform(*release.joint_rate, size=(n, model.n_joints))

    height = rng.uniform(*release.height, size=n)
    q[:, 2] = height - corner_positions(model, q)[..., 2].min(axis=1)
    landing = release.landing * np.sqrt(rng.uniform(size=(n, 1))) * _directions(rng.uniform(0, 2 * np.pi, n))
    q[:, :2] = landing - v[:, :2] * _fall_time(height, v[:, 2], gravity)[:, None]
    return q, v


def simulate(config: SynthesizeConfig, model: ObjectModel, q0: Array, v0: Array) -> tuple[Array, Array, int]:
    """Motions from the given states.

    Args:
        q0: (n, nq). v0: (n, nv).

    Returns:
        q (n, T, nq), v (n, T, nv), T frames with the first, and in how many time
        steps the contact problem missed its tolerance.

    Raises:
        DivergedError: a motion became non-finite.
    """
    n_steps = max(2, round(config.seconds * config.rate_hz))
    dt, engine = 1.0 / config.rate_hz, config.engine
    threads = os.cpu_count() or 1
    if isinstance(engine, MujocoEngine):
        from tossid.physics.mujoco_engine import simulate_mujoco

        q, v = simulate_mujoco(
            model, q0, v0, n_steps, dt, substeps=engine.substeps, gravity=config.gravity, n_threads=threads
        )
        return q, v, 0
    from tossid.physics import make_system
    from tossid.physics import simulate as simulate_lcp

    done = simulate_lcp(
        make_system(model, gravity=config.gravity),
        q0,
        v0,
        n_steps=n_steps,
        dt=dt,
        substeps=engine.substeps,
        n_directions=engine.directions,
        n_threads=threads,
    )
    if not done.finite.all():
        lost = int(np.argmin(done.finite))
        raise DivergedError(f"toss {lost} of engine lcp became non-finite", state=(q0[lost], v0[lost]))
    return done.q, done.v, int(done.unsolved.sum())


def cut_at_rest(model: ObjectModel, q: Array, v: Array, *, rate_hz: float, rest_s: float) -> int:
    """How many frames of a motion to keep: until it has been at rest for `rest_s`. q (n, nq), v (n, nv) -> count."""
    corners = corner_positions(model, q)
    speed = np.linalg.norm(np.diff(corners, axis=0), axis=-1).max(axis=-1) * rate_hz
    moving = np.flatnonzero(speed > REST_SPEED)
    rest = int(moving[-1]) + 1 if len(moving) else 0
    return int(min(len(q), max(2, rest + round(rest_s * rate_hz) + 1)))


def make_tosses(config: SynthesizeConfig, model: ObjectModel, rng: np.random.Generator) -> tuple[tuple[Toss, ...], int]:
    """True tosses, each from time 0 until it rests, and the number of unsolved time steps."""
    from tossid.motion import label_phases

    q0, v0 = draw_releases(model, config.release, config.tosses, gravity=config.gravity, rng=rng)
    q, v, unsolved = simulate(config, model, q0, v0)
    width = len(str(config.tosses - 1))
    tosses = []
    for i in range(config.tosses):
        n = cut_at_rest(model, q[i], v[i], rate_hz=config.rate_hz, rest_s=config.rest_s)
        t = np.arange(n) / config.rate_hz
        tosses.append(
            Toss(
                name=f"{i:0{width}d}",
                t=t,
                q=q[i, :n],
                v=v[i, :n],
                q_cov=_constant_cov(np.full(model.nv, _Q_FLOOR), n),
                v_cov=_constant_cov(np.full(model.nv, _V_FLOOR), n),
                phase=label_phases(model, t, q[i, :n], v[i, :n], gravity=config.gravity),
            )
        )
    return tuple(tosses), unsolved


def add_noise(
    tosses: Sequence[Toss], model: ObjectModel, noise: NoiseConfig, rng: np.random.Generator
) -> tuple[Toss, ...]:
    """Tosses as a sensor with independent Gaussian errors would see them; covariances say so."""
    joints = model.n_joints
    q_std = np.array([noise.position] * 3 + [noise.rotation] * 3 + [noise.joint] * joints)
    v_std = np.array([noise.velocity] * 3 + [noise.spin] * 3 + [noise.joint_rate] * joints)
    seen = []
    for toss in tosses:
        n = len(toss)
        dq = q_std * rng.normal(size=(n, model.nv))
        q = toss.q.copy()
        q[:, :3] += dq[:, :3]
        q[:, 3:7] = quat_mul(q[:, 3:7], quat_exp(dq[:, 3:6]))
        q[:, 7:] += dq[:, 6:]
        seen.append(
            replace(
                toss,
                q=q,
                v=toss.v + v_std * rng.normal(size=(n, model.nv)),
                q_cov=_constant_cov(np.maximum(q_std, _Q_FLOOR), n),
                v_cov=_constant_cov(np.maximum(v_std, _V_FLOOR), n),
            )
        )
    return tuple(seen)


def _directions(angle: Array) -> Array:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _fall_time(height: Array, climb: Array, gravity: float) -> Array:
    """Time [s] until something at `height` with upward velocity `climb` comes down to 0."""
    if gravity == 0:
        return np.zeros_like(height)
    time: Array = (climb + np.sqrt(climb**2 + 2 * gravity * height)) / gravity
    return time


def _constant_cov(std: Array, n: int) -> Array:
    return np.broadcast_to(np.diag(std**2), (n, len(std), len(std))).copy()
