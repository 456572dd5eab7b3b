"""Synthetic tosses: in which world they happen, how they begin, how an engine carries them on, where they end, what
noise is added.

Tosses are simulated in the ground's frame of their world, and written as that world records them.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipelines.keys import nearest
from pipelines.schemas import MujocoEngine, NoiseConfig, ReleaseConfig, SynthesizeConfig
from tossid.errors import ConfigError, DivergedError
from tossid.objects import ObjectModel, corner_positions
from tossid.rotations import quat_exp, quat_mul
from tossid.types import Toss

if TYPE_CHECKING:
    from tossid.physics.effects import World

Array = NDArray[np.float64]

REST_SPEED = 0.01
"""[m/s] below which every corner of an object at rest stays."""

IMPACT_PARTS = 8
"""Of engine lcp, where impacts have a length: where contact gives way."""

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


def world_of(config: SynthesizeConfig, model: ObjectModel) -> World:
    """The world of a call: the nominal one with the effects of its keys, in their order.

    Raises:
        ConfigError: an effect or a parameter that is not in the library, a value out of its range, or an effect that
            the engine does not have.
    """
    from tossid.physics.effects import JOINT_EFFECTS, World, library_for

    library = {effect.name: effect for effect in library_for(model)}
    world = World(model, gravity=config.gravity)
    for name, given in config.effects.items():
        effect = library.get(name)
        if effect is None and name in {joint.name for joint in JOINT_EFFECTS}:
            raise ConfigError(f"effects.{name}", f"'{model.name}' has no joints.")
        if effect is None:
            raise ConfigError(
                f"effects.{name}", "there is no such effect in the library.", suggestion=nearest(name, library)
            )
        values = effect.named(effect.nominal(world))
        for parameter, value in given.items():
            key = f"effects.{name}.{parameter}"
            if parameter not in values:
                near = nearest(parameter, values)
                raise ConfigError(key, f"is no parameter of {name}, which has {', '.join(values)}.", suggestion=near)
            own = next(p for p in effect.parameters if p.name == parameter)
            if not own.low <= value <= own.high:
                raise ConfigError(key, f"{value:g} is out of range; expected {own.low:g} to {own.high:g}.")
            values[parameter] = value
        world = effect.at(world, np.array(list(values.values())))
        _refuse_engine(config, world, name)
    return world


def _refuse_engine(config: SynthesizeConfig, world: World, name: str) -> None:
    """Say that the world, which has just got the effect, is beyond the engine."""
    if isinstance(config.engine, MujocoEngine):
        from tossid.physics.effects.in_mujoco import inexpressible

        if inexpressible(world):
            raise ConfigError(f"effects.{name}", "engine=mujoco cannot express it; engine=lcp can.")


def simulate(config: SynthesizeConfig, world: World, q0: Array, v0: Array) -> tuple[Array, Array, int]:
    """Motions in the ground's frame, at the times of recorded frames, from the given states.

    Args:
        q0: (n, nq). v0: (n, nv).

    Returns:
        q (n, T, nq), v (n, T, nv), T frames with the first, and in how many time
        steps the contact problem missed its tolerance.

    Raises:
        DivergedError: a motion became non-finite.
    """
    n_steps = max(2, round(config.seconds * config.rate_hz))
    dt, engine = 1.0 / (config.rate_hz * world.recording.clock_rate), config.engine
    threads = os.cpu_count() or 1
    if isinstance(engine, MujocoEngine):
        from tossid.physics.effects.in_mujoco import toss_in_mujoco

        q, v = toss_in_mujoco(world, q0, v0, n_steps, dt, substeps=engine.substeps, n_threads=threads)
        return q, v, 0
    from tossid.physics import simulate as simulate_lcp

    done = simulate_lcp(
        world.system(),
        q0,
        v0,
        n_steps=n_steps,
        dt=dt,
        substeps=engine.substeps,
        impact_parts=IMPACT_PARTS,
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
    """Tosses as they are recorded without noise, each from time 0 until it rests; and the number of unsolved steps.

    Their phases are the true ones.
    """
    from tossid.motion import label_phases

    world = world_of(config, model)
    q0, v0 = draw_releases(world.object, config.release, config.tosses, gravity=world.gravity, rng=rng)
    true_q, true_v, unsolved = simulate(config, world, q0, v0)
    q, v = world.recorded(true_q, true_v)
    width = len(str(config.tosses - 1))
    tosses = []
    for i in range(config.tosses):
        n = cut_at_rest(model, q[i], v[i], rate_hz=config.rate_hz, rest_s=config.rest_s)
        t = np.arange(n) / config.rate_hz
        true_t = t / world.recording.clock_rate
        tosses.append(
            Toss(
                name=f"{i:0{width}d}",
                t=t,
                q=q[i, :n],
                v=v[i, :n],
                q_cov=_constant_cov(np.full(model.nv, _Q_FLOOR), n),
                v_cov=_constant_cov(np.full(model.nv, _V_FLOOR), n),
                phase=label_phases(world.object, true_t, true_q[i, :n], true_v[i, :n], gravity=world.gravity),
            )
        )
    return tuple(tosses), unsolved


def label_as_seen(tosses: Sequence[Toss], model: ObjectModel, config: SynthesizeConfig) -> tuple[Toss, ...]:
    """Tosses with the phases that the nominal object's recorded motion shows, in place of the true ones."""
    from tossid.motion import label_phases

    sigma = float(np.hypot(config.noise.velocity, 0.5 * model.width * config.noise.spin))
    return tuple(
        replace(toss, phase=label_phases(model, toss.t, toss.q, toss.v, gravity=config.gravity, v_sigma=sigma))
        for toss in tosses
    )


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
