"""Settings of how likely recorded tosses are under a simulator: windows, whitening, density."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from tossid.settings.kinds import Bounds, Count, Fraction, Positive, advanced_part


@dataclass(frozen=True, kw_only=True)
class WindowSettings:
    """How tosses are cut into windows, and how far the recorded first states are trusted."""

    length: Count = 20
    """frames of a window in contact; the most rows of any window"""
    long: Annotated[int, Bounds(low=0)] = 60
    """frames of a window that is all flight or all rest: a weak force shows only over many frames"""
    shortest_flight: Count = 6
    """frames that a toss's first flight needs to get a window of its own"""
    shortest_later_flight: Count = 12
    """the same for flights after a bounce, of which short ones show no weak force"""
    frames_after_contact: Annotated[int, Bounds(low=0)] = 2
    """frames after an object has left the ground that do not count as flight: a tracker smears poses over an impact"""
    falls_alike: Positive = 0.25
    """largest difference of a later flight's acceleration to the first one's, over gravity"""
    velocity_jump: Positive = 3.0
    """a flight ends where the velocity jumps by so many times gravity's change of velocity in a frame, beyond noise"""
    frames_before_landing: Annotated[int, Bounds(low=0)] = 10
    """frames of flight that stay in the window with the landing, to determine its first velocity"""
    clearance: Positive = 3e-3
    """height over the ground [m] above which a window's recorded corners stay where contact is not felt in it"""
    velocity_std: Positive = 0.5
    """standard deviation of recorded velocities [m/s], which lag and are smeared over impacts"""
    spin_std: Positive = 5.0
    """standard deviation of recorded angular velocities and joint rates [rad/s]"""
    least_position_std: Positive = 5e-6
    """smallest standard deviation of a recorded position [m]; below it whitening loses digits in double precision"""
    least_rotation_std: Positive = 5e-5
    """the same of a rotation or a joint angle [rad]"""
    rest_tolerance: Positive = 6.0
    """standard deviations of a pose by which poses at rest may differ"""
    time_step_tolerance: Positive = 0.3
    """share of a frame by which a time step may miss a whole number of frames; beyond, a window ends"""
    most_missing: Annotated[int, Bounds(low=0)] = 3
    """frames in a row that may be missing in a window; beyond, it ends"""
    attitude_scale: Positive = 1.0
    """rotation over which a tracker's slow errors decorrelate [rad]: other tags come into view"""


@dataclass(frozen=True, kw_only=True)
class SimulationSettings:
    """How finely predictions are simulated."""

    substeps: Count = 2
    """simulator steps a frame"""
    impact_parts: Count = 8
    """parts of a step with an impact in rigid contact"""
    compliant_impact_parts: Count = 32
    """the same in compliant contact: median errors after 24 frames are 0.5 to 1.9 mm, with 16 parts 0.7 to 3.3 mm"""
    tolerance: Positive = 1e-5
    """contact solver's tolerance [m/s]: nine windows in ten move by less than 5 % of the poses' noise against 1e-7,
    for half of the work"""


@dataclass(frozen=True, kw_only=True)
class WhiteningSettings:
    """How first states are estimated in each window (damped Gauss-Newton)."""

    poor_fit: Positive = 3.0
    """standard deviations of chi-squared by which a window's cost exceeds its mean before it is restarted"""
    restart_steps: Count = 4
    """Gauss-Newton steps of a restart"""
    first_frames: tuple[Fraction, ...] = (0.2, 0.4, 0.6, 0.8)
    """shares of a window's frames from which the first restart finds its first state, one after the other"""
    followed_steps: Count = 2
    """Gauss-Newton steps for each of them"""
    least_decrease: Positive = 0.02
    """decrease of a window's cost below which its steps end"""
    most_damping: Positive = 1e3
    """Marquardt's damping at which a window that does not improve is given up"""
    largest_step: tuple[Positive, Positive, Positive, Positive] = (0.01, 0.1, 1.0, 10.0)
    """largest change of a first state in a step: position [m], rotation and joints [rad], velocity [m/s], angular
    velocity and joint rates [rad/s]"""
    difference: tuple[Positive, Positive, Positive, Positive] = (2e-4, 2e-3, 5e-3, 3e-2)
    """steps of the finite differences by first states, in the same units"""
    reuse_tolerance: Positive = 0.3
    """standard deviations of poses by which predictions may move before their derivatives are computed anew"""


@dataclass(frozen=True, kw_only=True)
class DensitySettings:
    """The density of whitened residuals: Student's, which one chaotic impact does not dominate."""

    degrees_of_freedom: Positive = 4.0
    """Student's degrees of freedom"""
    curvature: Positive = 0.65
    """curvature of its log-likelihood on Gaussian residuals, over Gauss-Newton's; belongs to the degrees of freedom"""
    largest_residual: Positive = 30.0
    """whitened residuals beyond it count as this in sums of squares"""
    large_gain: Positive = 8.0
    """gain of a window's log-likelihood beyond which it counts logarithmically: an effect explains many windows"""


@dataclass(frozen=True, kw_only=True)
class LikelihoodSettings:
    """How likely recorded tosses are under a simulator."""

    windows: WindowSettings = advanced_part(WindowSettings)
    """how tosses are cut into windows"""
    simulation: SimulationSettings = advanced_part(SimulationSettings)
    """how finely predictions are simulated"""
    whitening: WhiteningSettings = advanced_part(WhiteningSettings)
    """how first states are estimated"""
    density: DensitySettings = advanced_part(DensitySettings)
    """the density of whitened residuals"""
