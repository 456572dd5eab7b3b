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

from tossid.diagnosis.findings import Relation
from tossid.diagnosis.likelihood.evidence import Evidence, Hypothesis
from tossid.diagnosis.likelihood.windows import Windows
from tossid.diagnosis.localisation.relations import components_of, relate
from tossid.objects import GRAVITY, ObjectModel, corner_heights
from tossid.physics import LearnedAcceleration, n_features
from tossid.physics.effects import World
from tossid.rotations import quat_boxminus, quat_conj, quat_rotate
from tossid.settings.diagnosis.diagnose import WrenchSettings
from tossid.types import Phase

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_SOFT = 1e-9
"""Stiffness [N m/rad] of a spring that is so far from its rest that its torque is constant."""


def wrenches(
    evidence: Evidence, hypothesis: Hypothesis, residuals: Array, settings: WrenchSettings = WrenchSettings()
) -> tuple[Array, Array]:
    """Each window's residual wrench (W, K) and its covariance (W, K, K).

    It is a force [N] in the world's frame, a torque [N m] about the centre of mass in the body's axes, and a torque
    [N m] in each joint. For an object with joints no torque on the whole is estimated.

    Args:
        evidence: Of W windows, at first states that suit the hypothesis.
        hypothesis: The hypothesis.
        residuals: (W, L, K) its whitened residuals.
        settings: Differences and prior.
    """
    world = hypothesis.world()
    weight, (W, _, K) = float(world.object.mass.sum()) * GRAVITY, residuals.shape
    unit = weight * np.append([1.0] * 3, [0.5 * world.object.width] * (K - 3))
    J = np.zeros((W, residuals[0].size, K))
    for i in range(K) if K == 6 else (0, 1, 2, *range(6, K)):
        push = settings.difference * unit * (np.arange(K) == i)
        ends = [evidence.residuals(with_wrench(world, sign * push)) for sign in (1, -1)]
        J[..., i] = (ends[0] - ends[1]).reshape(W, -1) / (2 * settings.difference)
    largest, prior = evidence.density.largest_residual, settings.prior**-2 * np.eye(K)
    r = np.clip(residuals.reshape(W, -1), -largest, largest)
    H = J.mT @ J
    cov = np.linalg.inv(H + prior)
    w = -(cov @ (J.mT @ r[..., None]))[..., 0]
    left = ((r + (J @ w[..., None])[..., 0]) ** 2).sum(1) / np.maximum(K * evidence.windows.inside.sum(1) - K, 1)
    cov = np.linalg.inv(H / np.maximum(left, 1.0)[:, None, None] + prior)
    return w * unit, cov * np.outer(unit, unit)


def with_wrench(world: World, wrench: Array) -> World:
    """The world with a constant force and torque on its body, and constant torques in its joints.

    The force is one of the world's own. The torque is one more unit of the learned acceleration, which is always on. A
    joint's torque is that of a soft spring far from its rest.

    Args:
        world: Of a single body, or with joints.
        wrench: (6 + n_joints,) force [N, world], torque [N m, body's axes] about a single body's centre of mass, and
            torques in joints [N m].
    """
    x, y, z = (float(f) for f in wrench[:3])
    forces = world.forces._replace(x=world.forces.x + x, y=world.forces.y + y, z=world.forces.z + z)
    if wrench[6:].any():
        return replace(world, forces=forces, object=_with_torques(world.object, wrench[6:]))
    if not wrench[3:6].any():
        return replace(world, forces=forces)
    spin = np.linalg.solve(world.object.inertia[0], wrench[3:6])
    old = world.k_res
    f = n_features(0)
    if old is None or not len(old.linear):
        old = LearnedAcceleration(
            np.zeros((6, f)), np.zeros((0, f)), np.zeros(0), np.zeros((0, 0)), np.zeros(0), np.zeros((6, 0))
        )
    h, (rows, f) = len(old.b0), old.linear.shape
    # acceleration of the body frame's origin, which circles the centre of mass
    out = np.concatenate([np.cross(world.object.com[0], spin), spin, np.zeros(rows - 6)])
    W1 = np.zeros((h + 1, h + 1))
    W1[:h, :h] = old.W1
    made = LearnedAcceleration(
        linear=old.linear,
        W0=np.concatenate([old.W0, np.zeros((1, f))]),
        b0=np.append(old.b0, 0.0),
        W1=W1,
        b1=np.append(old.b1, 1.0),
        W2=np.concatenate([old.W2, out[:, None] / np.tanh(1.0)], axis=1),
    )
    return replace(world, forces=forces, k_res=made)


def _with_torques(model: ObjectModel, torques: Array) -> ObjectModel:
    law = model.joints
    stiffness = law.stiffness.copy()
    stiffness[1:] = np.where(stiffness[1:] > 0, stiffness[1:], _SOFT)
    rest = law.rest.copy()
    rest[1:] += torques / stiffness[1:]
    return model.with_changes(joint_law=law._replace(stiffness=stiffness, rest=rest))


def residual_wrench(
    evidence: Evidence,
    hypothesis: Hypothesis,
    residuals: Array,
    model: ObjectModel,
    *,
    seed: int = 0,
    settings: WrenchSettings = WrenchSettings(),
) -> tuple[Relation, ...]:
    """The residual wrench in flight and in contact, each with the state that explains it best.

    Args:
        evidence: As of `wrenches`.
        hypothesis: As of `wrenches`.
        residuals: As of `wrenches`.
        model: The stated object, of whose corners heights are taken.
        seed: Of folds, signs and resamples.
        settings: How it is estimated and related.
    """
    windows = evidence.windows
    wrench, cov = wrenches(evidence, hypothesis, residuals, settings)
    states, velocity, spin, attitude = _states(windows, model)
    value, variance = _components(wrench, cov, velocity, spin, attitude, settings)
    weight = float(hypothesis.base.object.mass.sum()) * GRAVITY
    names = components_of(value.shape[1])
    prior = settings.prior * weight * np.where([name.startswith("force") for name in names], 1.0, 0.5 * model.width)
    variance = np.where(variance < (settings.known * prior) ** 2, variance, np.inf)
    flying, touching = phase_groups(windows)
    rng = np.random.default_rng(seed)
    found = [
        relate(phase, value[rows], variance[rows], states[rows], windows.toss[rows], rng, settings)
        for phase, rows in (("flight", flying), ("contact", touching))
    ]
    return tuple(each for each in found if each is not None)


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
    """(W, S) measured states; mean velocity and spin (W, 3) [world]; attitude in the middle (W, 4)."""
    W, F, dt = len(windows.y), windows.y.shape[1], windows.dt
    n = np.minimum(windows.steps, F)
    there = np.arange(F) < n[:, None]
    rows = np.arange(W)
    span = np.maximum(n - 1, 1) * dt
    velocity = (windows.y[rows, n - 1, :3] - windows.y[:, 0, :3]) / span[:, None]
    # frames after a window's last are copies of it
    turns = quat_rotate(windows.y[:, 1:, 3:7], quat_boxminus(windows.y[:, 1:, 3:7], windows.y[:, :-1, 3:7]))
    spin = turns.sum(1) / span[:, None]
    low = corner_heights(model, windows.y).min(-1)
    place = np.where(there[..., None], windows.y[..., :3], 0.0).sum(1) / n[:, None]
    states = np.stack(
        [
            (windows.first + 0.5 * (n + 1)) * dt,
            *place.T,
            np.where(there, low, np.inf).min(1),
            *velocity.T,
            np.linalg.norm(velocity[:, :2], axis=1),
            np.linalg.norm(velocity, axis=1),
            np.linalg.norm(spin, axis=1),
            spin[:, 2],
            *_within_half_turn(windows.y[rows, n // 2, 7:]).T,
            *((windows.y[rows, n - 1, 7:] - windows.y[:, 0, 7:]) / span[:, None]).T,
        ],
        axis=1,
    )
    return states, velocity, spin, windows.y[rows, n // 2, 3:7]


def _within_half_turn(angle: Array) -> Array:
    """Angles within half a turn of zero."""
    out: Array = (angle + np.pi) % (2 * np.pi) - np.pi
    return out


def _components(
    wrench: Array, cov: Array, velocity: Array, spin: Array, attitude: Array, settings: WrenchSettings
) -> tuple[Array, Array]:
    """(W, C) components of wrenches, and their variances, infinite along a direction that does not exist."""
    W = len(wrench)
    x, y, z = (np.tile(axis, (W, 1)) for axis in np.eye(3))
    speed = np.linalg.norm(velocity[:, :2], axis=1)
    along = np.concatenate(
        [velocity[:, :2] / np.maximum(speed, settings.least_speed)[:, None], np.zeros((W, 1))], axis=1
    )
    left = np.cross(z, along)
    rate = np.linalg.norm(spin, axis=1)
    about = spin / np.maximum(rate, settings.least_spin)[:, None]
    back = quat_conj(attitude)
    always, moving, turning = np.ones(W, dtype=bool), speed > settings.least_speed, rate > settings.least_spin
    force = [(x, always), (y, always), (z, always), (along, moving), (left, moving)]
    torque = [(x, always), (y, always), (z, always), (about, turning), (left, moving)]
    values, variances = [], []
    for part, directions in ((slice(0, 3), force), (slice(3, 6), torque)):
        for direction, known in directions:
            d = quat_rotate(back, direction) if part.start else direction
            values.append(np.einsum("wi,wi->w", d, wrench[:, part]))
            spread = np.einsum("wi,wij,wj->w", d, cov[:, part, part], d)
            variances.append(np.where(known, spread, np.inf))
    for k in range(6, wrench.shape[1]):
        values.append(wrench[:, k])
        variances.append(cov[:, k, k])
    return np.stack(values, axis=1), np.stack(variances, axis=1)
