"""The residual wrench: the force and torque, constant over a window, that would remove a simulator's residuals.

To first order a window's whitened residuals are r = -J w + noise of unit variance, where J are their derivatives by a
wrench w that acts throughout the window, contact and all. Generalised least squares with a wide prior P gives

    w = -C J^T r,     C = (J^T J + P^-1)^-1,

where C is scaled by what is left of r where that is more than noise. The uncertainty of first states is part of the
whitening, so that a wrench is what no first state would explain. Which state of the motion explains it best is
determined by `relations`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.likelihood.windows import Windows
from tossid.diagnosis.localisation.place import Relation
from tossid.diagnosis.localisation.relations import relate
from tossid.objects import GRAVITY, ObjectModel, corner_heights
from tossid.physics import LearnedAcceleration, n_features
from tossid.physics.effects import World
from tossid.rotations import quat_boxminus, quat_conj, quat_rotate
from tossid.types import Phase

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

DIFFERENCE = 0.01
"""Step of finite differences, in weights [N] and weights times half a width [N m]."""
PRIOR = 1.0
"""Standard deviation of the wrench's prior, in the same units."""
KNOWN = 0.15
"""Share of the prior's standard deviation below which a window determines a component."""
LEAST_SPEED, LEAST_SPIN = 0.05, 0.5
"""Horizontal speed [m/s] below which it has no direction, and spin [rad/s] below which it has no axis."""


def residual_wrench(evidence: Evidence, *, seed: int = 0) -> tuple[Relation, ...]:
    """The residual wrench in flight and in contact, each with the state that explains it best.

    Args:
        evidence: Of a hypothesis.
        seed: Of signs and resamples.
    """
    windows, model = evidence.windows, evidence.hypothesis.base.object
    states, *motion = _states(windows, model)
    value, variance = _components(*wrenches(evidence), *motion)
    known = KNOWN * PRIOR * np.repeat(_units(model)[::3], 5)
    variance = np.where(variance < known**2, variance, np.inf)
    rng = np.random.default_rng(seed)
    found = [
        relate(phase, value[rows], variance[rows], states[rows], windows.toss[rows], rng)
        for phase, rows in zip(("flight", "contact"), phase_groups(windows), strict=True)
    ]
    return tuple(each for each in found if each is not None)


def wrenches(evidence: Evidence) -> tuple[Array, Array]:
    """Each window's residual wrench (W, P) and its covariance (W, P, P).

    It is a force [N] in the world's frame, P = 3, and of a single body a torque [N m] about the centre of mass in the
    body's axes, P = 6.

    Args:
        evidence: Of W windows under a hypothesis.
    """
    hypothesis, (W, L, K) = evidence.hypothesis, evidence.residuals.shape
    world = hypothesis.world()
    unit = _units(world.object)
    J = np.zeros((W, L * K, len(unit)))
    for i, push in enumerate(DIFFERENCE * np.diag(unit)):
        forth, back = (
            evidence.residuals_of(Hypothesis(with_wrench(world, sign * push), hypothesis.law)) for sign in (1, -1)
        )
        J[..., i] = (forth - back).reshape(W, -1) / (2 * DIFFERENCE)
    largest, prior = evidence.density.largest_residual, PRIOR**-2 * np.eye(len(unit))
    r = np.clip(evidence.residuals.reshape(W, -1), -largest, largest)
    H = J.mT @ J
    w = -np.linalg.solve(H + prior, J.mT @ r[..., None])[..., 0]
    left = ((r + (J @ w[..., None])[..., 0]) ** 2).sum(1) / np.maximum(K * (evidence.windows.inside.sum(1) - 1), 1)
    cov = np.linalg.inv(H / np.maximum(left, 1.0)[:, None, None] + prior)
    return w * unit, cov * np.outer(unit, unit)


def _units(model: ObjectModel) -> Array:
    """(P,) the object's weight [N] and, of a single body, its weight times half its width [N m]."""
    weight = float(model.mass.sum()) * GRAVITY
    return weight * np.array([1.0] * 3 if model.n_joints else [1.0] * 3 + [0.5 * model.width] * 3)


def with_wrench(world: World, wrench: Array) -> World:
    """The world with a constant force and torque on its body.

    The force is one of the world's own. The torque is one more unit of the learned acceleration, which is always on.

    Args:
        world: Of a single body, or with joints.
        wrench: (3,) force [N, world]; or (6,) with a torque [N m, body's axes] about a single body's centre of mass.
    """
    x, y, z = (float(f) for f in wrench[:3])
    forces = world.forces._replace(x=world.forces.x + x, y=world.forces.y + y, z=world.forces.z + z)
    world = replace(world, forces=forces)
    if not wrench[3:].any():
        return world
    old, f = world.k_res, n_features(0)
    if old is None or not len(old.linear):
        nothing = np.zeros((0, f)), np.zeros(0), np.zeros((0, 0)), np.zeros(0)
        old = LearnedAcceleration(np.zeros((6, f)), *nothing, np.zeros((6, 0)))
    spin = np.linalg.solve(world.object.inertia[0], wrench[3:])
    # acceleration of the body frame's origin, which circles the centre of mass
    always = np.zeros((len(old.linear), 1))
    always[:6, 0] = np.concatenate([np.cross(world.object.com[0], spin), spin]) / np.tanh(1.0)
    made = LearnedAcceleration(
        linear=old.linear,
        W0=np.pad(old.W0, ((0, 1), (0, 0))),
        b0=np.append(old.b0, 0.0),
        W1=np.pad(old.W1, (0, 1)),
        b1=np.append(old.b1, 1.0),
        W2=np.concatenate([old.W2, always], axis=1),
    )
    return replace(world, k_res=made)


def phase_groups(windows: Windows) -> tuple[Flags, Flags]:
    """(W,) windows that are all flight, in which no frame is twice, and (W,) windows with contact.

    Args:
        windows: Consecutive ones and those of flights.
    """
    airborne = ~(windows.inside & (windows.phase != Phase.FLIGHT)).any(1)
    last, same = windows.first + windows.steps, windows.toss[:, None] == windows.toss
    overlap = same & (windows.first[:, None] < last) & (windows.first < last[:, None])
    again = (overlap & windows.free).any(axis=1)
    return windows.free | (airborne & ~again), ~windows.free & ~airborne


def _states(windows: Windows, model: ObjectModel) -> tuple[Array, Array, Array, Array]:
    """(W, S) measured states (`relations.STATES`); mean velocity and spin (W, 3) [world]; attitude midway (W, 4)."""
    F, dt, y = windows.y.shape[1], windows.dt, windows.y
    n = np.minimum(windows.steps, F)
    there, rows = np.arange(F) < n[:, None], np.arange(len(y))
    span = (np.maximum(n - 1, 1) * dt)[:, None]
    velocity = (y[rows, n - 1, :3] - y[:, 0, :3]) / span
    # frames after a window's last are copies of it
    spin = quat_rotate(y[:, 1:, 3:7], quat_boxminus(y[:, 1:, 3:7], y[:, :-1, 3:7])).sum(1) / span
    lowest = np.where(there, corner_heights(model, y).min(-1), np.inf).min(1)
    place = np.where(there[..., None], y[..., :3], 0.0).sum(1) / n[:, None]
    states = [
        (windows.first + 0.5 * (n + 1))[:, None] * dt,
        place,
        lowest[:, None],
        velocity,
        *(np.linalg.norm(each, axis=1)[:, None] for each in (velocity[:, :2], velocity, spin)),
        spin[:, 2:],
    ]
    return np.concatenate(states, axis=1), velocity, spin, y[rows, n // 2, 3:7]


def _components(wrench: Array, cov: Array, velocity: Array, spin: Array, attitude: Array) -> tuple[Array, Array]:
    """(W, C) components of wrenches, and their variances, infinite along a direction that does not exist."""
    axes = [np.broadcast_to(axis, velocity.shape) for axis in np.eye(3)]
    speed, rate = np.linalg.norm(velocity[:, :2], axis=1), np.linalg.norm(spin, axis=1)
    along = velocity * [1.0, 1.0, 0.0] / np.maximum(speed, LEAST_SPEED)[:, None]
    left, about = np.cross(axes[2], along), spin / np.maximum(rate, LEAST_SPIN)[:, None]
    moving, turning = speed > LEAST_SPEED, rate > LEAST_SPIN
    always = [(axis, np.ones(len(speed), dtype=bool)) for axis in axes]
    directions = [*always, (along, moving), (left, moving), *always, (about, turning), (left, moving)]
    values, variances = [], []
    for k, (direction, exists) in enumerate(directions[: 5 if wrench.shape[1] == 3 else 10]):
        part = slice(0, 3) if k < 5 else slice(3, 6)
        d = direction if k < 5 else quat_rotate(quat_conj(attitude), direction)
        values.append((d * wrench[:, part]).sum(1))
        variances.append(np.where(exists, np.einsum("wi,wij,wj->w", d, cov[:, part, part], d), np.inf))
    return np.stack(values, axis=1), np.stack(variances, axis=1)
