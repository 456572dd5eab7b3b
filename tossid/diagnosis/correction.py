"""Recorded tosses without errors of the recording that are not the same in all of them.

An effect of the measurement is a map from true to recorded motion and leaves the simulator as it is. So tosses can be
taken back through it one by one, and the corrected ones are diagnosed as a recording without it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tossid.physics.effects import World
from tossid.rotations import quat_conj, quat_mul, quat_to_matrix
from tossid.types import Toss

Array = NDArray[np.float64]

CORRECTABLE = ("world_tilt", "ground_height", "length_scale", "body_frame_offset", "joint_offset")
"""Effects that do no more than map true motion to recorded motion. The ground's height is one: to raise the ground is
to lower what is recorded over it. A clock's rate is none: corrected tosses would have frames of different lengths, and
windows have one."""


def corrected(toss: Toss, wrong: World, right: World) -> Toss:
    """A toss as it would have been recorded without errors.

    Args:
        toss: As recorded.
        wrong: The simulator with effects of `CORRECTABLE`.
        right: Without them; its own recording errors stay.
    """

    def back(q: Array, v: Array) -> tuple[Array, Array]:
        return right.recorded(*wrong.to_ground(q, v))

    q, v = back(toss.q, toss.v)
    turn = quat_to_matrix(quat_mul(q[:1, 3:7], quat_conj(toss.q[:1, 3:7])))[0]
    scale = right.recording.length_scale / wrong.recording.length_scale
    measured, measured_cov = toss.q_measured, toss.q_measured_cov
    return replace(
        toss,
        q=q,
        v=v,
        q_cov=_carried(toss.q_cov, turn, scale),
        v_cov=_carried(toss.v_cov, turn, scale),
        q_measured=None if measured is None else back(measured, np.zeros((len(measured), toss.v.shape[1])))[0],
        q_measured_cov=None if measured_cov is None else _carried(measured_cov, turn, scale),
    )


def _carried(cov: Array, turn: Array, scale: float) -> Array:
    """Covariances (T, nv, nv) of motion that is turned and scaled; only positions are of the world."""
    carry = np.eye(cov.shape[-1])
    carry[:3, :3] = scale * turn
    return np.asarray(carry @ cov @ carry.T)
