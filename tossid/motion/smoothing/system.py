"""The smoother's linear system: tracks side by side, their motion linearised, and the way back to tracks.

State, error and process noise are those of `tossid.motion.smoothing.smoother`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.motion.contact import Touch, may_touch
from tossid.motion.smoothing.rts import LinearSystem
from tossid.objects import ObjectModel
from tossid.rotations import (
    quat_boxminus,
    quat_exp,
    quat_mul,
    quat_normalize,
    quat_rotate,
    quat_to_matrix,
    right_jacobian,
    rotvec_to_matrix,
    skew,
)
from tossid.types import PoseTrack

Array = NDArray[np.float64]

PRIOR = (1.0, 1.0, 10.0, 100.0)
"""Standard deviations of the first state: position [m], angle [rad], velocity [m/s], rate [rad/s].

They only keep the first step solvable: they are a thousand times the noise of poses, and decide nothing.
"""


@dataclass(slots=True)
class Batch:
    """Tracks of different lengths side by side, time first; the origin of a free body is its centre of mass.

    Attributes:
        h: Time steps [s], (n-1, b).
        q: Poses, (n, b, nq).
        R: Measurement covariance, (n, b, nv, nv).
        seen: Whether there is a pose, (n, b).
        touch: Whether the geometry allows contact in an interval, (n-1, b).
        inside: Whether an interval lies between two poses, (n-1, b).
        origin: The point that q describes, in the base frame [m], (3,).
    """

    h: Array
    q: Array
    R: Array
    seen: NDArray[np.bool_]
    touch: NDArray[np.bool_]
    inside: NDArray[np.bool_]
    origin: Array


def pad(tracks: Sequence[PoseTrack], model: ObjectModel, q_cov: Sequence[Array], touch: Touch | None = None) -> Batch:
    """A batch of tracks; short ones are extended by frames without measurement.

    Args:
        tracks: Of one object.
        model: The object.
        q_cov: Measurement covariance of each, (n, nv, nv).
        touch: Where it may touch the ground, of an object without corners.
    """
    c = model.com[0] if model.n_joints == 0 else np.zeros(3)
    n, b, nv = max(len(track.t) for track in tracks), len(tracks), model.nv
    batch = Batch(
        h=np.ones((n - 1, b)),
        q=np.zeros((n, b, model.nq)),
        R=np.broadcast_to(np.eye(nv), (n, b, nv, nv)).copy(),
        seen=np.zeros((n, b), dtype=bool),
        touch=np.zeros((n - 1, b), dtype=bool),
        inside=np.zeros((n - 1, b), dtype=bool),
        origin=c,
    )
    for i, track in enumerate(tracks):
        m = len(track.t)
        batch.h[: m - 1, i] = np.diff(track.t)
        batch.h[m - 1 :, i] = batch.h[m - 2, i]
        batch.q[:m, i], batch.R[:m, i] = _move_origin(track.q, q_cov[i], c)
        batch.q[m:, i] = batch.q[m - 1, i]
        batch.seen[:m, i] = True
        batch.touch[: m - 1, i] = may_touch(model, track.t, track.q) if touch is None else touch(track.t, track.q)
        batch.inside[: m - 1, i] = True
    return batch


def unpad(batch: Batch, i: int, q: Array, v: Array, cov: Array) -> tuple[Array, Array, Array, Array]:
    """q, v, q_cov and v_cov of one track, moved back from the centre of mass to the base frame's origin.

    Args:
        batch: The tracks.
        i: Number of the track.
        q: Smoothed poses, (n, b, nq).
        v: Velocities, (n, b, nv).
        cov: Covariances of both, (n, b, 2 nv, 2 nv).
    """
    nv, m, c = v.shape[-1], int(batch.seen[:, i].sum()), batch.origin
    q_i, v_i, cov_i = q[:m, i], v[:m, i].copy(), cov[:m, i]
    arm = quat_rotate(q_i[:, 3:7], c)
    R = quat_to_matrix(q_i[:, 3:7])
    # u = v + R (ω × c), so v = u - R (ω × c), and the same for its error
    T = np.broadcast_to(np.eye(2 * nv), cov_i.shape).copy()
    T[:, :3, 3:6] = R @ skew(c)
    T[:, nv : nv + 3, nv + 3 : nv + 6] = R @ skew(c)
    T[:, nv : nv + 3, 3:6] = R @ skew(np.cross(v_i[:, 3:6], c))
    v_i[:, :3] -= quat_rotate(q_i[:, 3:7], np.cross(v_i[:, 3:6], c))
    cov_i = T @ cov_i @ T.swapaxes(-1, -2)
    q_i = np.concatenate([q_i[:, :3] - arm, q_i[:, 3:]], axis=1)
    return q_i, v_i, cov_i[:, :nv, :nv].copy(), cov_i[:, nv:, nv:].copy()


def _move_origin(q: Array, q_cov: Array, c: Array) -> tuple[Array, Array]:
    """Poses and covariances of the point c [m, base frame] instead of the base frame's origin."""
    R = quat_to_matrix(q[:, 3:7])
    T = np.broadcast_to(np.eye(q_cov.shape[-1]), q_cov.shape).copy()
    T[:, :3, 3:6] = -R @ skew(c)
    at_c = q.copy()
    at_c[:, :3] += quat_rotate(q[:, 3:7], c)
    return at_c, T @ q_cov @ T.swapaxes(-1, -2)


def difference(a: Array, b: Array) -> Array:
    """Difference of configurations in the tangent space at b. (*s, nq) x2 -> (*s, nv)."""
    return np.concatenate(
        [a[..., :3] - b[..., :3], quat_boxminus(a[..., 3:7], b[..., 3:7]), a[..., 7:] - b[..., 7:]], axis=-1
    )


def differences(q: Array, h: Array) -> Array:
    """Forward differences of poses, (n, b, nv), where the smoother starts.

    Args:
        q: Poses, (n, b, nq).
        h: Time steps [s], (n-1, b).
    """
    v = difference(q[1:], q[:-1]) / h[..., None]
    return np.concatenate([v, v[-1:]])


def moved(q: Array, by: Array) -> Array:
    """Configurations (*s, nq) moved by tangent vectors (*s, nv)."""
    turned = quat_normalize(quat_mul(q[..., 3:7], quat_exp(by[..., 3:6])))
    return np.concatenate([q[..., :3] + by[..., :3], turned, q[..., 7:] + by[..., 6:]], axis=-1)


def retract(q: Array, v: Array, delta: Array) -> tuple[Array, Array]:
    """A trajectory moved by its errors.

    Args:
        q: Poses, (n, b, nq).
        v: Velocities, (n, b, nv).
        delta: Errors δ, (n, b, 2 nv).
    """
    nv = v.shape[-1]
    return moved(q, delta[..., :nv]), v + delta[..., nv:]


def linearise(model: ObjectModel, q: Array, v: Array, batch: Batch, S: Array, fall: Array) -> LinearSystem:
    """The system for δ around a reference trajectory.

    Args:
        model: The object.
        q: Reference poses, (n, b, nq).
        v: Reference velocities, (n, b, nv).
        batch: Measurements.
        S: Densities of the accelerations [m²/s³, rad²/s³], (n-1, b, nv).
        fall: Downward acceleration [m/s²], (n-1, b).
    """
    n, b, nv = v.shape
    N = 2 * nv
    h = batch.h[..., None]
    spin = v[:-1, :, 3:6]
    if model.n_joints == 0:
        I = model.inertia[0]
        I_inv = np.linalg.inv(I)
        momentum = spin @ I
        alpha = -np.cross(spin, momentum) @ I_inv  # Euler: I ω̇ = -ω × I ω
        A = -I_inv @ (skew(spin) @ I - skew(momentum))  # ∂ω̇/∂ω
    else:  # how a tree's bodies turn each other is left to the white accelerations
        alpha, A = np.zeros_like(spin), np.zeros((*spin.shape, 3))
    phi = (spin + 0.5 * h * alpha) * h

    ahead_q = np.concatenate(
        [
            q[:-1, :, :3] + h * v[:-1, :, :3],
            quat_mul(q[:-1, :, 3:7], quat_exp(phi)),
            q[:-1, :, 7:] + h * v[:-1, :, 6:],
        ],
        axis=-1,
    )
    ahead_q[..., 2] -= 0.5 * fall * batch.h**2
    ahead_v = v[:-1].copy()
    ahead_v[..., 2] -= fall * batch.h
    ahead_v[..., 3:6] += h * alpha
    d = np.concatenate([difference(ahead_q, q[1:]), ahead_v - v[1:]], axis=-1)

    F = np.broadcast_to(np.eye(N), (n - 1, b, N, N)).copy()
    F[..., :nv, nv:] += h[..., None] * np.eye(nv)
    hh = h[..., None]
    # R exp(δθ) exp(φ) = R exp(φ) exp(exp(-φ) δθ), and δφ turns it by the right Jacobian
    F[..., 3:6, 3:6] = rotvec_to_matrix(-phi)
    F[..., 3:6, nv + 3 : nv + 6] = hh * right_jacobian(phi) @ (np.eye(3) + 0.5 * hh * A)
    F[..., nv + 3 : nv + 6, nv + 3 : nv + 6] += hh * A

    return LinearSystem(F, d, white(S, batch.h), difference(batch.q, q), batch.R, batch.seen, first_cov(nv))


def white(S: Array, h: Array) -> Array:
    """Covariance of what a white acceleration does to a state in an interval, (*s, 2 nv, 2 nv).

    Args:
        S: Densities of the acceleration [m²/s³, rad²/s³], (*s, nv).
        h: Lengths of the intervals [s], (*s).
    """
    nv, step = S.shape[-1], h[..., None]
    Q = np.zeros((*S.shape[:-1], 2 * nv, 2 * nv))
    at = np.arange(nv)
    Q[..., at, at] = S * step**3 / 3
    Q[..., at, at + nv] = Q[..., at + nv, at] = S * step**2 / 2
    Q[..., at + nv, at + nv] = S * step
    return Q


def first_cov(nv: int) -> Array:
    """Covariance of the first state, (2 nv, 2 nv)."""
    prior = np.array([PRIOR[0]] * 3 + [PRIOR[1]] * (nv - 3) + [PRIOR[2]] * 3 + [PRIOR[3]] * (nv - 3))
    return np.diag(prior**2)


def noise_moments(system: LinearSystem, mean: Array, cov: Array, lag: Array) -> Array:
    """E[w²] of the velocity part of w, given all measurements, (n-1, b, nv).

    Args:
        system: The linear system.
        mean: Smoothed means, (n, b, 2 nv).
        cov: Smoothed covariances, (n, b, 2 nv, 2 nv).
        lag: Lag-one covariances, (n-1, b, 2 nv, 2 nv).
    """
    nv = mean.shape[-1] // 2
    F = system.F[..., nv:, :]
    # w_k = δ_{k+1} - F δ_k - d, whose variance needs the covariance of neighbours
    w = mean[1:, :, nv:] - (F @ mean[:-1, ..., None])[..., 0] - system.d[..., nv:]
    across = np.einsum("kbij,kbji->kbi", F, lag[..., nv:])
    spread = np.einsum("kbij,kbjl,kbil->kbi", F, cov[:-1], F)
    var = np.diagonal(cov[1:], axis1=-2, axis2=-1)[..., nv:] + spread - 2 * across
    return w**2 + np.maximum(var, 0.0)
