"""The first state of a toss, fitted to its free flight before first contact."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.errors import ObjectError
from tossid.kernels import inlined_kernel, kernel, lean_kernel
from tossid.motion.contact import may_touch
from tossid.objects import GRAVITY, ObjectModel
from tossid.parallel import over_threads
from tossid.rotations import quat_boxminus, quat_exp, quat_mul, quat_normalize, quat_rotate
from tossid.types import Toss

Array = NDArray[np.float64]

FEWEST_FRAMES = 4
"""Frames of flight below which the first recorded velocity takes part in the fit."""
SUBSTEP = 0.1
"""Turn of one step of the integration of free rotation, which is of fourth order [rad]."""
ITERATIONS = 8
"""Most Gauss-Newton steps."""
_DIFFERENCE = 1e-5
"""Step of central differences with respect to the first state [SI]: between rounding and curvature."""


@dataclass(frozen=True, slots=True)
class FlightState:
    """State of a toss's first frame, fitted to its flight.

    Attributes:
        q: Configuration, (nq,).
        v: Velocity, (nv,).
        cov: Covariance of (q, v) in the tangent space, (2 nv, 2 nv); scaled by `chi2` where that exceeds 1.
        n_frames: Frames used; 0 where the toss starts in contact, and q and v are as recorded.
        chi2: Weighted squared residual over its degrees of freedom; 1 where the noise is as stated.
        residuals: Weighted residuals, (6 N + 6,), N the most frames of flight of any toss that was fitted with it; none
            where there is no flight.
    """

    q: Array
    v: Array
    cov: Array
    n_frames: int
    chi2: float
    residuals: Array = field(default_factory=lambda: np.zeros(0), repr=False)


class _Body(NamedTuple):
    """A free body: centre of mass (3,), inertia about it and its inverse (3, 3), and the gravity that it is given.

    `ratio` bounds how much faster than at the start it can come to spin.
    """

    com: Array
    inertia: Array
    inverse: Array
    ratio: float
    gravity: float


class _Flights(NamedTuple):
    """Flights of B tosses: times (B, N), n frames each (B,), poses (B, N, 7) and first velocities (B, 6) as recorded.

    roots (B, N, 6, 6) and root_v (B, 6, 6) are the roots of their weights.
    """

    t: Array
    n: NDArray[np.int64]
    q: Array
    roots: Array
    v: Array
    root_v: Array


def flight_state(toss: Toss, model: ObjectModel, *, gravity: float = GRAVITY) -> FlightState:
    """The first state of one toss; see `flight_states`.

    Args:
        toss: As recorded.
        model: The object, without joints.
        gravity: [m/s²].
    """
    return flight_states([toss], model, gravity=gravity)[0]


def flight_states(
    tosses: Sequence[Toss], model: ObjectModel, *, gravity: float = GRAVITY, n_threads: int = 1
) -> list[FlightState]:
    """The first state of each toss, by fitting ballistic translation and torque-free rotation to its flight.

    Least squares over the poses before first contact, weighted with their covariances: c(t) = c_0 + u_0 t - g t²/2 e_z
    for the centre of mass, and Euler's equation I ω̇ = -ω × I ω with Ṙ = R ω^ for the attitude. Recorded velocities are
    differences of the same poses, and often lag: the first one takes part only where flight has fewer than
    `FEWEST_FRAMES` frames. All tosses are fitted together (Gauss-Newton, Jacobians by central differences).

    Args:
        tosses: As recorded.
        model: The object, without joints.
        gravity: [m/s²]; the true one unless a model is to be judged with its own.
        n_threads: Over which tosses are split.

    Raises:
        ObjectError: The object has joints (its flight needs the whole tree's dynamics).
    """
    if model.n_joints:
        raise ObjectError(f"object '{model.name}' has joints: its flight cannot be fitted as a single body's")
    count = frames_in_flight(tosses, model)
    states = [_as_recorded(toss) for toss in tosses]
    flying = [i for i, frames in enumerate(count) if frames]
    if not flying:
        return states
    c, n = model.com[0], count[flying]
    t, q, roots = _padded([tosses[i] for i in flying], n)
    v = np.stack([tosses[i].v[0] for i in flying])
    v_cov = np.stack([tosses[i].v_cov[0] for i in flying])
    root_v: Array = np.linalg.inv(np.linalg.cholesky(_regular(v_cov)))
    root_v *= (n < FEWEST_FRAMES)[:, None, None]
    state_q, state_v = _start(t, q, v, c, gravity)

    I = model.inertia[0]
    body = _Body(c, I, np.linalg.inv(I), float(np.sqrt(np.linalg.cond(I))), gravity)
    flights = _Flights(t, n, q, roots, v, root_v)

    def residuals(at_q: Array, at_v: Array) -> Array:
        """(B, m, 6 N + 6) weighted residuals of m states a toss; 0 past a toss's last frame of flight."""
        out = np.zeros((*at_q.shape[:2], 6 * t.shape[1] + 6))
        over_threads(lambda first, last: _residuals(flights, body, at_q, at_v, out, first, last), len(n), n_threads)
        return out

    steps = _DIFFERENCE * np.concatenate([np.zeros((1, 12)), np.eye(12), -np.eye(12)])
    for iteration in range(ITERATIONS + 1):
        around = residuals(*_moved(state_q, state_v, np.broadcast_to(steps, (len(n), *steps.shape))))
        r, J = around[:, 0], (around[:, 1:13] - around[:, 13:]).mT / (2 * _DIFFERENCE)
        Q, R = np.linalg.qr(J)
        step = -np.linalg.solve(R, Q.mT @ r[..., None])[..., 0]
        if iteration == ITERATIONS or np.abs(step).max() < 1e-10:
            break
        moved_q, moved_v = _moved(state_q, state_v, step[:, None])
        state_q, state_v = moved_q[:, 0], moved_v[:, 0]
    inverse = np.linalg.inv(R)
    free = np.maximum(1, 6 * n + 6 * (n < FEWEST_FRAMES) - 12)
    chi2 = (r**2).sum(-1) / free
    cov = inverse @ inverse.mT * np.maximum(1.0, chi2)[:, None, None]
    for k, i in enumerate(flying):
        states[i] = FlightState(state_q[k], state_v[k], cov[k], int(n[k]), float(chi2[k]), r[k])
    return states


def flight_frames(toss: Toss, model: ObjectModel) -> int:
    """Number of frames from the first on in which the object cannot yet have touched the ground.

    Args:
        toss: As recorded.
        model: The object.
    """
    return int(frames_in_flight([toss], model)[0])


def frames_in_flight(tosses: Sequence[Toss], model: ObjectModel) -> NDArray[np.int64]:
    """(B,) `flight_frames` of each of B tosses.

    Args:
        tosses: As recorded.
        model: The object.
    """
    if not len(tosses):
        return np.zeros(0, dtype=np.int64)
    length = np.array([len(toss) for toss in tosses])
    begins = np.cumsum(length) - length
    t, q = np.concatenate([toss.t for toss in tosses]), np.concatenate([toss.q for toss in tosses])
    touches = np.append(np.flatnonzero(may_touch(model, t, q, begins)), len(t))
    before = touches[np.searchsorted(touches, begins)] - begins  # intervals before the first that may touch
    return np.where(before == 0, 0, np.minimum(before + 1, length))


def _as_recorded(toss: Toss) -> FlightState:
    nothing = np.zeros((6, 6))
    cov = np.block([[toss.q_cov[0], nothing], [nothing, toss.v_cov[0]]])
    return FlightState(toss.q[0].copy(), toss.v[0].copy(), cov, 0, 1.0)


def _padded(tosses: Sequence[Toss], n: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """t (B, N) from the first frame, q (B, N, 7), and the roots of the weights (B, N, 6, 6), 0 past a toss's n."""
    B, N = len(tosses), int(n.max())
    t, q, roots = np.empty((B, N)), np.empty((B, N, 7)), np.zeros((B, N, 6, 6))
    for k, (toss, m) in enumerate(zip(tosses, n, strict=True)):
        measured, cov = toss.measured
        t[k, :m], t[k, m:] = toss.t[:m] - toss.t[0], toss.t[m - 1] - toss.t[0]
        q[k, :m], q[k, m:] = measured[:m], measured[m - 1]
        roots[k, :m] = np.linalg.inv(np.linalg.cholesky(_regular(cov[:m])))
    return t, q, roots


def _start(t: Array, q: Array, v: Array, c: Array, gravity: float) -> tuple[Array, Array]:
    """A first guess from the first and a later pose; where one frame is all there is, from its velocity."""
    first, guess = q[:, 0].copy(), v.copy()
    several = t[:, -1] > 0
    if several.any():
        t, q = t[several], q[several]
        spin = quat_boxminus(q[:, 1, 3:7], q[:, 0, 3:7]) / t[:, 1:2]
        com = q[..., :3] + quat_rotate(q[..., 3:7], c)
        speed = (com[:, -1] - com[:, 0]) / t[:, -1:]
        speed[:, 2] += 0.5 * gravity * t[:, -1]
        guess[several, 3:] = spin
        guess[several, :3] = speed - quat_rotate(q[:, 0, 3:7], np.cross(spin, c))
    return first, guess


@inlined_kernel
def _spin_rate(w0, w1, w2, I, J):  # type: ignore[no-untyped-def]
    """I^-1 (I ω × ω), J = I^-1."""
    l0 = I[0, 0] * w0 + I[0, 1] * w1 + I[0, 2] * w2
    l1 = I[1, 0] * w0 + I[1, 1] * w1 + I[1, 2] * w2
    l2 = I[2, 0] * w0 + I[2, 1] * w1 + I[2, 2] * w2
    c0, c1, c2 = l1 * w2 - l2 * w1, l2 * w0 - l0 * w2, l0 * w1 - l1 * w0
    return (
        J[0, 0] * c0 + J[0, 1] * c1 + J[0, 2] * c2,
        J[1, 0] * c0 + J[1, 1] * c1 + J[1, 2] * c2,
        J[2, 0] * c0 + J[2, 1] * c1 + J[2, 2] * c2,
    )


@lean_kernel
def _tumbled(quat, w, h, fastest, I, J):  # type: ignore[no-untyped-def]
    """Attitude and spin of a free body after a time h: Runge-Kutta for ω, Magnus for R, both of fourth order.

    `fastest` bounds the spin, and so says how many steps that takes.
    """
    (q0, q1, q2, q3), (w0, w1, w2) = quat, w
    count = max(1, math.ceil(fastest * h / SUBSTEP))
    d = h / count
    for _ in range(count):
        a0, a1, a2 = _spin_rate(w0, w1, w2, I, J)
        b0, b1, b2 = _spin_rate(w0 + 0.5 * d * a0, w1 + 0.5 * d * a1, w2 + 0.5 * d * a2, I, J)
        c0, c1, c2 = _spin_rate(w0 + 0.5 * d * b0, w1 + 0.5 * d * b1, w2 + 0.5 * d * b2, I, J)
        e0, e1, e2 = _spin_rate(w0 + d * c0, w1 + d * c1, w2 + d * c2, I, J)
        x0 = w0 + d / 6 * (a0 + 2 * b0 + 2 * c0 + e0)
        x1 = w1 + d / 6 * (a1 + 2 * b1 + 2 * c1 + e1)
        x2 = w2 + d / 6 * (a2 + 2 * b2 + 2 * c2 + e2)
        e0, e1, e2 = _spin_rate(x0, x1, x2, I, J)
        f = d * d / 12
        r0 = d * 0.5 * (w0 + x0) - f * (e0 - a0) + f * (w1 * x2 - w2 * x1)
        r1 = d * 0.5 * (w1 + x1) - f * (e1 - a1) + f * (w2 * x0 - w0 * x2)
        r2 = d * 0.5 * (w2 + x2) - f * (e2 - a2) + f * (w0 * x1 - w1 * x0)
        angle = 0.5 * math.sqrt(r0 * r0 + r1 * r1 + r2 * r2)
        s = 0.5 * math.sin(angle) / angle if angle > 1e-12 else 0.5
        co, s0, s1, s2 = math.cos(angle), s * r0, s * r1, s * r2
        y0 = q0 * co - q1 * s0 - q2 * s1 - q3 * s2
        y1 = q0 * s0 + q1 * co + q2 * s2 - q3 * s1
        y2 = q0 * s1 - q1 * s2 + q2 * co + q3 * s0
        y3 = q0 * s2 + q1 * s1 - q2 * s0 + q3 * co
        s = 1.0 / math.sqrt(y0 * y0 + y1 * y1 + y2 * y2 + y3 * y3)
        q0, q1, q2, q3 = s * y0, s * y1, s * y2, s * y3
        w0, w1, w2 = x0, x1, x2
    return (q0, q1, q2, q3), (w0, w1, w2)


@inlined_kernel
def _rotated(q, x):  # type: ignore[no-untyped-def]
    """Vector x turned by the quaternion q."""
    t0, t1, t2 = 2 * (q[2] * x[2] - q[3] * x[1]), 2 * (q[3] * x[0] - q[1] * x[2]), 2 * (q[1] * x[1] - q[2] * x[0])
    return (
        x[0] + q[0] * t0 + q[2] * t2 - q[3] * t1,
        x[1] + q[0] * t1 + q[3] * t0 - q[1] * t2,
        x[2] + q[0] * t2 + q[1] * t1 - q[2] * t0,
    )


@kernel(allocates=False)
def _residuals(flights, body, at_q, at_v, out, first, last):  # type: ignore[no-untyped-def]
    """Residuals of tosses first..last-1, from states at_q (B, m, 7), at_v (B, m, 6), into out (B, m, 6 N + 6)."""
    c, I, J, ratio, gravity = body
    for b in range(first, last):
        for m in range(at_q.shape[1]):
            p, u = at_q[b, m], at_v[b, m]
            quat, w = (p[3], p[4], p[5], p[6]), (u[3], u[4], u[5])
            fastest = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]) * ratio
            com = _rotated(quat, (c[0], c[1], c[2]))
            x = (w[1] * c[2] - w[2] * c[1], w[2] * c[0] - w[0] * c[2], w[0] * c[1] - w[1] * c[0])
            x = _rotated(quat, x)
            start, speed = (p[0] + com[0], p[1] + com[1], p[2] + com[2]), (u[0] + x[0], u[1] + x[1], u[2] + x[2])
            for k in range(flights.n[b]):
                t = flights.t[b, k]
                if k > 0:
                    quat, w = _tumbled(quat, w, t - flights.t[b, k - 1], fastest, I, J)
                com, y = _rotated(quat, (c[0], c[1], c[2])), flights.q[b, k]
                r0, r1, r2 = y[0] - start[0] - speed[0] * t + com[0], y[1] - start[1] - speed[1] * t + com[1], y[2]
                r2 += 0.5 * gravity * t * t - start[2] - speed[2] * t + com[2]
                r3, r4, r5 = _turn_between(quat, (y[3], y[4], y[5], y[6]))
                R = flights.roots[b, k]
                for i in range(6):
                    out[b, m, 6 * k + i] = (
                        R[i, 0] * r0 + R[i, 1] * r1 + R[i, 2] * r2 + R[i, 3] * r3 + R[i, 4] * r4 + R[i, 5] * r5
                    )
            for i in range(6):
                summed = 0.0
                for j in range(6):
                    summed += flights.root_v[b, i, j] * (flights.v[b, j] - u[j])
                out[b, m, 6 * flights.t.shape[1] + i] = summed


@inlined_kernel
def _turn_between(a, b):  # type: ignore[no-untyped-def]
    """log(a^-1 b): the rotation vector that takes quaternion a to b."""
    s = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    x = a[0] * b[1] - a[1] * b[0] - a[2] * b[3] + a[3] * b[2]
    y = a[0] * b[2] - a[2] * b[0] - a[3] * b[1] + a[1] * b[3]
    z = a[0] * b[3] - a[3] * b[0] - a[1] * b[2] + a[2] * b[1]
    size = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 * math.atan2(size, abs(s)) / size if size > 1e-12 else 2.0
    scale = -scale if s < 0.0 else scale
    return scale * x, scale * y, scale * z


def _moved(q: Array, v: Array, steps: Array) -> tuple[Array, Array]:
    """States (B, 7), (B, 6) moved by m errors each (B, m, 12): (B, m, 7), (B, m, 6)."""
    turned = quat_normalize(quat_mul(q[:, None, 3:7], quat_exp(steps[..., 3:6])))
    return np.concatenate([q[:, None, :3] + steps[..., :3], turned], axis=-1), v[:, None] + steps[..., 6:]


def _regular(cov: Array) -> Array:
    """A covariance with no direction that is exactly certain."""
    size = np.trace(cov, axis1=-2, axis2=-1)[..., None, None]
    return cov + (1e-12 * size + 1e-20) * np.eye(cov.shape[-1])
