"""Errors of predicted motions, frame by frame (Numba)."""

from __future__ import annotations

import math

from tossid.kernels import kernel

SMALL = 1e-8
"""Sine of half an angle below which a rotation vector is twice the quaternion's vector."""


@kernel(allocates=False)
def fill_errors(q, target, n_steps, length, error):  # type: ignore[no-untyped-def]
    """Predicted minus measured of frames 1 to n_steps of each motion, and zero after them.

    Args:
        q: (S, T + 1, nq) predicted configurations, T at least the largest of n_steps.
        target: (S, L, nq) measured ones at frames 1 to L.
        n_steps: (S,) frames to compare.
        length: Unit of the position's error [m].
        error: (S, L, nq - 1), filled: position, rotation vector in the measured body frame [rad], joints.
    """
    joints = q.shape[2] - 7
    for s in range(error.shape[0]):
        for frame in range(error.shape[1]):
            if frame >= n_steps[s]:
                for k in range(error.shape[2]):
                    error[s, frame, k] = 0.0
                continue
            for k in range(3):
                error[s, frame, k] = (q[s, frame + 1, k] - target[s, frame, k]) / length
            aw, ax, ay, az = q[s, frame + 1, 3], q[s, frame + 1, 4], q[s, frame + 1, 5], q[s, frame + 1, 6]
            bw, bx, by, bz = target[s, frame, 3], target[s, frame, 4], target[s, frame, 5], target[s, frame, 6]
            w = bw * aw + (bx * ax + by * ay + bz * az)  # the measured one's conjugate times the predicted one
            x = bw * ax - aw * bx - (by * az - bz * ay)
            y = bw * ay - aw * by - (bz * ax - bx * az)
            z = bw * az - aw * bz - (bx * ay - by * ax)
            sine = math.sqrt(x * x + y * y + z * z)
            scale = 2.0 * math.atan2(sine, abs(w)) / sine if sine > SMALL else 2.0
            if w < 0.0:
                scale = -scale
            error[s, frame, 3], error[s, frame, 4], error[s, frame, 5] = scale * x, scale * y, scale * z
            for j in range(joints):
                error[s, frame, 6 + j] = q[s, frame + 1, 7 + j] - target[s, frame, 7 + j]
