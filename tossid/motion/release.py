"""The first frame by which the object has been let go: a change point between a hand and free flight.

Flight is read backwards in time, from its end. Its centre of mass falls, and the attitude turns as Euler's equations
have it; both up to a constant acceleration that is not known well (another gravity, a wrong inertia) and one that
drifts slowly (drag). A hand accelerates the object as it likes. Each coordinate x is a Kalman filter's with the state
(x, x', x'') and white jerk: of small densities in flight, of a large one in a hand, where x'' jumps besides. For every
frame r, the evidence of "in flight from r on, in a hand before" follows from the innovations and their covariances.
With as much belief beforehand in "in flight from the first frame on" as in all the others together, Bayes' rule gives
the probability of each. Where it is `LEVEL` sure that there is a hand, the release is the first frame by which the
object has been let go with the same probability.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.motion.contact import Touch, may_touch
from tossid.motion.kinematics import center_of_mass, gyration
from tossid.motion.noise import pose_noise
from tossid.objects import GRAVITY, ObjectModel
from tossid.robust import NORMAL_MAD
from tossid.rotations import quat_boxminus, quat_exp, quat_mul, quat_rotate, quat_to_matrix
from tossid.types import PoseTrack

Array = NDArray[np.float64]

LEVEL = 0.95
"""Probability with which a hand is there, and with which it has let go by the first frame of flight."""
FEWEST_FRAMES = 6
"""Frames of flight below which no release is looked for."""
EXPECTATIONS = 10
"""Steps in which the share of tosses that begin in a hand is estimated."""
OTHER = 2.0
"""Standard deviation of a constant acceleration in flight beside gravity's [m/s²]; turns count times a radius."""
DRIFTS = (1e-2, 1.0, 1e2)
"""Densities of the jerk in flight [m²/s⁵], equally likely: accelerations drift by 0.03, 0.3 and 3 m/s² in 0.1 s."""
SPEED = 30.0
"""Standard deviation of the speed, of which nothing is known [m/s]."""
HAND = 10.0
"""Standard deviation of a hand's acceleration where it lets go [m/s²]."""
HAND_JERK = 5e3
"""Density of its jerk [m²/s⁵]: 22 m/s² in 0.1 s."""
STEPS = 8
"""Frames after which nothing of a flight is left in the filter of a hand."""
LEAST_CHANGE = 2.5
"""Change of the acceleration [m/s²] below which it is no hand, but the air, a tracker's slow errors, a centre of mass
that is not quite where it is stated."""
WRONG, WRONG_SIZE = 2e-4, 5e-3
"""Share of coordinates that are wrong altogether, and by how much [m]."""
BEFORE = 20.0
"""Poses to whose scatter the stated covariance is worth as much: a tracker's own may be off by a factor."""
LEAST_NOISE = 5e-5
"""No pose is more certain [m]; errors of neighbouring frames are alike, which their scatter does not show."""


def release_frames(
    tracks: Sequence[PoseTrack], model: ObjectModel, *, gravity: float = GRAVITY, touch: Touch | None = None
) -> NDArray[np.int64]:
    """The first frame of free flight of each ready toss, (B,); 0 of those that begin on the ground.

    How many tosses begin in a hand, and for how many frames, is estimated from all of them (expectation maximisation):
    a single frame that noise hides in one toss shows where all have it.

    Args:
        tracks: Of one object, each from about its release on.
        model: The object.
        gravity: [m/s²].
        touch: Where it may touch the ground, of an object without corners.
    """
    touch = partial(may_touch, model) if touch is None else touch
    cov = None
    if any(track.q_cov is None for track in tracks):
        cov = pose_noise(tracks, model, touch=touch)
    logs: list[Array] = []
    for track in tracks:
        last = int(np.argmax(np.append(touch(track.t, track.q), True)))
        flight = track.frames(slice(max(last + 1, 2)))
        if flight.q_cov is None and cov is not None:
            flight = replace(flight, q_cov=np.broadcast_to(cov, (len(flight.t), *cov.shape)).copy())
        logs.append(_log_evidence(flight, model, gravity))
    beliefs = [_belief(len(log)) for log in logs]
    share = np.zeros(max((len(log) for log in logs), default=0))
    for _ in range(EXPECTATIONS):
        found = [_posterior(log, belief + share[: len(log)]) for log, belief in zip(logs, beliefs, strict=True)]
        share = np.zeros_like(share)
        for p in found:
            share[: len(p)] += p
    return np.array([_first(p) for p in found], dtype=np.int64)


def release_frame(track: PoseTrack, model: ObjectModel, *, gravity: float = GRAVITY) -> int:
    """The first frame of free flight in a track that ends in flight; 0 where no flight explains its end.

    Args:
        track: Poses up to where something may touch the object.
        model: The object; the attitude counts where it is one rigid body whose inertia is stated.
        gravity: [m/s²].
    """
    log = _log_evidence(track, model, gravity)
    return _first(_posterior(log, _belief(len(log))))


def _belief(n: int) -> Array:
    """Weights (n,) beforehand of a release at each frame: flight from the first on as much as all the others."""
    return np.append(1.0, np.full(n - 1, 1 / max(n - 1, 1)))


def _posterior(log: Array, belief: Array) -> Array:
    """Probabilities (n,) of a release at each frame."""
    log = log + np.log(belief)
    return np.asarray(np.exp(log - np.logaddexp.reduce(log)))


def _first(p: Array) -> int:
    """The release, of its probabilities; 0 where no flight explains the end."""
    if p[0] > 1 - LEVEL or p[-1] == p.max():
        return 0
    return int(np.searchsorted(np.cumsum(p), LEVEL))


def _log_evidence(track: PoseTrack, model: ObjectModel, gravity: float) -> Array:
    """Logarithms of the evidence that flight begins at each of the frames that leave enough of it."""
    n = len(track.t)
    if n <= FEWEST_FRAMES:
        return np.zeros(1)
    t, y, var = _coordinates(track, model, gravity)
    log, *turned = _evidence(t, y, var)
    if turned:  # a hand may move it, turn it, or both
        log = np.logaddexp(np.logaddexp(log, log[0]) + turned[0], log + turned[0][0]) - np.log(3)
    for r in range(1, len(log)):
        near, u = slice(max(r - STEPS, 0), None), np.maximum(t - t[r], 0.0)
        basis = np.stack([np.ones(n), t, 0.5 * u**2], axis=1)[near]
        change = np.linalg.lstsq(basis, y[:, near].T, rcond=None)[0][2]
        if max(np.linalg.norm(change[:3]), np.linalg.norm(change[3:])) < LEAST_CHANGE:
            log[r] = -np.inf
    return log


def _coordinates(track: PoseTrack, model: ObjectModel, gravity: float) -> tuple[Array, Array, Array]:
    """Times before the last frame (n,), coordinates that flight keeps on lines, and their variances (3 or 6, n) [m]."""
    s = track.t[-1] - track.t
    com = center_of_mass(model, track.q)
    com[:, 2] += 0.5 * gravity * s**2
    y, stated = [com], [np.zeros((len(s), 3)) if track.q_cov is None else _diagonal(track.q_cov)[:, :3]]
    if model.is_stated and not model.n_joints:
        arm = gyration(model)
        y.append(arm * _turned(track.t, track.q[:, 3:7], model.inertia[0]))
        own = np.zeros(len(s)) if track.q_cov is None else _diagonal(track.q_cov)[:, 3:6].mean(axis=1)
        stated.append(np.repeat(arm**2 * own[:, None], 3, axis=1))
    x, var = np.concatenate(y, axis=1).T, np.concatenate(stated, axis=1).T
    var = np.maximum(var, LEAST_NOISE**2)
    trust = 0.0 if track.q_cov is None else BEFORE
    ratio = (trust + len(s) * _scatter(s, x) / np.median(var, axis=1)) / (trust + len(s))
    return s, x, np.maximum(ratio[:, None] * var, LEAST_NOISE**2)


def _diagonal(cov: Array) -> Array:
    return np.diagonal(cov, axis1=1, axis2=2)


def _scatter(s: Array, x: Array) -> Array:
    """Robust variance (k,) of coordinates (k, n): of what no parabola through four frames in a row explains."""
    four = np.arange(len(s) - 3)[:, None] + np.arange(4)
    gaps = s[four][:, :, None] - s[four][:, None, :] + np.eye(4)
    contrast = 1 / gaps.prod(axis=2)
    contrast /= np.linalg.norm(contrast, axis=1, keepdims=True)
    return np.asarray((NORMAL_MAD * np.median(np.abs((x[:, four] * contrast).sum(axis=2)), axis=1)) ** 2)


def _turned(t: Array, quat: Array, inertia: Array) -> Array:
    """(n, 3) rotation vectors from a free body's attitudes to those recorded, in the world's axes.

    The world's angular momentum L is constant, and the measured attitude says how R I^-1 R^T L turns the body.
    """
    R = quat_to_matrix(quat)
    inverse = R @ np.linalg.inv(inertia) @ R.swapaxes(-1, -2)
    per_momentum = np.diff(t)[:, None, None] * 0.5 * (inverse[1:] + inverse[:-1])
    turns = quat_rotate(quat[:-1], quat_boxminus(quat[1:], quat[:-1]))
    late = slice(len(t) // 2, None)
    L = np.linalg.lstsq(per_momentum[late].reshape(-1, 3), turns[late].reshape(-1), rcond=None)[0]
    steps = quat_exp(-per_momentum @ L)
    free = np.empty_like(quat)
    free[-1] = quat[-1]
    for k in range(len(t) - 2, -1, -1):
        free[k] = quat_mul(steps[k], free[k + 1])
    return np.asarray(quat_rotate(free, quat_boxminus(quat, free)))


class _Filter(NamedTuple):
    """Means (..., 3) and covariances (..., 3, 3) of a coordinate, its speed and its acceleration."""

    mean: Array
    cov: Array

    def after(self, h: Array, density: Array | float, jump: float = 0.0) -> _Filter:
        """Some time later, with white jerk of a density and a jump of the acceleration at the beginning."""
        one, zero, h = np.ones_like(h), np.zeros_like(h), np.asarray(h)
        F = np.stack([one, h, h**2 / 2, zero, one, h, zero, zero, one], axis=-1).reshape(*h.shape, 3, 3)
        at = np.stack([h**5 / 20, h**4 / 8, h**3 / 6, h**4 / 8, h**3 / 3, h**2 / 2, h**3 / 6, h**2 / 2, h], axis=-1)
        cov = self.cov.copy()
        cov[..., 2, 2] += jump**2
        # white jerk, integrated: ∫ G Gᵀ du with G = (u²/2, u, 1)
        Q = np.asarray(density)[..., None, None] * at.reshape(*h.shape, 3, 3)
        return _Filter((F @ self.mean[..., None])[..., 0], F @ cov @ F.swapaxes(-1, -2) + Q)

    def given(self, y: Array, var: Array) -> tuple[_Filter, Array]:
        """With a measurement, and the logarithm of its density; a wrong one counts little."""
        e, V = y - self.mean[..., 0], self.cov[..., 0, 0] + var
        wide = V + WRONG_SIZE**2
        right = np.log(1 - WRONG) - 0.5 * (e**2 / V + np.log(V))
        log = np.logaddexp(right, np.log(WRONG) - 0.5 * (e**2 / wide + np.log(wide)))
        # the gain, times the probability that the measurement is right
        K = np.exp(right - log)[..., None] * self.cov[..., 0] / V[..., None]
        return _Filter(self.mean + K * e[..., None], self.cov - K[..., None] * self.cov[..., :1, :]), log


def _evidence(t: Array, y: Array, var: Array) -> list[Array]:
    """Logarithms of the evidence (n - FEWEST_FRAMES + 1,) that flight begins at each frame, of each three coordinates.

    Args:
        t: (n,) times before the end [s], falling.
        y: (k, n) coordinates.
        var: (k, n) their variances.
    """
    n, density = len(t), np.array([*DRIFTS, HAND_JERK])[:, None]
    shape = (len(density), len(y))
    now = _Filter(np.zeros((*shape, 3)), np.broadcast_to(np.diag([0.0, SPEED**2, OTHER**2]), (*shape, 3, 3)).copy())
    now.mean[..., 0], now.cov[..., 0, 0] = y[:, -1], var[:, -1]
    states, logs = [now], np.zeros((n, *shape))
    for k in range(n - 2, -1, -1):
        now, logs[k] = now.after(np.asarray(t[k] - t[k + 1]), density).given(y[:, k], var[:, k])
        states.append(now)
    free, held = logs[:, :-1], logs[:, -1:]
    # of flight from each frame r on, and of a hand before
    r = np.arange(n - FEWEST_FRAMES + 1)
    after = _Filter(*(np.stack(part[::-1])[r, :-1] for part in zip(*states, strict=True)))
    log = np.cumsum(free[::-1], axis=0)[::-1][r]
    for step in range(1, STEPS + 1):
        own = r >= step
        at = r[own] - step
        h = (t[at] - t[at + 1])[:, None, None]
        now = _Filter(after.mean[own], after.cov[own]).after(h, HAND_JERK, HAND if step == 1 else 0.0)
        (after.mean[own], after.cov[own]), likely = now.given(y[:, at].T[:, None], var[:, at].T[:, None])
        log[own] += likely
    earlier = np.concatenate([np.zeros((1, *held.shape[1:])), np.cumsum(held, axis=0)])
    log += earlier[np.maximum(r - STEPS, 0)]
    # the drifts are equally likely
    parts = [log[..., k : k + 3].sum(axis=-1) for k in range(0, len(y), 3)]
    return [np.logaddexp.reduce(part, axis=-1) - np.log(len(DRIFTS)) for part in parts]
