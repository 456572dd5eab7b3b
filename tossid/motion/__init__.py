"""Motion: velocities, covariances and phases from poses, the same for imported and tracked ones; tosses from tracks.

Names are imported from their modules when they are first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tossid.motion.contact import lowest_corner, may_touch
    from tossid.motion.defects import Defect, find_defects
    from tossid.motion.flight import FlightState, flight_frames, flight_states, frames_in_flight
    from tossid.motion.kinematics import body_velocities, com_velocities, corner_velocities, jump_speed
    from tossid.motion.measurement import MeasurementEstimate, MeasurementModel, estimate_measurement
    from tossid.motion.noise import PoseNoise, pose_noise, velocity_noise
    from tossid.motion.phases import label_phases
    from tossid.motion.smoothing.smoother import Smoothed, smooth_in_turn
    from tossid.motion.tosses import covariance_source, median_rate, tosses_from_tracks, tosses_in_turn

_MODULES = {
    "contact": ("lowest_corner", "may_touch"),
    "defects": ("Defect", "find_defects"),
    "flight": ("FlightState", "flight_frames", "flight_states", "frames_in_flight"),
    "kinematics": ("body_velocities", "com_velocities", "corner_velocities", "jump_speed"),
    "measurement": ("MeasurementEstimate", "MeasurementModel", "estimate_measurement"),
    "noise": ("PoseNoise", "pose_noise", "velocity_noise"),
    "phases": ("label_phases",),
    "smoothing.smoother": ("Smoothed", "smooth_in_turn"),
    "tosses": ("covariance_source", "median_rate", "tosses_from_tracks", "tosses_in_turn"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "Defect",
    "FlightState",
    "MeasurementEstimate",
    "MeasurementModel",
    "PoseNoise",
    "Smoothed",
    "body_velocities",
    "com_velocities",
    "corner_velocities",
    "covariance_source",
    "estimate_measurement",
    "find_defects",
    "flight_frames",
    "flight_states",
    "frames_in_flight",
    "jump_speed",
    "label_phases",
    "lowest_corner",
    "may_touch",
    "median_rate",
    "pose_noise",
    "smooth_in_turn",
    "tosses_from_tracks",
    "tosses_in_turn",
    "velocity_noise",
]


def __getattr__(name: str) -> Any:
    """A name of the room, from its module."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
