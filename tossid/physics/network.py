"""The learned acceleration of a system: its numbers, its features, its values for batches and in the time step.

In the kernels matrices stand transposed, so that a loop over outputs reads neighbours and is compiled to vector
instructions. The hyperbolic tangent is written out for the same reason: `math.tanh` is a call for each number.
"""

from __future__ import annotations

import math
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import fused_inlined_kernel, fused_lean_kernel, inlined_kernel

Array = NDArray[np.float64]

FLAT = 20.0
"""Beyond it tanh is 1 in double precision."""
LOG2_E = 1.4426950408889634
LOG_2_HIGH, LOG_2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""Natural logarithm of 2 in two parts; the first has 32 bits: its product with a small whole number is exact."""
WHOLE = 6755399441055744.0
"""1.5 * 2^52: what is added to it is rounded to a whole number, which its last bits then hold."""


class LearnedAcceleration(NamedTuple):
    """A learned acceleration a_res(q, v) = W f + W2 tanh(W1 tanh(W0 f + b0) + b1).

    f are the first features of `features`. Those of the body are in the base's
    frame, where the world's symmetries (translation, turning about the vertical) are
    exact; the first nv outputs are an acceleration in the same frame. Velocity enters
    f as |v| R^T v, so that a linear drag matrix is quadratic drag. With the features of
    the world, too, there may be three more outputs: an acceleration of the base's origin
    along the world's axes. The force is k_res = M a_res. Empty arrays (zero rows of
    `linear`) mean none.

    Attributes:
        linear: (n_out, n_f) W; n_out is nv or nv + 3.
        W0: (h, n_f).
        b0: (h,).
        W1: (h, h).
        b1: (h,).
        W2: (n_out, h).
    """

    linear: Array
    W0: Array
    b0: Array
    W1: Array
    b1: Array
    W2: Array


N_WORLD = 13
"""Features of the world: the world's x (3) and y (3) in the base's axes, one (1), position (3), velocity (3)."""


def n_features(n_joints: int, *, world: bool = False) -> int:
    """Number of the learned acceleration's features.

    Those of the body: vertical (3), |v| v (3), spin (3); sin, cos, rate of each joint. Those of the world follow.

    Args:
        n_joints: of the object.
        world: with those of the world.
    """
    return 9 + 3 * n_joints + (N_WORLD if world else 0)


def no_learned_acceleration(n_joints: int) -> LearnedAcceleration:
    """A learned acceleration that is absent.

    Args:
        n_joints: of the object.
    """
    nv, nf = 6 + n_joints, n_features(n_joints)
    return LearnedAcceleration(
        np.zeros((0, nf)), np.zeros((0, nf)), np.zeros(0), np.zeros((0, 0)), np.zeros(0), np.zeros((nv, 0))
    )


class Network(LearnedAcceleration):
    """A `LearnedAcceleration` with its matrices transposed, as the kernels read it: W (n_f, n_out), W0 (n_f, h) etc."""


def make_network(k_res: LearnedAcceleration) -> Network:
    """The learned acceleration as kernels read it.

    Args:
        k_res: of the system.
    """
    return Network(*(np.array(part.T, order="C") for part in k_res))


def features(q: Array, v: Array, R: Array) -> Array:
    """What the base sees, in its own frame (N, n_f), with the features of the world.

    (vertical R^T e_z, |v| R^T v [m²/s²], spin [rad/s] / 10, then sin, cos and rate / 10 of each joint). Velocity
    enters as its square: drag at a toss's speeds grows so, and what flight taught must not push what slides slowly.

    Then what the base sees of the world: its x and y axes (R^T e_x, R^T e_y), 1, position [m] and velocity [m/s] along
    the world's axes.

    Args:
        q: (N, nq) configurations.
        v: (N, nv) velocities.
        R: (N, 3, 3) rotations of the base.
    """
    speed = np.linalg.norm(v[:, :3], axis=1, keepdims=True)
    joints = np.stack([np.sin(q[:, 7:]), np.cos(q[:, 7:]), 0.1 * v[:, 6:]], axis=-1)
    joints = joints.reshape(len(q), 3 * (q.shape[1] - 7))
    body = [R[:, 2], speed * np.einsum("nij,ni->nj", R, v[:, :3]), 0.1 * v[:, 3:6], joints]
    return np.concatenate([*body, R[:, 0], R[:, 1], np.ones((len(q), 1)), q[:, :3], v[:, :3]], axis=1)


def learned_accelerations(k_res: Any, seen: Any, nv: int, *, of: ModuleType = np) -> Any:
    """The learned acceleration in the base's axes (N, nv) [m/s², rad/s²]: of arrays, or of tensors with gradients.

    Args:
        k_res: The `LearnedAcceleration`.
        seen: (N, n_f or more) features, of `tree_batch`.
        nv: Length of a velocity.
        of: NumPy, or torch if both are tensors.
    """
    f = seen[:, : k_res.linear.shape[1]]
    hidden = of.tanh(of.tanh(f @ k_res.W0.T + k_res.b0) @ k_res.W1.T + k_res.b1)
    found = f @ k_res.linear.T + hidden @ k_res.W2.T
    if found.shape[1] == nv:
        return found
    first = n_features(nv - 6)  # the world's axes in the base's, by which an acceleration along them is turned
    axes = of.stack([seen[:, first : first + 3], seen[:, first + 3 : first + 6], seen[:, :3]], 1)
    field = (found[:, nv:, None] * axes).sum(1)
    return of.concatenate([found[:, :3] + field, found[:, 3:nv]], 1)


@fused_inlined_kernel
def tanh(x):  # type: ignore[no-untyped-def]
    """Hyperbolic tangent, (1 - e) / (1 + e) with e = exp(-2 |x|); its error is below 3e-16.

    e is 2^k exp(r) with |r| <= log(2) / 2, and exp(r) is its Taylor polynomial of degree 13.
    """
    z = -2.0 * min(abs(x), FLAT)
    y = z * LOG2_E + WHOLE
    k = y - WHOLE
    r = (z - k * LOG_2_HIGH) - k * LOG_2_LOW
    p = 1.0 / 6227020800.0
    p = p * r + 1.0 / 479001600.0
    p = p * r + 1.0 / 39916800.0
    p = p * r + 1.0 / 3628800.0
    p = p * r + 1.0 / 362880.0
    p = p * r + 1.0 / 40320.0
    p = p * r + 1.0 / 5040.0
    p = p * r + 1.0 / 720.0
    p = p * r + 1.0 / 120.0
    p = p * r + 1.0 / 24.0
    p = p * r + 1.0 / 6.0
    p = p * r + 0.5
    p = p * r + 1.0
    p = p * r + 1.0
    exponent = (np.float64(y).view(np.int64) + 1023) << 52  # the bits of 2^k
    e = p * np.int64(exponent).view(np.float64)
    return math.copysign((1.0 - e) / (1.0 + e), x)


@fused_inlined_kernel
def add_product(W, x, y):  # type: ignore[no-untyped-def]
    """y (m,) += x (n,) W (n, m), four rows at a time: a sum that waits for the one before costs most here."""
    n, m = W.shape
    j = 0
    while j + 4 <= n:
        a, b, c, d = x[j], x[j + 1], x[j + 2], x[j + 3]
        for i in range(m):
            y[i] += (W[j, i] * a + W[j + 1, i] * b) + (W[j + 2, i] * c + W[j + 3, i] * d)
        j += 4
    while j < n:
        a = x[j]
        for i in range(m):
            y[i] += W[j, i] * a
        j += 1


@fused_lean_kernel
def network(k_res, f, hidden, out):  # type: ignore[no-untyped-def]
    """out (n_out,) = W f + W2 tanh(W1 tanh(W0 f + b0) + b1) of a `Network`."""
    h, h0, h1 = k_res.b0.shape[0], hidden[0], hidden[1]
    for i in range(h):
        h0[i] = k_res.b0[i]
    add_product(k_res.W0, f, h0)
    for i in range(h):
        h0[i] = tanh(h0[i])
    for i in range(h):
        h1[i] = k_res.b1[i]
    add_product(k_res.W1, h0, h1)
    for i in range(h):
        h1[i] = tanh(h1[i])
    for i in range(k_res.linear.shape[1]):
        out[i] = 0.0
    add_product(k_res.linear, f, out)
    add_product(k_res.W2, h1, out)


@inlined_kernel
def add_learned(k_res, s, nx):  # type: ignore[no-untyped-def]
    """Add the learned acceleration (`features`) to s.a and s.rate; at once again where they are found anew."""
    R, q, v, f = s.R, s.q, s.v, s.feature
    speed = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    for i in range(3):
        f[i] = R[2, i]
        f[3 + i] = speed * (R[0, i] * v[0] + R[1, i] * v[1] + R[2, i] * v[2])
        f[6 + i] = 0.1 * v[3 + i]
    for j in range(nx - 3):
        f[9 + 3 * j], f[10 + 3 * j], f[11 + 3 * j] = math.sin(q[7 + j]), math.cos(q[7 + j]), 0.1 * v[6 + j]
    n = 3 * nx
    if k_res.linear.shape[0] > n:
        f[n + 6] = 1.0
        for i in range(3):
            f[n + i], f[n + 3 + i] = R[0, i], R[1, i]
            f[n + 7 + i], f[n + 10 + i] = q[i], v[i]
    network(k_res, f, s.hidden, s.learned)
    for i in range(3):
        s.a[i] -= s.learned[i]
    for x in range(nx):
        s.rate[x] += s.learned[3 + x]
    for k in range(k_res.linear.shape[1] - 3 - nx):  # along the world's axes
        for i in range(3):
            s.a[i] -= R[k, i] * s.learned[3 + nx + k]
