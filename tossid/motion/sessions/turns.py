"""Recordings that were turned about the vertical after they were tracked, turned back.

Publishers enlarge a dataset by turning recordings about the vertical, each by an angle of its own. What is constant in
the tracker's world, such as a tilt, then turns with the tosses: it looks like a law between place, velocity and
acceleration that is the same in all horizontal directions. If one side is thrown from, the direction of the throw shows
by how much a toss was turned, up to an angle that all share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.motion.contact import lowest_corner
from tossid.motion.flight import first_parabola
from tossid.motion.sessions.levelling import KEPT, turned_track
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, quat_mul
from tossid.types import OnDemand, PoseTrack, RecordingOrder

Array = NDArray[np.float64]

CLEAR_HEIGHT = 0.01
"""Height of the lowest corner above its lowest down to which a toss is taken to fly before its first contact [m]."""
FEWEST_FLIGHT, LEAST_SPEED = 4, 0.2
"""Frames of that flight, and horizontal speed [m/s], from which on it shows the direction of the throw."""


class Turns(NamedTuple):
    """The turns that take all throws to the x axis.

    Attributes:
        back: The turn of each toss by its name, quaternion wxyz (4,).
        unknown: Tosses that show no direction; they are turned as the toss before them.
    """

    back: dict[str, Array]
    unknown: tuple[str, ...]

    def undone(self, tracks: Sequence[PoseTrack]) -> Sequence[PoseTrack]:
        """The tracks, each turned back so that all throws go along x.

        Args:
            tracks: As recorded.
        """
        return OnDemand(lambda i: turned_track(tracks[i], self.back[tracks[i].name], 0.0), len(tracks), kept=KEPT)

    def with_order(self, found: RecordingOrder) -> RecordingOrder:
        """What was found of the tracks of `undone`, with turns from the recorded ones.

        Args:
            found: Of the tracks that were turned back.
        """
        return replace(found, turn=quat_mul(found.turn, np.array([self.back[name] for name in found.names])))


def find_turns(tracks: Sequence[PoseTrack], model: ObjectModel) -> Turns:
    """The turns that take the direction of each throw to the x axis.

    Args:
        tracks: As recorded, z roughly up, in the order of recording.
        model: The object.
    """
    back, unknown, yaw = dict[str, Array](), list[str](), 0.0
    for track in tracks:
        throw = throw_direction(track, model)
        if throw is None:
            unknown.append(track.name)
        else:
            yaw = throw
        back[track.name] = quat_exp(np.array([0.0, 0.0, -yaw]))
    return Turns(back, tuple(unknown))


def throw_direction(track: PoseTrack, model: ObjectModel) -> float | None:
    """The direction in which an object flies before its first contact, from the x axis [rad].

    Args:
        track: A toss as recorded.
        model: The object.

    Returns:
        The angle; None where the flight is too short or too slow to show it.
    """
    low = lowest_corner(model, track.q)
    flight = first_parabola(track.t, track.q[:, :3], low - low.min() > CLEAR_HEIGHT, FEWEST_FLIGHT)
    vx, vy = (0.0, 0.0) if flight is None else flight.coefficients[1, :2]
    return float(np.arctan2(vy, vx)) if np.hypot(vx, vy) > LEAST_SPEED else None
