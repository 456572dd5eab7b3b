"""True motions of an audit's cases, and the strength at which an effect moves the object by a given distance."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tossid.audit.strengths import strengths_for, world_with
from tossid.audit.unknown_forces import UNKNOWN_FORCES, Push, push_of
from tossid.objects import ObjectModel, corner_positions
from tossid.physics import simulate
from tossid.physics.effects import World
from tossid.physics.effects.strength import Values

Array = NDArray[np.float64]

THROWS = 16
"""By which the strength of an effect is found."""
SECONDS = 0.9
"""Length of these throws [s]."""
SUBSTEPS = 32
"""Time steps a frame, of throws and of forces outside the library: far more than a diagnosis takes, whose errors the
truth must not share."""
IMPACT_PARTS = 8
"""Parts of such a time step in which contact gives way, where impacts have a duration."""
REST_SPEED = 0.01
"""Speed below which the object rests [m/s]."""
TRIES = 8
"""Most strengths that are tried."""
TOLERANCE = 0.2
"""Logarithm of the ratio of reached to wanted displacement at which the search ends."""


def motion(
    world: World, q0: Array, v0: Array, *, n_steps: int, dt: float, push: Push | None = None
) -> tuple[Array, Array]:
    """True motions in the ground's frame.

    A push acts in kicks at the ends of half frames, second order in time. It goes through the body's origin, where the
    stated object has its centre of mass.

    Args:
        world: What is simulated.
        q0: First configurations (B, nq).
        v0: First velocities (B, nv).
        n_steps: Frames after the first.
        dt: Time between frames [s].
        push: A force that the world does not have.

    Returns:
        q (B, n_steps + 1, nq) and v (B, n_steps + 1, nv).
    """
    system = world.system()
    if push is None:
        run = simulate(system, q0, v0, n_steps=n_steps, dt=dt, substeps=SUBSTEPS, impact_parts=IMPACT_PARTS)
        return run.q, run.v
    q, v = np.empty((len(q0), n_steps + 1, q0.shape[1])), np.empty((len(q0), n_steps + 1, v0.shape[1]))
    q[:, 0], v[:, 0] = q0, v0
    h, mass = 0.5 * dt, float(world.object.mass.sum())
    for frame in range(n_steps):
        q1, v1 = q[:, frame], v[:, frame]
        for half in range(2):
            t = frame * dt + half * h
            v1 = v1.copy()
            v1[:, :3] += 0.5 * h / mass * push(t, q1, v1)
            run = simulate(system, q1, v1, n_steps=1, dt=h, substeps=SUBSTEPS // 2, impact_parts=IMPACT_PARTS)
            q1, v1 = run.q[:, 1], run.v[:, 1].copy()
            v1[:, :3] += 0.5 * h / mass * push(t + h, q1, v1)
        q[:, frame + 1], v[:, frame + 1] = q1, v1
    return q, v


def displacement_between(one: Array, other: Array, dt: float, model: ObjectModel) -> float:
    """The distance [m] between two recordings of the same throws: median over tosses of the median over frames.

    It is the distance of the object's origin or, where there are joints, the mean distance of its corners. Frames count
    until the first motion rests.

    Args:
        one: Recorded configurations (B, T, nq).
        other: The same under another world (B, T, nq).
        dt: Time between frames [s].
        model: The object.
    """
    one, other = (corner_positions(model, q) if model.n_joints else q[..., None, :3] for q in (one, other))
    speed = np.linalg.norm(np.diff(one, axis=1), axis=-1).mean(-1) / dt
    distances = []
    for i in range(len(one)):
        moving = np.flatnonzero(speed[i] > REST_SPEED)
        n = int(moving[-1]) + 2 if len(moving) else 2
        distances.append(float(np.median(np.linalg.norm(one[i, :n] - other[i, :n], axis=-1).mean(-1))))
    return float(np.median(distances))


def strength_reaching(
    name: str,
    target: float,
    world: World,
    q0: Array,
    v0: Array,
    *,
    noise: float,
    n_steps: int,
    dt: float,
    seed: int,
) -> tuple[Values, float]:
    """Values of an effect that displace the object by a multiple of the position noise.

    Args:
        name: An effect of the library, or one of `UNKNOWN_FORCES`.
        target: The displacement that is wanted, over the noise.
        world: The world without it.
        q0: First configurations of throws (B, nq), true ones in the ground's frame.
        v0: First velocities of throws (B, nv).
        noise: Standard deviation of recorded positions [m].
        n_steps: Frames after the first.
        dt: Time between recorded frames [s].
        seed: Seed of the signs, directions and of what has no size.

    Returns:
        The values, and the displacement over the noise that they reach. It differs from the target where the effect's
        range has nothing nearer.
    """
    strength = UNKNOWN_FORCES[name] if name in UNKNOWN_FORCES else strengths_for(world.object)[name]
    u = np.random.default_rng([seed, 3]).uniform(-1, 1, 8)
    plain = world.recorded_poses(motion(world, q0, v0, n_steps=n_steps, dt=dt)[0])
    low, high = math.log(strength.low), math.log(strength.high)
    at, best = 0.5 * (low + high), None
    for _ in range(TRIES):
        values = {key: float(x) for key, x in strength.values(math.exp(at), u).items()}
        if name not in UNKNOWN_FORCES:
            there = world_with(world, {name: values})
            clocked = dt / there.recording.clock_rate
            moved = there.recorded_poses(motion(there, q0, v0, n_steps=n_steps, dt=clocked)[0])
        else:
            push = push_of(name, values, count=len(q0), seconds=n_steps * dt, seed=seed)
            moved = world.recorded_poses(motion(world, q0, v0, n_steps=n_steps, dt=dt, push=push)[0])
        ratio = displacement_between(plain, moved, dt, world.object) / noise
        off = math.log(max(ratio, 1e-3) / target)
        if best is None or abs(off) < best[0]:
            best = (abs(off), values, ratio)
        if abs(off) < TOLERANCE:
            break
        low, high = (at, high) if off < 0 else (low, at)
        at = at - off if low < at - off < high else 0.5 * (low + high)
    assert best is not None
    return best[1], best[2]
