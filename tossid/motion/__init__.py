"""Motion: velocities, covariances and phases from poses, the same for imported and tracked ones."""

from tossid.motion.contact import lowest_corner, may_touch
from tossid.motion.defects import Defect, find_defects
from tossid.motion.flight import FlightState, flight_frames, flight_state, flight_states
from tossid.motion.kinematics import body_velocities, com_velocities, corner_velocities, jump_speed
from tossid.motion.measurement import Calibration, Measurement, calibrate
from tossid.motion.noise import PoseNoise, pose_noise, velocity_noise
from tossid.motion.phases import label_phases
from tossid.motion.smoother import Smoothed, smooth_tracks
from tossid.motion.tosses import covariance_source, median_rate, tosses_from_tracks, tosses_in_turn

__all__ = [
    "Calibration",
    "Defect",
    "FlightState",
    "Measurement",
    "PoseNoise",
    "Smoothed",
    "body_velocities",
    "calibrate",
    "com_velocities",
    "corner_velocities",
    "covariance_source",
    "find_defects",
    "flight_frames",
    "flight_state",
    "flight_states",
    "jump_speed",
    "label_phases",
    "lowest_corner",
    "may_touch",
    "median_rate",
    "pose_noise",
    "smooth_tracks",
    "tosses_from_tracks",
    "tosses_in_turn",
    "velocity_noise",
]
