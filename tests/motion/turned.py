"""Tosses from one side in a tilted world, whose recordings were turned about the vertical after they were tracked."""

from __future__ import annotations

import numpy as np

from tests.motion.bouncing import bounce, tracked
from tossid.motion.sessions.levelling import turned_track
from tossid.motion.sessions.turns import throw_direction
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp
from tossid.types import PoseTrack

TILT = np.deg2rad([0.3, -0.8])
"""Of the table's normal in the tracker's world, along the throw and to its left."""
TILTED = quat_exp(np.array([-TILT[1], TILT[0], 0.0]))
IN_A_ROW = 3


def yawed(track: PoseTrack, angle: float) -> PoseTrack:
    """In a world turned about the vertical."""
    return turned_track(track, quat_exp(np.array([0.0, 0.0, angle])), 0.0)


def thrown_along_x(cube: ObjectModel, tosses: int) -> list[PoseTrack]:
    """Tosses onto level ground until they rest, all thrown along x to within a few degrees."""
    rng = np.random.default_rng(12)
    made = [
        tracked(truth, rng, name=str(i))
        for i, truth in enumerate(bounce(cube, rng, tosses=tosses, frames=220, gravity=9.81))
    ]
    directions = [throw_direction(track, cube) for track in made]
    return [
        yawed(track, np.deg2rad(rng.normal(0, 3)) - angle)
        for track, angle in zip(made, directions, strict=True)
        if angle is not None
    ]


def turns_of(tosses: int) -> np.ndarray:
    """By how much the recording of each toss is turned; neighbours differ."""
    turned = np.cumsum(np.random.default_rng(3).uniform(0.6, 2 * np.pi - 0.6, -(-tosses // IN_A_ROW)))
    return np.repeat(turned, IN_A_ROW)[:tosses]


def as_published(thrown: list[PoseTrack]) -> list[PoseTrack]:
    """Tracked in a tilted world, and then turned."""
    return [
        yawed(turned_track(track, TILTED, 0.0), yaw) for track, yaw in zip(thrown, turns_of(len(thrown)), strict=True)
    ]
