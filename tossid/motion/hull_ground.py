"""The ground under an object of unknown shape: found with its hull, and made z = 0."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.motion.links import body_tracks
from tossid.motion.sessions.levelling import turned_track
from tossid.objects import ObjectModel, unstated_object
from tossid.objects.convex_shape import ground_of_polytope, height_is_wrong
from tossid.rotations import quat_conj, quat_exp, quat_mul, quat_rotate
from tossid.types import PoseTrack

Array = NDArray[np.float64]

SLACKS = (0.08, 0.02)
"""Slopes that the ground may have at first: with the level ground, the half-spaces of a tilted world hold no shape."""
TIMES = 6
"""A tilt is found to first order, so that it is found again in the levelled world, at most so many times."""
LEVEL_HEIGHT, LEVEL_SLOPE = 4e-3, 5e-3
"""Height [m] and slope of the ground from which on the world is levelled; less height is also what rounded edges look
like."""
RAISED = 0.03
"""How far tracks are raised that lie deeper below z = 0 than their object is thick [m]; the hull then shows the
ground."""


def level_by_hull(
    tracks: Sequence[PoseTrack], *, tree: ObjectModel | None = None
) -> tuple[Sequence[PoseTrack], Array | None]:
    """Tracks in a world whose ground is z = 0, where the tracks show that it was not.

    Args:
        tracks: Of one rigid body or of two links on a hinge, z roughly up.
        tree: The links and their hinge; None for one rigid body.

    Returns:
        The tracks as they are and None, where they show no shape or the ground is z = 0. Else the levelled tracks, and
        the ground's height at the origin [m] and its slopes along x and y, (3,).
    """
    tree = tree or unstated_object()
    now, turned, lift = tracks, np.array([1.0, 0.0, 0.0, 0.0]), 0.0
    for slack in (*SLACKS, *(0.0,) * TIMES):
        try:
            # one ground under both links
            ground = np.mean([ground_of_polytope(own, slack=slack) for own in body_tracks(tree, now)], axis=0)
        except InputError:  # no shape over a ground so far above the object
            ground = np.array([0.0 if slack else -RAISED, 0.0, 0.0])
        slope = ground[1:] if np.linalg.norm(ground[1:]) > LEVEL_SLOPE else np.zeros(2)
        high = float(ground[0]) if abs(ground[0]) > LEVEL_HEIGHT and not slack else 0.0
        if high and ground[0] != -RAISED and not slope.any():
            wrong = all(height_is_wrong(own) for own in body_tracks(tree, now))
            high = high if wrong else 0.0
        if not high and not slope.any():
            if slack:
                continue
            break
        up = np.array([-slope[0], -slope[1], 1.0]) / np.sqrt(1 + slope @ slope)
        turn = quat_exp(np.cross(up, [0.0, 0.0, 1.0]))
        now = [turned_track(track, turn, -high) for track in now]
        turned, lift = quat_mul(turn, turned), lift - high
    if now is tracks or ground[0] == -RAISED:
        return tracks, None
    normal = quat_rotate(quat_conj(turned), np.array([0.0, 0.0, 1.0]))
    return now, np.array([-lift, -normal[0] / normal[2], -normal[1] / normal[2]])
