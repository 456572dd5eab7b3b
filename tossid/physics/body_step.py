"""What a step of a single body is made of, in scalars: where it ends, its contact problem's matrix, and its turn."""

from __future__ import annotations

import math

from tossid.kernels import kernel
from tossid.physics.contact import IMPACT_SPEED, MOST_STRIKES, TANGENTIAL, TOUCHING


@kernel
def first_impact(  # type: ignore[no-untyped-def]
    corner, arm, r20, r21, r22, p2, v_2, w0, w1, w2, weight, sunk, rigid, strikes, impact_parts, rest, h,
):  # fmt: skip
    """What becomes of a step that is to begin: (parts, strike, length of each part [s]), as in `impacts.first_impact`.

    corner, arm (3, n_c), (n_c, 3): corners from the origin, and from the centre of mass. r2: the rotation's last row.
    p2: the origin's height over where corners touch [m]; v_2, w: velocities. weight: gravity along z. rest: of the
    step [s].
    """
    length, parts, strike = h, 1, False
    if rigid:
        length = rest / max(1.0, math.ceil(rest / length - 1e-6))
    for c in range(sunk.shape[0]):
        d0, d1, d2 = corner[0, c], corner[1, c], corner[2, c]
        z = p2 + r20 * d0 + r21 * d1 + r22 * d2 - min(sunk[c], 0.0)
        vn = v_2 + r20 * (w1 * d2 - w2 * d1) + r21 * (w2 * d0 - w0 * d2) + r22 * (w0 * d1 - w1 * d0)
        if not rigid:
            if abs(vn) > IMPACT_SPEED and z + length * min(vn, 0.0) < 0.0:
                parts = impact_parts
            continue
        if z < TOUCHING:
            strike = strike or (vn < -IMPACT_SPEED and strikes < MOST_STRIKES)
            continue
        d0, d1, d2 = arm[c, 0], arm[c, 1], arm[c, 2]
        s0, s1 = w0 * d0 + w1 * d1 + w2 * d2, w0 * w0 + w1 * w1 + w2 * w2
        fall = weight + s0 * (r20 * w0 + r21 * w1 + r22 * w2) - s1 * (r20 * d0 + r21 * d1 + r22 * d2)
        speed = vn * vn - 4.0 * fall * z  # with the last velocity, as in its problem
        if speed > IMPACT_SPEED * IMPACT_SPEED and math.sqrt(speed) - vn > 0.0:
            length = min(length, 2.0 * z / (math.sqrt(speed) - vn))
    return parts, strike, length / parts


@kernel
def delassus(G, n, over_m, soft, A):  # type: ignore[no-untyped-def]
    """A (3n, 3n) of n corners from G (3n, 3), with what gives way on its diagonal."""
    for i in range(3 * n):
        m0, m1, m2 = G[i, 0], G[i, 1], G[i, 2]
        for j in range(i + 1):
            A[i, j] = m0 * G[j, 0] + m1 * G[j, 1] + m2 * G[j, 2]
        for j in range(i % 3, i + 1, 3):
            A[i, j] += over_m
        for j in range(i):
            A[j, i] = A[i, j]
    for i in range(0, 3 * n, 3):
        A[i, i] += soft
        A[i + 1, i + 1] += TANGENTIAL * soft
        A[i + 2, i + 2] += TANGENTIAL * soft


@kernel
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
