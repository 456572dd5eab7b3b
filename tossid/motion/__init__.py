"""Motion: velocities, covariances and phases from poses, the same for imported and tracked ones; tosses from tracks.

Names are imported from their modules when they are first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tossid.first_use import imported_at_first_use

if TYPE_CHECKING:
    from tossid.motion.contact import lowest_corner as lowest_corner
    from tossid.motion.contact import may_touch as may_touch
    from tossid.motion.defects import Defect as Defect
    from tossid.motion.defects import find_defects as find_defects
    from tossid.motion.flight import FlightState as FlightState
    from tossid.motion.flight import flight_states as flight_states
    from tossid.motion.flight import frames_in_flight as frames_in_flight
    from tossid.motion.kinematics import com_velocities as com_velocities
    from tossid.motion.kinematics import corner_velocities as corner_velocities
    from tossid.motion.measurement import MeasurementEstimate as MeasurementEstimate
    from tossid.motion.measurement import MeasurementModel as MeasurementModel
    from tossid.motion.measurement import estimate_measurement as estimate_measurement
    from tossid.motion.phases import label_phases as label_phases
    from tossid.motion.tosses import covariance_source as covariance_source
    from tossid.motion.tosses import median_rate as median_rate
    from tossid.motion.tosses import tosses_from_tracks as tosses_from_tracks
    from tossid.motion.tosses import tosses_in_turn as tosses_in_turn

_HOMES = {
    "lowest_corner": "tossid.motion.contact",
    "may_touch": "tossid.motion.contact",
    "Defect": "tossid.motion.defects",
    "find_defects": "tossid.motion.defects",
    "FlightState": "tossid.motion.flight",
    "flight_states": "tossid.motion.flight",
    "frames_in_flight": "tossid.motion.flight",
    "com_velocities": "tossid.motion.kinematics",
    "corner_velocities": "tossid.motion.kinematics",
    "MeasurementEstimate": "tossid.motion.measurement",
    "MeasurementModel": "tossid.motion.measurement",
    "estimate_measurement": "tossid.motion.measurement",
    "label_phases": "tossid.motion.phases",
    "covariance_source": "tossid.motion.tosses",
    "median_rate": "tossid.motion.tosses",
    "tosses_from_tracks": "tossid.motion.tosses",
    "tosses_in_turn": "tossid.motion.tosses",
}
"""The public names, and the module that defines each."""

__all__ = [*_HOMES]

if not TYPE_CHECKING:
    __getattr__ = imported_at_first_use(__name__, _HOMES)
