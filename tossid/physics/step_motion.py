"""Velocities and poses in a step: of the common centre of mass and of the base's origin, and along them.

Numbers of equations are those of docs/method/scheme.md.
"""

from __future__ import annotations

import math

from tossid.kernels import inlined_kernel
from tossid.physics.moving import accelerate, act_on_free, common_velocity, kinematics, n_rates
from tossid.physics.network import add_learned

RUNAWAY = 1e9
"""Sum of a state's numbers above which the toss has left all bounds."""


@inlined_kernel
def turned(a, b, d, e, x, y, z):  # type: ignore[no-untyped-def]
    """Quaternion (a, b, d, e) times exp(x, y, z), half a rotation vector: by series for the small angles of a step."""
    angle = x * x + y * y + z * z
    if angle < 0.04:
        s = 1.0 - angle / 6.0 * (1.0 - angle / 20.0 * (1.0 - angle / 42.0 * (1.0 - angle / 72.0)))
        co = 1.0 - angle / 2.0 * (
            1.0 - angle / 12.0 * (1.0 - angle / 30.0 * (1.0 - angle / 56.0 * (1.0 - angle / 90.0)))
        )
    else:
        angle = math.sqrt(angle)
        s, co = math.sin(angle) / angle, math.cos(angle)
    x, y, z = s * x, s * y, s * z
    w0, w1 = a * co - b * x - d * y - e * z, a * x + b * co + d * z - e * y
    w2, w3 = a * y - b * z + d * co + e * x, a * z + b * y - d * x + e * co
    s = 1.0 / math.sqrt(w0 * w0 + w1 * w1 + w2 * w2 + w3 * w3)
    return s * w0, s * w1, s * w2, s * w3


@inlined_kernel
def rotation(q, R):  # type: ignore[no-untyped-def]
    """R (3, 3) of the quaternion q[3:7]."""
    a, b, d, e = q[3], q[4], q[5], q[6]
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - 2.0 * (d * d + e * e), 2.0 * (b * d - a * e), 2.0 * (b * e + a * d)
    R[1, 0], R[1, 1], R[1, 2] = 2.0 * (b * d + a * e), 1.0 - 2.0 * (b * b + e * e), 2.0 * (d * e - a * b)
    R[2, 0], R[2, 1], R[2, 2] = 2.0 * (b * e - a * d), 2.0 * (d * e + a * b), 1.0 - 2.0 * (b * b + d * d)


@inlined_kernel
def find_accelerations(model, k_res, work, s, h):  # type: ignore[no-untyped-def]
    """s.R, the bodies' poses, s.a, s.rate and s.u_start at s.q and s.v, for a step of length h. Whether M is positive.

    The spin and the joint rates s.xi_start are those of s.v.
    """
    for x in range(n_rates(model)):
        s.xi_start[x] = s.v[3 + x]
    rotation(s.q, s.R)
    kinematics(model, work, s)
    positive = accelerate(model, work, s, h)
    if k_res.linear.shape[1] > 0:
        add_learned(k_res, s, n_rates(model))
    start_velocity(model, work, s)
    return positive


@inlined_kernel
def start_velocity(model, work, s):  # type: ignore[no-untyped-def]
    """s.u_start of s.v and s.xi_start: the common centre of mass moves with the origin and what the rates add."""
    R = s.R
    c0, c1, c2 = common_velocity(model, work, s.xi_start, 0)
    for k in range(3):
        i = k - 1 if k else 2
        s.u_start[k] = s.v[i] + (R[i, 0] * c0 + R[i, 1] * c1 + R[i, 2] * c2)


@inlined_kernel
def free_velocity(model, work, s, h):  # type: ignore[no-untyped-def]
    """v_free = v + h (g - R a) and xi_free = xi + h d xi / dt into s.v_next, s.xi, and s.u of the centre of mass."""
    R, nx = s.R, n_rates(model)
    for i in range(3):
        pulled = R[i, 0] * s.a[0] + R[i, 1] * s.a[1] + R[i, 2] * s.a[2]
        s.v_next[i] = s.v[i] + h * (model.gravity[i] - pulled)
    for x in range(nx):
        s.v_next[3 + x] = s.xi_start[x] + h * s.rate[x]
        s.xi[x] = s.v_next[3 + x]
    if model.acts:
        act_on_free(model, work, s, h)
    c0, c1, c2 = common_velocity(model, work, s.v_next, 3)
    for k in range(3):
        i = k - 1 if k else 2
        s.u[k] = s.v_next[i] + R[i, 0] * c0 + R[i, 1] * c1 + R[i, 2] * c2


@inlined_kernel
def origin_velocity(model, work, s):  # type: ignore[no-untyped-def]
    """s.v_next of s.u and s.xi: the base's origin moves with u less what the rates add at the common centre of mass."""
    R = s.R
    c0, c1, c2 = common_velocity(model, work, s.xi, 0)
    for k in range(3):
        i = k - 1 if k else 2
        s.v_next[i] = s.u[k] - (R[i, 0] * c0 + R[i, 1] * c1 + R[i, 2] * c2)
    for x in range(n_rates(model)):
        s.v_next[3 + x] = s.xi[x]


@inlined_kernel
def between(old, new, mean):  # type: ignore[no-untyped-def]
    """The mean of two numbers if `mean`, else the new one."""
    return 0.5 * (old + new) if mean else new


@inlined_kernel
def drift(q, old, new, mean, h, nx, out):  # type: ignore[no-untyped-def]
    """out = q moved along the velocity `new` or, if `mean`, (old + new) / 2, for a time h; out may be q."""
    for i in range(3):
        out[i] = q[i] + h * between(old[i], new[i], mean)
    x, y, z = between(old[3], new[3], mean), between(old[4], new[4], mean), between(old[5], new[5], mean)
    out[3], out[4], out[5], out[6] = turned(q[3], q[4], q[5], q[6], 0.5 * h * x, 0.5 * h * y, 0.5 * h * z)
    for j in range(nx - 3):
        out[7 + j] = q[7 + j] + h * between(old[6 + j], new[6 + j], mean)


@inlined_kernel
def move(model, s, h, mean):  # type: ignore[no-untyped-def]
    """s.q_next: s.q moved along v' or, if `mean`, along (v + v') / 2, for a time h. Whether the state is in bounds."""
    drift(s.q, s.v, s.v_next, mean, h, n_rates(model), s.q_next)
    size = 0.0
    for i in range(4 + n_rates(model)):
        size += abs(s.q_next[i])
    for i in range(3 + n_rates(model)):
        size += abs(s.v_next[i])
    return size < RUNAWAY
