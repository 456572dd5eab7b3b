"""The residual wrench: which force and torque, constant over a window, would make up for what the simulator misses,
and which state of the motion explains it best.

To first order a window's whitened misses are r = -J w + noise of unit variance, J their derivatives by a wrench w
that acts throughout the window, contact and all. Generalised least squares, with a wide prior, gives

    w = -C J^T r,     C = (J^T J + P^-1)^-1,

scaled by what is left of r where that is more than noise. First states are uncertain in the whitening, so that a
wrench is what no first state would explain. One component of it, as a curve over one state, is then judged on tosses
that took no part. The best of all such pairs counts only if signs drawn by toss rarely give as good a best pair
(Westfall and Young 1993: the maximum's own distribution), and the state only if it is as rare beyond the mean.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import median_abs_deviation

from tossid.diagnosis.evidence import CAP, Evidence, Hypothesis
from tossid.diagnosis.findings import Interval, Relation
from tossid.diagnosis.windows import Windows
from tossid.objects import GRAVITY, ObjectModel, corner_positions
from tossid.physics import Residual, n_features
from tossid.physics.effects import World
from tossid.rotations import quat_boxminus, quat_conj, quat_rotate
from tossid.types import Phase

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

STEP = 0.01
"""Of differences, in weights [N] and weights times half a width [N m]: some standard errors of a window in flight."""
WIDE = 1.0
"""Standard deviation of the prior, in the same units."""
SOFT = 1e-9
"""Stiffness [N m/rad] of a spring that is so far from its rest that its torque is constant."""
KNOWN = 0.15
"""Share of the prior's standard deviation below which a window says something of a component."""
SLOW, STILL = 0.05, 0.5
"""Horizontal speed [m/s] and spin [rad/s] below which they have no direction."""
FOLDS = 5
FEWEST = 6
"""Windows, and tosses, from which anything is related."""
CURVED = 30
"""Windows from which a curve is quadratic, not straight."""
ENDS = 2.5
"""Standard deviations of a state beyond which a curve is level: few windows are there."""
FAR = 6.0
"""Robust standard deviations beyond which a component counts as that."""
FLIPS, LEVEL = 499, 0.01
RESAMPLES = 300

COMPONENTS = (
    "force_x", "force_y", "force_z", "force_along", "force_left",
    "torque_x", "torque_y", "torque_z", "torque_spin", "torque_left",
)  # fmt: skip
"""Along x, y, z of the world (z up), along the horizontal velocity, horizontally to its left, along the spin. Objects
with joints have a torque in each, torque_joint_1 and so on, and none on the whole."""
STATES = (
    "time", "x", "y", "height", "lowest_corner", "velocity_x", "velocity_y", "velocity_z", "horizontal_speed",
    "speed", "spin", "spin_vertical",
)  # fmt: skip
"""Means over a window, but for the lowest corner, which is the deepest that any gets; SI units, the world's frame. And
the angle of each joint, from -pi to pi, and its rate: joint_1, joint_1_rate and so on."""


def wrenches(evidence: Evidence, hypothesis: Hypothesis, residual: Array) -> tuple[Array, Array]:
    """Each window's residual wrench (W, K) and its covariance (W, K, K).

    Force [N] in the world's frame, torque [N m] about the centre of mass in the body's axes, and in each joint, each
    constant there over the window. Of an object with joints a torque on the whole is not asked for.

    Args:
        evidence: of W windows, as it is for the hypothesis.
        residual: (W, L, K) whitened misses of the hypothesis.
    """
    world = hypothesis.world()
    weight, (W, _, K) = float(world.object.mass.sum()) * GRAVITY, residual.shape
    unit = weight * np.append([1.0] * 3, [0.5 * world.object.width] * (K - 3))
    J = np.zeros((W, residual[0].size, K))
    for i in range(K) if K == 6 else (0, 1, 2, *range(6, K)):
        push = STEP * unit * (np.arange(K) == i)
        ends = [evidence.residual(with_wrench(world, sign * push)) for sign in (1, -1)]
        J[..., i] = (ends[0] - ends[1]).reshape(W, -1) / (2 * STEP)
    r = np.clip(residual.reshape(W, -1), -CAP, CAP)
    H = J.mT @ J
    cov = np.linalg.inv(H + WIDE**-2 * np.eye(K))
    w = -(cov @ (J.mT @ r[..., None]))[..., 0]
    left = ((r + (J @ w[..., None])[..., 0]) ** 2).sum(1) / np.maximum(K * evidence.windows.inside.sum(1) - K, 1)
    cov = np.linalg.inv(H / np.maximum(left, 1.0)[:, None, None] + WIDE**-2 * np.eye(K))
    return w * unit, cov * np.outer(unit, unit)


def with_wrench(world: World, wrench: Array) -> World:
    """The world with a force (3,) [N, world], a torque (3,) [N m, body's axes] at a single body's centre of mass, and
    torques in joints (n_j,) [N m].

    The force is one of the world's own. The torque is a residual acceleration: one more unit of a learned residual's,
    that is always on. A joint's is a spring's that is far from its rest.
    """
    x, y, z = (float(f) for f in wrench[:3])
    forces = world.forces._replace(x=world.forces.x + x, y=world.forces.y + y, z=world.forces.z + z)
    if wrench[6:].any():
        return replace(world, forces=forces, object=_with_torques(world.object, wrench[6:]))
    if not wrench[3:6].any():
        return replace(world, forces=forces)
    spin = np.linalg.solve(world.object.inertia[0], wrench[3:6])
    # the body's origin goes round its centre of mass
    out = np.concatenate([np.cross(world.object.com[0], spin), spin])
    old = world.residual
    f = n_features(0)
    if old is None or not len(old.linear):
        old = Residual(np.zeros((6, f)), np.zeros((0, f)), np.zeros(0), np.zeros((0, 0)), np.zeros(0), np.zeros((6, 0)))
    h = len(old.b0)
    W1 = np.zeros((h + 1, h + 1))
    W1[:h, :h] = old.W1
    made = Residual(
        linear=old.linear,
        W0=np.concatenate([old.W0, np.zeros((1, f))]),
        b0=np.append(old.b0, 0.0),
        W1=W1,
        b1=np.append(old.b1, 1.0),
        W2=np.concatenate([old.W2, out[:, None] / np.tanh(1.0)], axis=1),
    )
    return replace(world, forces=forces, residual=made)


def _with_torques(model: ObjectModel, torques: Array) -> ObjectModel:
    law = model.joints
    stiffness = law.stiffness.copy()
    stiffness[1:] = np.where(stiffness[1:] > 0, stiffness[1:], SOFT)
    rest = law.rest.copy()
    rest[1:] += torques / stiffness[1:]
    return model.with_changes(joint_law=law._replace(stiffness=stiffness, rest=rest))


def residual_wrench(
    evidence: Evidence, hypothesis: Hypothesis, residual: Array, model: ObjectModel, *, seed: int = 0
) -> tuple[Relation, ...]:
    """The residual wrench in flight, and in contact, each with the state that explains it best.

    Args:
        evidence, hypothesis, residual: as of `wrenches`.
        model: the stated object, whose corners have heights.
        seed: of folds, signs and resamples.
    """
    windows = evidence.windows
    wrench, cov = wrenches(evidence, hypothesis, residual)
    states, velocity, spin, turned = _states(windows, model)
    value, variance = _components(wrench, cov, velocity, spin, turned)
    weight = float(hypothesis.base.object.mass.sum()) * GRAVITY
    names = components_of(value.shape[1])
    most = WIDE * weight * np.where([name.startswith("force") for name in names], 1.0, 0.5 * model.width)
    variance = np.where(variance < (KNOWN * most) ** 2, variance, np.inf)
    flying, touching = phase_groups(windows)
    rng = np.random.default_rng(seed)
    found = [
        relate(phase, value[rows], variance[rows], states[rows], windows.toss[rows], rng)
        for phase, rows in (("flight", flying), ("contact", touching))
    ]
    return tuple(each for each in found if each is not None)


def phase_groups(windows: Windows) -> tuple[Flags, Flags]:
    """(W,) windows that are all flight, no frame twice, and (W,) those with contact."""
    airborne = ~(windows.inside & (windows.phase != Phase.FLIGHT)).any(1)
    end = np.full(int(windows.toss.max(initial=-1)) + 1, -1)
    last = windows.frame[:, 0] + windows.steps - 1
    np.maximum.at(end, windows.toss[windows.free], last[windows.free])
    later = ~windows.free & airborne & (windows.frame[:, 0] > end[windows.toss])
    return windows.free | later, ~windows.free & ~airborne


def _states(windows: Windows, model: ObjectModel) -> tuple[Array, Array, Array, Array]:
    """(W, len(states_of)) states as measured; mean velocity (W, 3), spin (W, 3) [world]; attitude half way (W, 4)."""
    W, F, dt = len(windows.y), windows.y.shape[1], windows.dt
    n = np.minimum(windows.steps, F)
    there = np.arange(F) < n[:, None]
    rows = np.arange(W)
    span = np.maximum(n - 1, 1) * dt
    velocity = (windows.y[rows, n - 1, :3] - windows.y[:, 0, :3]) / span[:, None]
    # frames after a window's last repeat it, and do not turn
    turns = quat_rotate(windows.y[:, 1:, 3:7], quat_boxminus(windows.y[:, 1:, 3:7], windows.y[:, :-1, 3:7]))
    spin = turns.sum(1) / span[:, None]
    low = corner_positions(model, windows.y)[..., 2].min(-1)
    place = np.where(there[..., None], windows.y[..., :3], 0.0).sum(1) / n[:, None]
    states = np.stack(
        [
            (windows.frame[:, 0] + 0.5 * (n - 1)) * dt,
            *place.T,
            np.where(there, low, np.inf).min(1),
            *velocity.T,
            np.linalg.norm(velocity[:, :2], axis=1),
            np.linalg.norm(velocity, axis=1),
            np.linalg.norm(spin, axis=1),
            spin[:, 2],
            *_turn(windows.y[rows, n // 2, 7:]).T,
            *((windows.y[rows, n - 1, 7:] - windows.y[:, 0, 7:]) / span[:, None]).T,
        ],
        axis=1,
    )
    return states, velocity, spin, windows.y[rows, n // 2, 3:7]


def _turn(angle: Array) -> Array:
    """Angles within half a turn of zero."""
    out: Array = (angle + np.pi) % (2 * np.pi) - np.pi
    return out


def _components(wrench: Array, cov: Array, velocity: Array, spin: Array, turned: Array) -> tuple[Array, Array]:
    """(W, len(components_of)) components and their variances, infinite along a direction that is not there."""
    W = len(wrench)
    x, y, z = (np.tile(axis, (W, 1)) for axis in np.eye(3))
    speed = np.linalg.norm(velocity[:, :2], axis=1)
    along = np.concatenate([velocity[:, :2] / np.maximum(speed, SLOW)[:, None], np.zeros((W, 1))], axis=1)
    left = np.cross(z, along)
    rate = np.linalg.norm(spin, axis=1)
    about = spin / np.maximum(rate, STILL)[:, None]
    back = quat_conj(turned)
    always, moving, turning = np.ones(W, dtype=bool), speed > SLOW, rate > STILL
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


def components_of(count: int) -> tuple[str, ...]:
    """Names of so many components."""
    return COMPONENTS + tuple(f"torque_joint_{k + 1}" for k in range(count - len(COMPONENTS)))


def states_of(count: int) -> tuple[str, ...]:
    """Names of so many states."""
    joints = [f"joint_{k + 1}" for k in range((count - len(STATES)) // 2)]
    return (*STATES, *joints, *(f"{name}_rate" for name in joints))


def relate(
    phase: str, value: Array, variance: Array, states: Array, toss: NDArray[np.int64], rng: np.random.Generator
) -> Relation | None:
    """The pair of component and state that explains most on tosses that took no part; None for too few windows.

    Args:
        value, variance: (W, len(components_of)) [N], [N m] and squares; an infinite variance is no value.
        states: (W, len(states_of)).
        toss: (W,) whose.
    """
    whose, toss = np.unique(toss, return_inverse=True)
    n, components, names = len(whose), components_of(value.shape[1]), states_of(states.shape[1])
    signs = rng.choice([-1.0, 1.0], (n, FLIPS))
    fold = rng.permutation(n) % FOLDS
    pick = rng.integers(0, n, (RESAMPLES, n))
    sets = {}
    for k, component in enumerate(components):
        known = np.isfinite(variance[:, k])
        if known.sum() >= FEWEST and len(np.unique(toss[known])) >= FEWEST:
            y, weight = _weighted(value[known, k], variance[known, k])
            sets[component] = _Set(known, y, weight, toss[known], fold[toss[known]], n)
    if not sets:
        return None
    scores, chance = {}, np.full(FLIPS, -np.inf)
    for component, each in sets.items():
        drawn = each.y[:, None] * np.concatenate([np.ones((len(each.y), 1)), signs[each.toss]], axis=1)
        for s in range(len(names)):
            _, share = each.explained(states[each.known, s], drawn)
            scores[component, s] = share[0]
            chance = np.maximum(chance, share[1:])
    component, s = max(scores, key=lambda pair: scores[pair])
    p_value = float((1 + (chance >= scores[component, s]).sum()) / (1 + FLIPS))

    best, k = sets[component], components.index(component)
    x = states[best.known, s]
    centred = best.y - np.average(best.y, weights=best.weight)
    drawn = centred[:, None] * np.concatenate([np.ones((len(x), 1)), signs[best.toss]], axis=1)
    chance = np.max([best.explained(states[best.known, i], drawn)[1][1:] for i in range(len(names))], axis=0)
    beyond, share = best.explained(x, drawn)
    p_state = float((1 + (chance >= share[0]).sum()) / (1 + FLIPS))
    r2, r2_state = best.interval(best.explained(x, best.y[:, None])[0], pick), best.interval(beyond, pick)
    clear = p_value <= LEVEL and r2.low > 0
    state_clear = clear and p_state <= LEVEL and r2_state.low > 0
    if clear and not state_clear:
        r2 = best.interval(best.explained(None, best.y[:, None])[0], pick)
    return Relation(
        phase=phase,
        windows=len(x),
        tosses=len(np.unique(best.toss)),
        component=component,
        state=names[s],
        r2=r2,
        p_value=p_value,
        clear=clear,
        r2_state=r2_state,
        p_state=p_state,
        state_clear=state_clear,
        means={name: each.mean(pick) for name, each in sets.items()},
        points=np.stack([x, value[best.known, k], np.sqrt(variance[best.known, k]), best.toss], axis=1),
        curve=best.curve(x, pick),
    )


def _weighted(y: Array, variance: Array) -> tuple[Array, Array]:
    """Values without far ones, and weights by precision and by how much more than that they scatter (DerSimonian and
    Laird 1986): (n,), (n,)."""
    middle = np.median(y)
    far = FAR * float(median_abs_deviation(y, scale="normal")) + 1e-12
    y = np.clip(y, middle - far, middle + far)
    w = 1 / variance
    q = (w * (y - np.average(y, weights=w)) ** 2).sum()
    between = max(0.0, (q - (len(y) - 1)) / max(w.sum() - (w**2).sum() / w.sum(), 1e-300))
    return y, 1 / (variance + between)


def _basis(x: Array, of: Array) -> Array:
    """(n, 2 or 3) of a state: 1, s and, of many windows, s²; s the state over its spread."""
    spread = max(float(of.std()), 1e-9)
    s = np.clip((x - of.mean()) / spread, -ENDS, ENDS)
    return np.stack([s**i for i in range(3 if len(of) >= CURVED else 2)], axis=1)


@dataclass(frozen=True)
class _Set:
    """The windows that know one component: which of all they are, values y, weights, tosses of n, and their folds."""

    known: Flags
    y: Array
    weight: Array
    toss: NDArray[np.int64]
    fold: NDArray[np.int64]
    n: int

    def explained(self, x: Array | None, Y: Array) -> tuple[Array, Array]:
        """Weighted squares of the first column of Y, each toss's (n, 2): all of them, and those about the curve over x
        (or the mean, if None) that fits the other folds; and the share that it explains of every column."""
        X, after = np.ones((len(Y), 1)) if x is None else _basis(x, x), np.empty_like(Y)
        for k in range(FOLDS):
            held = self.fold == k
            w = np.where(held, 0.0, self.weight)
            H = (X * w[:, None]).T @ X
            H += 1e-6 * np.trace(H) * np.eye(len(H))
            after[held] = Y[held] - X[held] @ np.linalg.solve(H, (X * w[:, None]).T @ Y)
        share: Array = 1 - self.weight @ after**2 / np.maximum(self.weight @ Y**2, 1e-300)
        return self._sums(np.stack([Y[:, 0] ** 2, after[:, 0] ** 2], axis=1)), share

    def _sums(self, values: Array) -> Array:
        """(n, ...) weighted sums over each toss's windows."""
        out = np.zeros((self.n, *values.shape[1:]))
        np.add.at(out, self.toss, self.weight.reshape(-1, *[1] * (values.ndim - 1)) * values)
        return out

    def interval(self, squares: Array, pick: NDArray[np.int64]) -> Interval:
        """Share explained, with its interval over tosses, of the squares of `explained`."""
        drawn = squares[pick].sum(1)
        low, high = np.percentile(1 - drawn[:, 1] / np.maximum(drawn[:, 0], 1e-300), [2.5, 97.5])
        whole, left = squares.sum(0)
        return Interval(float(1 - left / max(whole, 1e-300)), float(low), float(high))

    def mean(self, pick: NDArray[np.int64]) -> Interval:
        """Weighted mean, with its interval over tosses."""
        sums = self._sums(np.stack([self.y, np.ones_like(self.y)], axis=1))
        drawn = sums[pick].sum(1)
        low, high = np.percentile(drawn[:, 0] / np.maximum(drawn[:, 1], 1e-300), [2.5, 97.5])
        return Interval(float(sums[:, 0].sum() / sums[:, 1].sum()), float(low), float(high))

    def curve(self, x: Array, pick: NDArray[np.int64]) -> Array:
        """(40, 4) state, fitted component, and its 95 % band over tosses."""
        low, high = np.percentile(x, [1, 99])
        grid = np.linspace(low, high, 40)
        X, at = _basis(x, x), _basis(grid, x)
        A, b = self._sums(X[:, :, None] * X[:, None, :]), self._sums(X * self.y[:, None])
        ridge = 1e-6 * np.trace(A.sum(0)) * np.eye(X.shape[1])
        drawn = np.linalg.solve(A[pick].sum(1) + ridge, b[pick].sum(1)[..., None])[..., 0] @ at.T
        fitted = at @ np.linalg.solve(A.sum(0) + ridge, b.sum(0))
        return np.stack([grid, fitted, *np.percentile(drawn, [2.5, 97.5], axis=0)], axis=1)
