"""Ballistic flight: the centre of mass on a parabola, the attitude turning freely, fitted to poses.

`fit_polynomial` fits parabolas and other polynomials in time to stretches of frames, with their covariance, and
`local_parabolas` fits one around each frame. `free_turn` continues an attitude by Euler's equations. `flight_states`
fits both to tosses and gives their first states.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.errors import ObjectError
from tossid.motion.contact import may_touch
from tossid.objects import GRAVITY, ObjectModel
from tossid.rotations import (
    quat_boxminus,
    quat_exp,
    quat_mul,
    quat_normalize,
    quat_rotate,
    quat_to_matrix,
    right_jacobian_inv,
    skew,
)
from tossid.types import Toss

Array = NDArray[np.float64]

FEWEST_FRAMES = 4
"""Frames of flight below which the first recorded velocity takes part in the fit."""
SUBSTEP = 0.1
"""Turn of one step of the integration of free rotation, which is of fourth order [rad]."""
ITERATIONS = 8
"""Most Gauss-Newton steps."""
SHORT_STEP = 1e-7
"""Step [m, rad, m/s, rad/s] that is the last one: the next would be some thousand times as short."""
START_TIME = 0.03
"""Time within which the first spin is guessed, as a turn over several frames [s]: at 100 rad/s it is half a turn."""
OUTLIER = 4.0
"""Residual over the noise from which one of a local fit's frames may be an outlier; it is then fitted without one."""
INLIERS = 2.0
"""It is one if the rms residual of the others, fitted without it, is below this many times the noise."""
_DIFFERENCE = 1e-5
"""Step of differences with respect to the first spin [rad/s]: between rounding and curvature."""
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]
"""Of three axes, those that follow."""


class PolynomialFit(NamedTuple):
    """Polynomials in time fitted to stretches of n frames.

    Attributes:
        coefficients: Value and derivatives at t = 0, (*b, degree + 1, d).
        residuals: (*b, n, d).
        unit_cov: Covariance of the coefficients for noise of standard deviation 1, (*b, degree + 1, degree + 1).
    """

    coefficients: Array
    residuals: Array
    unit_cov: Array

    @property
    def noise(self) -> Array:
        """Standard deviation of the noise, the same in all d coordinates, (*b,)."""
        n, d = self.residuals.shape[-2:]
        return np.asarray(np.sqrt((self.residuals**2).sum(axis=(-1, -2)) / (d * (n - self.unit_cov.shape[-1]))))


def fit_polynomial(t: Array, x: Array, degree: int = 2) -> PolynomialFit:
    """Polynomials of least squares, by default parabolas: place, velocity and acceleration at t = 0.

    Args:
        t: Times of each stretch, t = 0 within it or near [s], (*b, n).
        x: Coordinates, (*b, n, d).
        degree: Of the polynomials.
    """
    unit = np.abs(t).max()  # powers of times near 1 keep the normal equations well conditioned
    factorial = np.array([math.factorial(k) for k in range(degree + 1)])
    basis = (t / unit)[..., None] ** np.arange(degree + 1) / factorial
    inverse = np.linalg.inv(basis.mT @ basis)
    coefficients = inverse @ (basis.mT @ x)
    scale = unit ** -np.arange(degree + 1.0)
    return PolynomialFit(scale[:, None] * coefficients, x - basis @ coefficients, scale[:, None] * inverse * scale)


def first_parabola(t: Array, x: Array, clear: NDArray[np.bool_], fewest: int) -> PolynomialFit | None:
    """The parabola of a toss's first flight, about the middle of its times; None where it has too few frames.

    Args:
        t: Times [s], (n,).
        x: Positions [m], (n, 3).
        clear: Frames that are clear of the ground, (n,); the flight ends before the first that is not.
        fewest: Frames that it takes.
    """
    n = len(clear) if clear.all() else int(np.argmin(clear))
    return fit_polynomial(t[:n] - t[:n].mean(), x[:n]) if n >= fewest else None


def without_line(t: Array) -> Array:
    """The projection of coordinates (*b, n, d) onto what no line in time explains, (*b, n, n).

    Args:
        t: Times of each stretch [s], (*b, n).
    """
    s = t - t.mean(axis=-1, keepdims=True)
    line = np.stack([np.full_like(s, s.shape[-1] ** -0.5), s / np.linalg.norm(s, axis=-1, keepdims=True)], axis=-1)
    return np.asarray(np.eye(s.shape[-1]) - line @ line.mT)


def acceleration_deviation(noise: Array | float, half: int, dt: float) -> Array:
    """Standard deviation of a local parabola's acceleration, along each axis [m/s²]: its variance is 720 σ² / N⁵ dt⁴.

    Args:
        noise: σ, standard deviation of positions [m].
        half: Frames on each side, N - 1 in all.
        dt: Time step [s].
    """
    return np.asarray(np.sqrt(720.0 / (2 * half + 1) ** 5) * noise / dt**2)


def half_width(noise: float, dt: float, *, least: int, certain: float, longest: float) -> int:
    """Frames on each side of a local parabola: the fewest that make its acceleration as certain as is needed.

    Three cameras or a tracker need `least`. Poses of one camera are noisy along its axis.

    Args:
        noise: Standard deviation of positions [m].
        dt: Time step [s].
        least: The fewest in any case.
        certain: Standard deviation of the acceleration [m/s²].
        longest: Time that a parabola spans at most [s].
    """
    half = least
    while acceleration_deviation(noise, half, dt) > certain and 2 * (half + 1) * dt <= longest:
        half += 1
    return half


def local_parabolas(t: Array, x: Array, half: int, noise: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Velocity and acceleration at each frame, from a parabola through it and `half` frames on each side.

    Where one frame is an outlier of a parabola that fits all others, it is left out: one wrong pose is no acceleration.

    Args:
        t: Times [s], (n,).
        x: Positions [m], (n, 3).
        half: Frames on each side.
        noise: Standard deviation of x [m], (n,).

    Returns:
        Velocities [m/s] (n, 3), accelerations [m/s²] (n, 3), and which frames are outliers of their own parabola (n,).
    """
    n, width = len(t), min(2 * half + 1, len(t))
    index = np.clip(np.arange(n) - half, 0, n - width)[:, None] + np.arange(width)
    s = t[index] - t[:, None]
    fit = fit_polynomial(s, x[index])
    fitted, outlier = fit.coefficients.copy(), np.zeros(n, dtype=bool)
    suspect = np.zeros(0, dtype=np.int64)
    if width > 2 * half and width > 4:
        suspect = np.flatnonzero(np.linalg.norm(fit.residuals, axis=-1).max(axis=1) > OUTLIER * noise)
    best = np.full(len(suspect), np.inf)
    for left_out in range(width if len(suspect) else 0):
        keep = np.delete(np.arange(width), left_out)
        again = fit_polynomial(s[suspect][:, keep], x[index[suspect][:, keep]])
        rms = np.sqrt(np.mean(again.residuals**2, axis=(1, 2)))
        better = (rms < INLIERS * noise[suspect]) & (rms < best)
        best = np.where(better, rms, best)
        fitted[suspect[better]] = again.coefficients[better]
        outlier[suspect[better]] = index[suspect[better], left_out] == suspect[better]
    return fitted[:, 1], fitted[:, 2], outlier


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


class _Flights(NamedTuple):
    """Flights of B tosses: times (B, N), poses (B, N, 7) and first velocities (B, 6) as recorded.

    roots (B, N, 6, 6) and root_v (B, 6, 6) are the roots of their weights, 0 for what takes no part.
    """

    t: Array
    q: Array
    roots: Array
    v: Array
    root_v: Array


def flight_states(tosses: Sequence[Toss], model: ObjectModel, *, gravity: float = GRAVITY) -> list[FlightState]:
    """The first state of each toss, by fitting ballistic translation and torque-free rotation to its flight.

    Least squares over the poses before first contact, weighted with their covariances: c(t) = c_0 + u_0 t - g t²/2 e_z
    for the centre of mass, and Euler's equation I ω̇ = -ω × I ω with Ṙ = R ω^ for the attitude. Recorded velocities are
    differences of the same poses, and often lag: the first one takes part only where flight has fewer than
    `FEWEST_FRAMES` frames. All tosses are fitted together, by Gauss and Newton.

    Args:
        tosses: As recorded.
        model: The object, without joints.
        gravity: [m/s²]; the true one unless a model is to be judged with its own.

    Raises:
        ObjectError: The object has joints (its flight needs the whole tree's dynamics).
    """
    if model.n_joints:
        raise ObjectError(f"object '{model.name}' has joints: its flight cannot be fitted as a single body's")
    count = frames_in_flight(tosses, model)
    states = [_as_recorded(toss) for toss in tosses]
    flying = np.flatnonzero(count).tolist()
    if not flying:
        return states
    n = count[flying]
    flights = _side_by_side([tosses[i] for i in flying], n)
    q, v = _start(flights, model.com[0], gravity)
    for _ in range(ITERATIONS):
        r, J = _residuals(flights, q, v, model, gravity)
        # the triangle of [J r] is R of J beside Qᵀ r
        triangle = np.asarray(np.linalg.qr(np.concatenate([J, r[..., None]], axis=-1), mode="r"))
        R, rotated = triangle[:, :12, :12], triangle[:, :12, 12:]
        step = -np.linalg.solve(R, rotated)
        turned = quat_normalize(quat_mul(q[:, 3:7], quat_exp(step[:, 3:6, 0])))
        q, v = np.concatenate([q[:, :3] + step[:, :3, 0], turned], axis=1), v + step[:, 6:, 0]
        if np.abs(step).max() < SHORT_STEP:
            break
    r = r + (J @ step)[..., 0]  # over so short a step, residuals are linear
    inverse = np.linalg.inv(R)
    free = np.maximum(1, 6 * n + 6 * (n < FEWEST_FRAMES) - 12)
    chi2 = (r**2).sum(-1) / free
    cov = inverse @ inverse.mT * np.maximum(1.0, chi2)[:, None, None]
    for k, i in enumerate(flying):
        states[i] = FlightState(q[k], v[k], cov[k], int(n[k]), float(chi2[k]), r[k])
    return states


def frames_in_flight(tosses: Sequence[Toss], model: ObjectModel) -> NDArray[np.int64]:
    """(B,) numbers of frames from the first on in which the object cannot yet have touched the ground.

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
    nothing = np.zeros_like(toss.q_cov[0])
    cov = np.block([[toss.q_cov[0], nothing], [nothing, toss.v_cov[0]]])
    return FlightState(toss.q[0].copy(), toss.v[0].copy(), cov, 0, 1.0)


def _side_by_side(tosses: Sequence[Toss], n: NDArray[np.int64]) -> _Flights:
    """The flights of tosses with n frames each; short ones repeat their last frame, which does not count."""
    B, N = len(tosses), int(n.max())
    t, q, roots = np.empty((B, N)), np.empty((B, N, 7)), np.zeros((B, N, 6, 6))
    for k, (toss, m) in enumerate(zip(tosses, n, strict=True)):
        measured, cov = toss.measured
        t[k, :m], t[k, m:] = toss.t[:m] - toss.t[0], toss.t[m - 1] - toss.t[0]
        q[k, :m], q[k, m:] = measured[:m], measured[m - 1]
        roots[k, :m] = np.linalg.inv(np.linalg.cholesky(_regular(cov[:m])))
    root_v = np.linalg.inv(np.linalg.cholesky(_regular(np.stack([toss.v_cov[0] for toss in tosses]))))
    takes_part = (n < FEWEST_FRAMES)[:, None, None]
    return _Flights(t, q, roots, np.stack([toss.v[0] for toss in tosses]), np.where(takes_part, root_v, 0.0))


def _regular(cov: Array) -> Array:
    """A covariance with no direction that is exactly certain."""
    size = np.trace(cov, axis1=-2, axis2=-1)[..., None, None]
    return cov + (1e-12 * size + 1e-20) * np.eye(cov.shape[-1])


def _start(flights: _Flights, c: Array, gravity: float) -> tuple[Array, Array]:
    """A first guess from the first and a later pose; where one frame is all there is, from its velocity."""
    first, guess = flights.q[:, 0].copy(), flights.v.copy()
    several = flights.t[:, -1] > 0
    if several.any():
        t, q = flights.t[several], flights.q[several]
        later = max(1, int((t < START_TIME).sum(axis=1).min()) - 1)
        spin = quat_boxminus(q[:, later, 3:7], q[:, 0, 3:7]) / t[:, later, None]
        com = q[..., :3] + quat_rotate(q[..., 3:7], c)
        speed = (com[:, -1] - com[:, 0]) / t[:, -1:]
        speed[:, 2] += 0.5 * gravity * t[:, -1]
        guess[several, 3:] = spin
        guess[several, :3] = speed - quat_rotate(q[:, 0, 3:7], np.cross(spin, c))
    return first, guess


def _residuals(flights: _Flights, q: Array, v: Array, model: ObjectModel, gravity: float) -> tuple[Array, Array]:
    """Weighted residuals (B, 6 N + 6) of first states q (B, 7), v (B, 6), and their derivatives (B, 6 N + 6, 12).

    With the first attitude R_0 and the turn S since then, p = p_0 + R_0 c + u t - g t²/2 e_z - R_0 S c, where
    u = v_0 + R_0 (ω_0 × c). An error (δθ_0, δω_0) of attitude and spin turns the body by δθ = Sᵀ δθ_0 + (∂S/∂ω_0) δω_0.
    """
    c, t = model.com[0], flights.t[..., None]
    B, N = flights.t.shape
    turn, by_spin = free_turn(v[:, 3:], flights.t, model.inertia[0])
    attitude = quat_mul(q[:, None, 3:7], turn)
    R0, R = quat_to_matrix(q[:, None, 3:7]), quat_to_matrix(attitude)
    speed = v[:, None, :3] + quat_rotate(q[:, None, 3:7], np.cross(v[:, None, 3:], c))
    place = q[:, None, :3] + quat_rotate(q[:, None, 3:7], c) + t * speed - R @ c
    place[..., 2] -= 0.5 * gravity * flights.t**2
    off = quat_boxminus(flights.q[..., 3:7], attitude)

    turned = np.concatenate([quat_to_matrix(turn).mT, by_spin], axis=-1)
    J = np.zeros((B, N, 6, 12))
    J[..., :3, :3], J[..., :3, 6:9] = np.eye(3), t[..., None] * np.eye(3)
    J[..., :3, [3, 4, 5, 9, 10, 11]] = R @ skew(c) @ turned
    # beside R c, which turns with the body, p holds R_0 c and u, which turn with the first attitude
    J[..., :3, 3:6] -= R0 @ (skew(c) + t[..., None] * skew(np.cross(v[:, None, 3:], c)))
    J[..., :3, 9:] -= t[..., None] * (R0 @ skew(c))
    J[..., 3:, [3, 4, 5, 9, 10, 11]] = right_jacobian_inv(-off) @ turned
    r = flights.roots @ np.concatenate([flights.q[..., :3] - place, off], axis=-1)[..., None]
    J = -flights.roots @ J
    r_v = flights.root_v @ (flights.v - v)[..., None]
    J_v = np.concatenate([np.zeros((B, 6, 6)), -flights.root_v], axis=-1)
    return np.concatenate([r.reshape(B, -1), r_v[..., 0]], axis=1), np.concatenate([J.reshape(B, -1, 12), J_v], axis=1)


def free_turn(spin: Array, t: Array, inertia: Array) -> tuple[Array, Array]:
    """How free bodies turn from their first frames on, by Euler's equations.

    Args:
        spin: At the first frame, body axes [rad/s], (B, 3).
        t: Times, from 0 on [s], (B, N).
        inertia: About the centre of mass [kg m²], (3, 3).

    Returns:
        Quaternions of the turn since the first frame (B, N, 4), and derivatives of its rotation vector, in the turned
        body's axes, by the first spin (B, N, 3, 3) [s].
    """
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 0] *= np.linalg.det(axes)
    by_moments = ((np.roll(moments, -1) - np.roll(moments, 1)) / moments)[:, None, None]

    def rate(w: Array) -> Array:
        """Euler's equations in principal axes, dω_1/dt = (I_2 - I_3) ω_2 ω_3 / I_1 and so on; w: (3, B, 4)."""
        return np.asarray(by_moments * w[_NEXT] * w[_LAST])

    B, N = t.shape
    beside = _DIFFERENCE * np.concatenate([np.zeros((1, 3)), np.eye(3)])
    w = np.moveaxis((spin[:, None] + beside) @ axes, -1, 0)
    # kinetic energy is constant, so that the spin grows at most by the root of the ratio of the largest moments
    fastest = np.linalg.norm(spin, axis=1) * np.sqrt(moments.max() / moments.min())
    h = np.diff(t, axis=1)
    counts = np.maximum(1, np.ceil((fastest[:, None] * h).max(axis=0) / SUBSTEP).astype(int))
    steps, ends = np.repeat(h / counts, counts, axis=1), np.cumsum(counts)
    angles, a = np.empty((3, B, 4, steps.shape[1])), rate(w)
    for k in range(steps.shape[1]):  # Runge-Kutta for ω and Magnus for the attitude, both of fourth order
        d = steps[:, k, None]
        b = rate(w + 0.5 * d * a)
        c = rate(w + 0.5 * d * b)
        after = w + d / 6 * (a + 2 * (b + c) + rate(w + d * c))
        rate_after, commutator = rate(after), w[_NEXT] * after[_LAST] - w[_LAST] * after[_NEXT]
        angles[..., k] = d / 2 * (w + after) + d**2 / 12 * (a - rate_after + commutator)
        w, a = after, rate_after
    turned = quat_exp(np.moveaxis(angles, 0, -1) @ axes.T)
    reach = 1
    while reach < turned.shape[2]:  # products of the first 2, 4, 8, ... turns
        turned[:, :, reach:] = quat_mul(turned[:, :, :-reach], turned[:, :, reach:])
        reach *= 2
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (B, 4, N, 1))
    turns[:, :, 1:] = turned[:, :, ends - 1]
    by_spin = quat_boxminus(turns[:, 1:], turns[:, :1]) / _DIFFERENCE
    return turns[:, 0], np.moveaxis(by_spin, 1, -1)
