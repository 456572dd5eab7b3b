"""Settings of what turns a long track into tosses: where the ground is, and where tosses begin and end."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tossid.settings.kinds import Count, NonNegative, Positive, advanced


@dataclass(frozen=True, kw_only=True)
class SegmentSettings:
    """What counts as flight and as rest."""

    rest_distance: Positive = 0.0004
    """distance from its final place within which the object rests [m]; four times the track's noise if that is more"""
    rest_angle: Positive = 0.006
    """angle from its final orientation within which it rests [rad]; likewise"""
    min_rest: Positive = 0.08
    """shortest rest [s]"""
    min_flight: Positive = 0.04
    """shortest free flight [s]"""
    flight_acceleration: Positive = 3.5
    """deviation from gravity that is still free flight [m/s²]"""
    energy: Positive = 0.03
    """rise of energy over weight that only a hand can cause [m]"""
    ground: Positive = 0.025
    """height of the lowest corner at which a flight can have ended on the ground [m]"""
    max_gap: Positive = 0.05
    """longest gap in a toss [s]"""
    held_height: Positive = advanced(0.008)
    """an object that is higher than this over the ground [m] for longer than `held_time`, and does not fall, is held"""
    held_time: Positive = advanced(0.05)
    """see `held_height` [s]; a fit of the acceleration that spans an impact looks like being held for less"""
    merge_rests: Positive = advanced(1.0)
    """two rests that are nearer in time [s] may be one, between which the object only moved by itself"""
    tipping_rise: Positive = advanced(0.004)
    """between such rests the centre of mass rises by less than this [m]"""
    tipping_speed: Positive = advanced(0.15)
    """and is no faster than this, beside what a fall gives [m/s]"""
    noisy_acceleration: Positive = advanced(5.0)
    """where the local accelerations are less certain than this [m/s²], they show neither flight nor a hand"""
    block_frames: Count = advanced(10_000)
    """frames that are in memory at a time, or more where no rest divides them"""
    cached_tosses: NonNegative = advanced(64)
    """tosses that stay in memory once they were read"""


@dataclass(frozen=True, kw_only=True)
class GroundSettings:
    """How the direction of gravity and the ground's plane are found from flights and rests."""

    half_window: Count = 5
    """frames on each side of the fit that gives an acceleration"""
    falling: Positive = 1.0
    """an object may fall where its acceleration's size is within this of gravity's [m/s²]"""
    same_direction: Positive = math.radians(5.0)
    """accelerations whose directions are this near are one gravity [rad]"""
    shortest_fall: Count = 8
    """frames in a row that a fall has at least"""
    fewest_falling: Count = 30
    """frames of falls from which gravity's direction is estimated"""
    still_distance: Positive = 0.0005
    """an object lies still within this [m], `still_angle` and `still_time`"""
    still_angle: Positive = 0.008
    """see `still_distance` [rad]"""
    still_time: Positive = 0.15
    """see `still_distance` [s]"""
    fewest_rests: Count = 3
    """places of rest that a plane is laid through at least"""
    level_sigmas: Positive = 4.0
    """the ground is level where its slope is within so many standard deviations of gravity's direction"""
    least_scatter: Positive = 0.0003
    """places of rest agree with a plane to this at best [m]"""
    block_frames: Count = 10_000
    """frames that are in memory at a time"""
