"""Settings of what turns a long track into tosses: where they begin and end."""

from __future__ import annotations

from dataclasses import dataclass

from tossid.settings.kinds import Positive


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
