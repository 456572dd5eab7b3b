"""Settings of what is looked for in the order of a recording (`tossid.motion.sessions`)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tossid.settings.kinds import Count, Fraction, Positive


@dataclass(frozen=True, kw_only=True)
class WitnessSettings:
    """What of a toss is measured, and from which frames."""

    clear_height: Positive = 0.03
    """height of the lowest stated corner above which nothing touches [m]"""
    fewest_flight: Count = 10
    """frames of flight from the release on that a parabola is fitted to"""
    rest_frames: Count = 8
    """last frames of a toss in which the object has to lie still"""
    rest_distance: Positive = 0.001
    """within this [m]"""
    rest_angle: Positive = 0.02
    """and this [rad]; joints too"""
    flat: Positive = math.radians(8.0)
    """a face that points down within this angle is one that a link rests on [rad]"""
    face_error: Positive = 0.01
    """standard deviation of a resting face's normal, which its own errors set and not the noise [rad]"""
    contact_height: Positive = 0.02
    """a corner that turns back less than this above the toss's lowest one has touched the ground [m]"""
    contact_error: Positive = 0.002
    """standard deviation of a contact point's height: corners turn back between frames [m]"""
    same_point: Positive = 0.01
    """contact points nearer than this are one [m]"""


@dataclass(frozen=True, kw_only=True)
class SessionSettings:
    """When a change over the order of recording is one, and when a session's world is levelled."""

    significance: Fraction = 0.005
    """probability of finding any change in tosses whose order means nothing"""
    permutations: Count = 3999
    """orders of the tosses that are drawn to test a change"""
    first_permutations: Count = 199
    """of these first; the others only where a change may be significant"""
    fewest_tosses: Count = 5
    """tosses that a session has at least"""
    outlier: Positive = 3.0
    """standard deviations beyond which a toss counts no more than one at this distance"""
    level_sigmas: Positive = 4.0
    """a session's world is levelled where its tilt exceeds so many standard errors"""
    smallest_level: Positive = math.radians(0.2)
    """and where it exceeds this [rad]"""
    shifted_share: Fraction = 0.95
    """share of tosses that end with their lowest corner at exactly 0 from which on heights were shifted by that"""
    exactly: Positive = 1e-9
    """what is exact [m]; noise is at least a thousand times as much"""
    rest_error: Positive = 0.001
    """standard deviation of the height that a resting face gives [m]; a contact point's is `WitnessSettings`'s"""
    above_lowest: Positive = 0.004
    """greatest height above a toss's lowest corner at which a resting face or a contact point shows the ground [m]"""
    seed: Count = 1
    """of the orders that are drawn"""


@dataclass(frozen=True, kw_only=True)
class SmoothingSettings:
    """When poses are taken for what a smoother made (`tossid.motion.sessions.smoothing`)."""

    fall_time: Positive = 0.1
    """shortest stretch over which a toss's acceleration is looked at [s]"""
    fewest_frames: Count = 4
    """frames that such a stretch has at least"""
    fall_error: Positive = 0.1
    """largest distance of a toss's acceleration from gravity where it is nearest to it, in gravities; the published
    recordings have 0.01 to 0.08 in the median"""
    fewest_falls: Count = 2
    """tosses that must come down far enough for it to be judged"""
    roughness: Positive = 1.0
    """size of fourth over third differences below which noise is no tracker's; white noise has 1.87"""
    fewest_differences: Count = 30
    """numbers from which it is estimated"""
    moving_speed: Positive = 0.1
    """speed above which a frame counts for it [m/s]; filters rest where the object does"""
    uneven: Positive = 0.02
    """largest difference of a frame's time step from the median, relative; others do not count for it"""


@dataclass(frozen=True, kw_only=True)
class TurnSettings:
    """When recordings are taken to have been turned about the vertical (`tossid.motion.sessions.turns`)."""

    clear_height: Positive = 0.01
    """height of the lowest corner above its lowest up to which a toss is taken to fly before its first contact [m]"""
    fewest_flight: Count = 4
    """frames of that flight from which on it shows the direction of the throw"""
    least_speed: Positive = 0.2
    """horizontal speed from which on it does [m/s]"""
    same_throw: Positive = math.radians(15.0)
    """a toss belongs to the recording of the one before if their directions differ by less [rad]"""
    fewest_recordings: Count = 12
    """recordings from which on turns can be seen"""
    significance: Fraction = 0.001
    """probability of taking recordings for turned that were not"""
    least_lean: Positive = math.radians(0.1)
    """least lean that turns with throws and matters [rad]"""
    worst_condition: Positive = 1e3
    """condition number from which on throws have too much one direction"""
    outlier: Positive = 2.5
    """standard deviations beyond which a toss counts no more than one at this distance"""
    iterations: Count = 12
    """steps of the robust fit"""


@dataclass(frozen=True, kw_only=True)
class CopySettings:
    """When tosses are taken to be copies of others (`tossid.motion.sessions.copies`)."""

    same_place: Positive = 1e-6
    """greatest distance of a copy's positions [m]; noise is at least ten times as much"""
    same_angle: Positive = 1e-5
    """greatest difference of its attitudes, and of its joints [rad, m]"""


@dataclass(frozen=True, kw_only=True)
class LostSettings:
    """When frames are taken to have been lost at impacts (`tossid.motion.sessions.lost_frames`)."""

    clear_height: Positive = 0.04
    """height of the lowest stated corner above which nothing touches, in widths of the object"""
    jump: Positive = 0.03
    """change of velocity times a frame's time beyond which something has touched nevertheless, in widths"""
    fewest_flight: Count = 5
    """frames of flight from which on an impact at its end is looked at"""
    fewest_beside: Count = 3
    """frames of flight either side of an uneven step in flight from which on it is looked at"""
    most_flight: Count = 13
    """frames of flight next to an impact that are fitted at most"""
    longest_contact: Positive = 0.05
    """longest time between two flights that belong to one impact [s]"""
    most_lost: Count = 3
    """frames that an impact is taken to have lost at most"""
    flight_tolerance: Positive = 0.0075
    """root mean square distance of frames of a flight from it, in widths of the object"""
    tolerance: Positive = 0.015
    """distance at which two flights meet, in widths of the object"""
    apart: Positive = 4.0
    """an impact is judged where any other number of frames leaves a distance so many times as large"""
    least_share: Fraction = 0.1
    """share of impacts that lost frames among those that are judged from which on a recording did"""
    significance: Fraction = 0.005
    """probability of such impacts by chance, which joins with frames too many as often"""
