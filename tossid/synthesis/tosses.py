"""Synthetic tosses: in which world they happen, how they begin, where they end, what noise is added.

Tosses are simulated in the ground's frame of their world, and written as that world records them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tossid.errors import ConfigError, nearest
from tossid.motion import label_phases
from tossid.objects import ObjectModel, corner_heights, corner_positions
from tossid.physics.effects import World, all_effects, effects_for
from tossid.rotations import quat_exp, quat_mul
from tossid.settings.synthesis import NoiseSettings, ReleaseSettings, SynthesizeSettings
from tossid.synthesis.engines import ENGINES, able
from tossid.types import Toss

Array = NDArray[np.float64]

REST_SPEED = 0.01
"""Speed below which every corner of an object at rest stays [m/s]."""
_Q_FLOOR, _V_FLOOR = 1e-6, 1e-5
"""Standard deviations stated for exact states: solvers divide by them."""


def draw_releases(
    model: ObjectModel, release: ReleaseSettings, n: int, *, gravity: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """States at which tosses begin.

    Args:
        model: What is tossed.
        release: The limits between which values are drawn.
        n: How many.
        gravity: Downward [m/s²], to aim: the object first comes down within `release.landing` of the origin.
        rng: What draws.

    Returns:
        q (n, nq) and v (n, nv).
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
    q[:, 2] = height - corner_heights(model, q).min(axis=1)
    landing = release.landing * np.sqrt(rng.uniform(size=(n, 1))) * _directions(rng.uniform(0, 2 * np.pi, n))
    q[:, :2] = landing - v[:, :2] * _fall_time(height, v[:, 2], gravity)[:, None]
    return q, v


def world_of(settings: SynthesizeSettings, model: ObjectModel) -> World:
    """The nominal world with the effects of the settings, applied in their order.

    Raises:
        ConfigError: An effect or a parameter is not in the library, a value is out of its range, or the engine does
            not have the effect.
    """
    library = {effect.name: effect for effect in effects_for(model)}
    world = World(model, gravity=settings.gravity)
    for name, given in settings.effects.items():
        effect = library.get(name)
        if effect is None and name in {other.name for other in all_effects()}:
            raise ConfigError(f"effects.{name}", f"'{model.name}' has no joints.")
        if effect is None:
            near = nearest(name, library)
            raise ConfigError(f"effects.{name}", "there is no such effect in the library.", suggestion=near)
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
        if ENGINES[settings.engine.name].lacks(world):
            can = " and ".join(f"engine={other}" for other in able(world)) or "none"
            raise ConfigError(f"effects.{name}", f"engine={settings.engine.name} cannot express it; {can} can.")
    return world


def frames_until_rest(model: ObjectModel, q: Array, settings: SynthesizeSettings) -> int:
    """How many frames of a motion to keep: until it has been at rest for a while.

    Args:
        model: The object that moves.
        q: (n, nq) configurations.
        settings: What counts as rest, and for how long it is kept.
    """
    corners = corner_positions(model, q)
    speed = np.linalg.norm(np.diff(corners, axis=0), axis=-1).max(axis=-1) * settings.rate_hz
    moving = np.flatnonzero(speed > REST_SPEED)
    rest = int(moving[-1]) + 1 if len(moving) else 0
    return int(min(len(q), max(2, rest + round(settings.rest_s * settings.rate_hz) + 1)))


def make_tosses(
    settings: SynthesizeSettings, model: ObjectModel, rng: np.random.Generator
) -> tuple[tuple[Toss, ...], int]:
    """Tosses as they are recorded without noise, each from time 0 until it rests, with their true phases.

    Args:
        settings: World, engine and releases.
        model: What is tossed.
        rng: What draws the releases.

    Returns:
        The tosses, and in how many time steps the contact problem missed its tolerance.

    Raises:
        ConfigError: The engine or the library does not have an effect.
        DivergedError: A motion became non-finite.
    """
    world = world_of(settings, model)
    q0, v0 = draw_releases(world.object, settings.release, settings.tosses, gravity=world.gravity, rng=rng)
    n_steps = max(2, round(settings.seconds * settings.rate_hz))
    dt = 1.0 / (settings.rate_hz * world.recording.clock_rate)
    simulate = partial(ENGINES[settings.engine.name].simulate, settings.engine, world)
    true = simulate(q0, v0, n_steps=n_steps, dt=dt)
    _, v = world.recorded(true.q, true.v)
    q = world.recorded_motions(
        true.q,
        true.v,
        n_steps=n_steps,
        dt=dt,
        onward=lambda q, v, n_steps, dt: simulate(q, v, n_steps=n_steps, dt=dt)[:2],
    )
    width = len(str(len(q0) - 1))
    tosses = []
    for i in range(len(q0)):
        n = frames_until_rest(model, q[i], settings)
        t = np.arange(n) / settings.rate_hz
        true_t = t / world.recording.clock_rate
        tosses.append(
            Toss(
                name=f"{i:0{width}d}",
                t=t,
                q=q[i, :n],
                v=v[i, :n],
                q_cov=_constant_cov(np.full(model.nv, _Q_FLOOR), n),
                v_cov=_constant_cov(np.full(model.nv, _V_FLOOR), n),
                phase=label_phases(world.object, true_t, true.q[i, :n], true.v[i, :n], gravity=world.gravity),
            )
        )
    return tuple(tosses), true.unsolved


def with_apparent_phases(tosses: Sequence[Toss], model: ObjectModel, settings: SynthesizeSettings) -> tuple[Toss, ...]:
    """Tosses with the phases that the nominal object's recorded motion has, in place of the true ones."""
    sigma = float(np.hypot(settings.noise.velocity, 0.5 * model.width * settings.noise.spin))
    return tuple(
        replace(toss, phase=label_phases(model, toss.t, toss.q, toss.v, gravity=settings.gravity, v_sigma=sigma))
        for toss in tosses
    )


def add_noise(
    tosses: Sequence[Toss], model: ObjectModel, noise: NoiseSettings, rng: np.random.Generator
) -> tuple[Toss, ...]:
    """Tosses as a sensor with independent Gaussian errors measures them; their covariances say so."""
    joints = model.n_joints
    q_std = np.array([noise.position] * 3 + [noise.rotation] * 3 + [noise.joint] * joints)
    v_std = np.array([noise.velocity] * 3 + [noise.spin] * 3 + [noise.joint_rate] * joints)
    measured = []
    for toss in tosses:
        n = len(toss)
        dq = q_std * rng.normal(size=(n, model.nv))
        q = toss.q.copy()
        q[:, :3] += dq[:, :3]
        q[:, 3:7] = quat_mul(q[:, 3:7], quat_exp(dq[:, 3:6]))
        q[:, 7:] += dq[:, 6:]
        measured.append(
            replace(
                toss,
                q=q,
                v=toss.v + v_std * rng.normal(size=(n, model.nv)),
                q_cov=_constant_cov(np.maximum(q_std, _Q_FLOOR), n),
                v_cov=_constant_cov(np.maximum(v_std, _V_FLOOR), n),
            )
        )
    return tuple(measured)


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
