"""Recorded tosses without errors of the recording that are not the same in all of them.

An effect of the measurement is a map from true to recorded motion and leaves the simulator as it is. So tosses can be
taken back through it one by one, and the corrected ones are diagnosed as a recording without it.

Some publishers shift each toss so that the lowest corner of its last frame is at z = 0. In a tilted world, the ground's
height differs from place to place, and the shifts have taken that out. A tilt then turns each toss about that corner:
turned about the origin, tosses that end elsewhere would come to rest above or below the ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tossid.motion.sessions.levelling import as_recorded
from tossid.motion.sessions.search import heights_were_shifted
from tossid.objects import ObjectModel, corner_heights, corner_positions
from tossid.physics.effects import World
from tossid.rotations import quat_conj, quat_mul, quat_to_matrix
from tossid.types import RecordingOrder, Toss

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


def corrected_tosses(
    tosses: Sequence[Toss], wrong: Sequence[World], right: World, *, own_heights: bool = False
) -> tuple[Toss, ...]:
    """Tosses without the errors of their recording.

    Args:
        tosses: n, as recorded.
        wrong: The simulator with the errors of each.
        right: The simulator without.
        own_heights: Whether their heights were set one by one, so that each is turned about its last lowest corner.
    """
    ends = [last_corner(toss, right.object) if own_heights else np.zeros(2) for toss in tosses]
    there = (moved(toss, -end) for toss, end in zip(tosses, ends, strict=True))
    back = (corrected(toss, own, right) for toss, own in zip(there, wrong, strict=True))
    return tuple(moved(toss, end) for toss, end in zip(back, ends, strict=True))


def have_own_heights(tosses: Sequence[Toss], model: ObjectModel, order: RecordingOrder | None) -> bool:
    """Whether tosses were recorded or published with heights that were set one by one.

    Args:
        tosses: Of one dataset.
        model: The object.
        order: The dataset's order of recording, which knows what was undone; None where it was not looked at.
    """
    last = [as_recorded(toss, order).measured[0][-2:] for toss in tosses]
    return heights_were_shifted(np.array([corner_heights(model, q).min(axis=1) for q in last]))


def moved(toss: Toss, by: Array) -> Toss:
    """A toss at another place.

    Args:
        toss: The toss.
        by: x and y (2,) that are added to its positions [m].
    """
    step = np.zeros(toss.q.shape[1])
    step[:2] = by
    return replace(toss, q=toss.q + step, q_measured=None if toss.q_measured is None else toss.q_measured + step)


def last_corner(toss: Toss, model: ObjectModel) -> Array:
    """x and y (2,) of the lowest corner in a toss's last frame [m].

    Args:
        toss: The toss.
        model: The object.
    """
    corners = corner_positions(model, toss.measured[0][-1:])[0]
    lowest: Array = corners[np.argmin(corners[:, 2]), :2]
    return lowest


def ending_at_origin(tosses: Sequence[Toss], model: ObjectModel) -> tuple[Toss, ...]:
    """Tosses that are moved along the ground, each so that its last frame's lowest corner is at x = y = 0.

    Args:
        tosses: The tosses.
        model: The object.
    """
    return tuple(moved(toss, -last_corner(toss, model)) for toss in tosses)
