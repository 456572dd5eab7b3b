"""The first state of a toss, as its whole free flight before first contact tells it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.errors import ObjectError
from tossid.motion.contact import may_touch
from tossid.objects import GRAVITY, ObjectModel
from tossid.rotations import quat_boxminus, quat_exp, quat_mul, quat_normalize, quat_rotate
from tossid.types import Toss

Array = NDArray[np.float64]

FEWEST_FRAMES = 4
"""Frames of flight below which the first recorded velocity takes part in the fit."""
SUBSTEP = 0.1
"""[rad] of turn a step when the free rotation is integrated (fourth order)."""
ITERATIONS = 8
_DIFFERENCE = 1e-5


@dataclass(frozen=True, slots=True)
class FlightState:
    """State of a toss's first frame, fitted to its flight.

    q (nq,), v (nv,), cov (2 nv, 2 nv) of (q, v) in the tangent space, n_frames
    used (0: the toss starts in contact, q and v are the first frame's own), and
    chi2: the weighted squared residual a degree of freedom (1 where the noise
    is as stated; the covariance is scaled by it where it is larger).
    """

    q: Array
    v: Array
    cov: Array
    n_frames: int
    chi2: float


def flight_state(toss: Toss, model: ObjectModel, *, gravity: float = GRAVITY) -> FlightState:
    """Fit ballistic translation and torque-free rotation to the frames before first contact.

    Least squares over the poses, weighted with their covariances:
    c(t) = c_0 + u_0 t - g t²/2 e_z for the centre of mass, and Euler's equation
    I ω̇ = -ω × I ω with Ṙ = R ω^ for the attitude. Recorded velocities are
    differences of the same poses, and often lag: they take part (the first
    one) only where fewer than `FEWEST_FRAMES` frames of flight are there.

    Args:
        gravity: [m/s²], the truth's 9.81 unless a model is to be judged with its own.

    Raises:
        ObjectError: the object has joints (its flight needs the whole tree's dynamics).
    """
    if model.n_joints:
        raise ObjectError(f"object '{model.name}' has joints: its flight cannot be fitted as a single body's")
    n = flight_frames(toss, model)
    if n == 0:
        nothing = np.zeros((6, 6))
        cov = np.block([[toss.q_cov[0], nothing], [nothing, toss.v_cov[0]]])
        return FlightState(toss.q[0].copy(), toss.v[0].copy(), cov, 0, 1.0)

    c = model.com[0]
    t, q = toss.t[:n] - toss.t[0], toss.q[:n]
    roots = np.linalg.inv(np.linalg.cholesky(_regular(toss.q_cov[:n])))
    use_velocity = n < FEWEST_FRAMES
    root_v = np.linalg.inv(np.linalg.cholesky(_regular(toss.v_cov[0])))
    state_q, state_v = _start(t, q, toss.v[0], c, gravity)

    def residuals(at_q: Array, at_v: Array) -> Array:
        """(m, ·) weighted residuals of m states."""
        poses = _fly(t, at_q, at_v, model, gravity)
        error = np.concatenate([q[:, :3] - poses[..., :3], quat_boxminus(q[:, 3:7], poses[..., 3:7])], axis=-1)
        out = (roots @ error[..., None])[..., 0].reshape(len(at_q), -1)
        return np.concatenate([out, (toss.v[0] - at_v) @ root_v.T], axis=1) if use_velocity else out

    steps = _DIFFERENCE * np.concatenate([np.zeros((1, 12)), np.eye(12), -np.eye(12)])
    for iteration in range(ITERATIONS + 1):
        around = residuals(*_moved(state_q, state_v, steps))
        r, J = around[0], (around[1:13] - around[13:]).T / (2 * _DIFFERENCE)
        step = -np.linalg.lstsq(J, r, rcond=None)[0]
        if iteration == ITERATIONS or np.abs(step).max() < 1e-10:
            break
        moved_q, moved_v = _moved(state_q, state_v, step[None])
        state_q, state_v = moved_q[0], moved_v[0]
    chi2 = float(r @ r / max(1, len(r) - 12))
    cov = np.linalg.inv(J.T @ J) * max(1.0, chi2)
    return FlightState(state_q, state_v, 0.5 * (cov + cov.T), n, chi2)


def flight_frames(toss: Toss, model: ObjectModel) -> int:
    """Frames from the first on in which the object cannot yet have touched the ground."""
    contact = may_touch(model, toss.t, toss.q)
    return int(np.argmax(contact)) + 1 if contact.any() and not contact[0] else 0 if contact[0] else len(toss)


def _start(t: Array, q: Array, v: Array, c: Array, gravity: float) -> tuple[Array, Array]:
    """A first guess from the first and a later pose."""
    guess = v.copy()
    if len(t) > 1:
        guess[3:] = quat_boxminus(q[1, 3:7], q[0, 3:7]) / t[1]
        com = q[:, :3] + quat_rotate(q[:, 3:7], c)
        speed = (com[-1] - com[0]) / t[-1] + np.array([0.0, 0.0, 0.5 * gravity * t[-1]])
        guess[:3] = speed - quat_rotate(q[0, 3:7], np.cross(guess[3:], c))
    return q[0].copy(), guess


def _fly(t: Array, q: Array, v: Array, model: ObjectModel, gravity: float) -> Array:
    """Poses (m, n, 7) at times t (n,), t[0] = 0, of a free body that starts at m states q (m, 7), v (m, 6)."""
    c, I = model.com[0], model.inertia[0]
    spin = v[:, 3:]
    if np.abs(I - I[0, 0] * np.eye(3)).max() < 1e-12 * I[0, 0]:
        turned = quat_mul(q[:, None, 3:7], quat_exp(spin[:, None] * t[:, None]))
    else:
        turned = _tumble(t, q[:, 3:7], spin, I)
    com = q[:, :3] + quat_rotate(q[:, 3:7], c)
    speed = v[:, :3] + quat_rotate(q[:, 3:7], np.cross(spin, c))
    p = com[:, None] + speed[:, None] * t[:, None] - quat_rotate(turned, c)
    p[..., 2] -= 0.5 * gravity * t**2
    return np.concatenate([p, turned], axis=-1)


def _tumble(t: Array, quat: Array, spin: Array, I: Array) -> Array:
    """Attitudes (m, n, 4) of a free rigid body: Runge-Kutta for ω, Magnus for R, both of fourth order."""
    I_inv = np.linalg.inv(I)

    def turn(w: Array) -> Array:
        return np.cross(w @ I, w) @ I_inv

    out = [quat]
    fastest = float(np.linalg.norm(spin, axis=1).max()) * np.sqrt(np.linalg.cond(I))
    for h in np.diff(t):
        count = max(1, int(np.ceil(fastest * h / SUBSTEP)))
        d = h / count
        for _ in range(count):
            k1 = turn(spin)
            k2 = turn(spin + 0.5 * d * k1)
            k3 = turn(spin + 0.5 * d * k2)
            ahead = spin + d / 6 * (k1 + 2 * k2 + 2 * k3 + turn(spin + d * k3))
            mean = 0.5 * (spin + ahead) - d / 12 * (turn(ahead) - k1)
            quat = quat_mul(quat, quat_exp(d * mean + d**2 / 12 * np.cross(spin, ahead)))
            spin = ahead
        out.append(quat)
    return quat_normalize(np.stack(out, axis=1))


def _moved(q: Array, v: Array, steps: Array) -> tuple[Array, Array]:
    """A state moved by m errors (m, 12): (m, 7), (m, 6)."""
    turned = quat_normalize(quat_mul(q[3:7], quat_exp(steps[:, 3:6])))
    return np.concatenate([q[:3] + steps[:, :3], turned], axis=1), v + steps[:, 6:]


def _regular(cov: Array) -> Array:
    """A covariance with no direction that is exactly certain."""
    size = np.trace(cov, axis1=-2, axis2=-1)[..., None, None]
    return cov + (1e-12 * size + 1e-20) * np.eye(cov.shape[-1])
