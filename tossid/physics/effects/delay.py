"""Recordings whose rotations are late: a pose has the position of its time and the rotation of an earlier one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import quat_exp, quat_mul

Array = NDArray[np.float64]
Steps = int | NDArray[np.int64]
Onward = Callable[[Array, Array, Steps, float], tuple[Array, Array]]
"""(q0 (B, nq), v0 (B, nv), frames, dt [s]) -> q (B, frames + 1, nq) and v (B, frames + 1, nv), first states too."""
LEAST_SHARE = 1e-6
"""Share of a frame below which nothing moves."""


def turned_back(q: Array, v: Array, delay: float) -> Array:
    """Configurations (*b, nq) with the rotations of a time before [s], at the present spin of velocities v (*b, nv)."""
    out = q.copy()
    out[..., 3:7] = quat_mul(q[..., 3:7], quat_exp(-delay * v[..., 3:6]))
    return out


def with_late_rotations(q: Array, v: Array, *, delay: float, dt: float, n_steps: Steps, onward: Onward) -> Array:
    """Motions (B, T + 1, nq) with the rotations of a time before.

    The simulator is run once more, between the frames. Before the first frame, spin is that of the first frame.

    Args:
        q: (B, T + 1, nq) the motions.
        v: (B, T + 1, nv) their velocities.
        delay: That time [s], not 0; negative for a time after.
        dt: Between frames, in true time [s].
        n_steps: Frames after the first, one number or one a motion (B,); T is the most of them.
        onward: The simulator.
    """
    ahead = int(np.floor(-delay / dt))
    part = -delay - ahead * dt
    # (motions that diverge stay NaN by their positions)
    q0, v0 = np.nan_to_num(q[:, 0]), np.nan_to_num(v[:, 0])
    if part > LEAST_SHARE * dt:
        q0, v0 = (np.nan_to_num(each[:, 1]) for each in onward(q0, v0, 1, part))
    later, _ = onward(q0, v0, n_steps + max(ahead, 0), dt)
    out = q.copy()
    for frame in range(q.shape[1]):
        at = frame + ahead
        found = later[:, at] if at >= 0 else turned_back(q[:, 0], v[:, 0], delay - frame * dt)
        out[:, frame, 3:7] = found[:, 3:7]
    return out
