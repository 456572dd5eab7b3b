"""Motion: velocities, covariances and phases from poses, the same for imported and tracked ones; tosses from tracks."""

from tossid.motion.contact import lowest_corner, may_touch
from tossid.motion.defects import Defect, find_defects
from tossid.motion.flight import FlightState, flight_states, frames_in_flight
from tossid.motion.kinematics import com_velocities, corner_velocities
from tossid.motion.measurement import MeasurementEstimate, MeasurementModel, estimate_measurement
from tossid.motion.phases import label_phases
from tossid.motion.tosses import covariance_source, median_rate, tosses_from_tracks, tosses_in_turn

__all__ = [
    "Defect",
    "FlightState",
    "MeasurementEstimate",
    "MeasurementModel",
    "com_velocities",
    "corner_velocities",
    "covariance_source",
    "estimate_measurement",
    "find_defects",
    "flight_states",
    "frames_in_flight",
    "label_phases",
    "lowest_corner",
    "may_touch",
    "median_rate",
    "tosses_from_tracks",
    "tosses_in_turn",
]
