"""Settings of motion: noise of poses, smoothing, phases, defects, and scatter at rest (`tossid.motion`)."""

from __future__ import annotations

from dataclasses import dataclass

from tossid.settings.kinds import Count, Fraction, NonNegative, Positive, advanced_part


@dataclass(frozen=True, kw_only=True)
class NoiseSettings:
    """How the noise of recorded poses and velocities is estimated."""

    window: Count = 10
    """frames that a cubic is fitted to; its residuals are noise"""
    fewest_windows: Count = 8
    """windows of flight below which the quieter half of all windows is used"""
    fewest_frames: Count = 30
    """frames of a phase below which it has no velocity noise of its own"""
    least_position: Positive = 1e-7
    """least standard deviation of positions [m] and velocities [m/s]; exact data would make covariances singular"""
    least_angle: Positive = 1e-6
    """least standard deviation of angles [rad] and rates [rad/s]"""


@dataclass(frozen=True, kw_only=True)
class SmootherSettings:
    """How velocities are estimated by smoothing, with impacts as heavy-tailed accelerations."""

    batch: Count = 64
    """tracks that are smoothed together; the first batch, drawn evenly, gives the density in flight"""
    sorted_tracks: Count = 512
    """tracks in a row of which batches of similar length are made"""
    search_passes: Count = 6
    """passes that find the intervals of contact"""
    density_passes: Count = 8
    """passes that find the density in contact"""
    final_passes: Count = 6
    """passes with both densities in place"""
    dof: Positive = 3.0
    """degrees of freedom of the Student-t accelerations in contact; few, as impacts and lying still are both common"""
    contact_density: Positive = 0.3
    """their density while contact is searched [m²/s³]: at 148 Hz the velocity changes by 0.7 g h in an interval. After
    that it is estimated from the tracks, between `least_contact_density` and ten times this"""
    least_contact_density: Positive = 3e-3
    """no object in contact moves more evenly [m²/s³]"""
    fewest_contacts: Count = 50
    """intervals of contact from which the density is estimated"""
    first_jump: Positive = 1.0
    """change of velocity that the first pass allows in every interval [m/s]"""
    jump_ratio: Positive = 10.0
    """an interval holds a jump, whatever the geometry says, if its density is so many times `contact_density`"""
    neighbour_share: Fraction = 0.03
    """least share of an interval's density in its neighbours, as it is not certain which of them held the impact"""
    support_time: Positive = 0.02
    """time over which the mean acceleration shows whether the ground carries the object [s]"""
    log10_flight_density: tuple[float, float, float] = (-8.5, 0.5, 0.5)
    """decimal logarithms of the densities in flight that are tried [m²/s³]: first, end (exclusive), step. The least
    lets the velocity change by 0.04 mm/s in half a second, which poses to 5 µm can show"""
    log_likelihood_slack: NonNegative = 0.5
    """the largest density whose log-likelihood is within this of the best is taken: one standard deviation"""


@dataclass(frozen=True, kw_only=True)
class PhaseSettings:
    """What counts as flight, impact, slide, roll and rest."""

    touch_height: Positive = 0.03
    """height below which a corner touches the ground, in widths of the object; tracked corners of resting objects are
    some millimetres off the ground, and lower hops count as contact"""
    impact_weights: Positive = 3.0
    """an impact's mean contact force over an interval exceeds so many weights"""
    impact_sigmas: Positive = 5.0
    """and its change of velocity exceeds so many standard errors"""
    passing_speed: Positive = 0.1
    """vertical speed above which a corner is on its way to or from the ground, not in lasting contact [m/s]"""
    slide_speed: Positive = 0.05
    """speed of the slowest touching corner above which the object slides [m/s]"""
    roll_speed: Positive = 0.05
    """spin times half the width above which an object that does not slide rolls [m/s]"""


@dataclass(frozen=True, kw_only=True)
class MotionSettings:
    """How tracks become tosses."""

    noise: NoiseSettings = advanced_part(NoiseSettings)
    """noise of recorded poses and velocities"""
    smoother: SmootherSettings = advanced_part(SmootherSettings)
    """velocities by smoothing"""
    phases: PhaseSettings = advanced_part(PhaseSettings)
    """what the object does at each frame"""
    judged_tracks: Count = 64
    """tracks that the noise of recorded velocities is estimated from"""
    rest_kept: NonNegative = 0.1
    """rest that a toss keeps where its end is cut [s]"""
    deepest: Positive = 0.5
    """tracks whose lowest corner is deeper in the ground than so many widths (median), or which rest or bounce so high
    above it, are refused: they are in other units, of another object, or over another ground"""


@dataclass(frozen=True, kw_only=True)
class DefectSettings:
    """What neither gravity nor contact explains in a recorded toss."""

    air_height: Positive = 0.3
    """height of the lowest corner above which nothing touches, in widths; stated geometry may be off"""
    flight_frames: Count = 8
    """frames from the first on that a flight must have to be judged"""
    flight_acceleration: Positive = 3.0
    """largest difference of a flight's acceleration from gravity [m/s²]"""
    standard_errors: Positive = 4.0
    """the difference must also exceed so many standard errors of the fitted acceleration"""
    largest_rate: Positive = 70.0
    """fastest spin of the base and rate of a hinge [rad/s]"""
    flip_rate: Positive = 20.0
    """largest difference between a frame's turn over its time and the mean of the recorded rates [rad/s]"""
    jolt_rate: Positive = 15.0
    """largest change of a rate from one frame to the next in the air [rad/s]"""


@dataclass(frozen=True, kw_only=True)
class RestScatterSettings:
    """How the scatter of poses of rest is estimated."""

    frames: Count = 8
    """last frames of a toss in which the object has to lie still"""
    still_sigmas: Positive = 6.0
    """standard deviations of noise within which it does"""
    touching_height: Positive = 0.05
    """how much higher than the lowest corner the others are that touch, in widths"""
    fewest_tosses: Count = 6
    """tosses at rest from which a scatter is estimated"""
    noise_ratio: Positive = 2.0
    """scatter over the noise's below which it counts as noise"""


@dataclass(frozen=True, kw_only=True)
class MeasurementSettings:
    """When a length scale or a velocity lag is corrected for."""

    fewest_tosses: Count = 8
    """tosses that must show a quantity"""
    confidence: Fraction = 0.999
    """level of the interval that must leave out no correction"""
    smallest_scale: NonNegative = 2e-3
    """smaller relative corrections of length are not made"""
    size_warning: NonNegative = 0.01
    """larger relative differences from the stated size are said"""
    smallest_lag: NonNegative = 0.1
    """smaller corrections of time are not made, in frames"""
    rest_speed: Positive = 0.05
    """speed below which a toss's last frame is at rest [m/s]"""
    rest_spin: Positive = 0.3
    """and its spin [rad/s]"""
    flat: Positive = 0.05
    """height over the lowest corner within which a corner is one of the lowest, in widths"""


@dataclass(frozen=True, kw_only=True)
class HingeSettings:
    """What is a hinge between two tracked links (`tossid.motion.hinge`)."""

    iterations: Count = 6
    """reweightings"""
    huber: Positive = 3.0
    """residual, in medians over frames, from which a frame counts less"""
    least_spread: Positive = 0.1
    """circular standard deviation of the angle below which the joint does not move [rad]"""
    judged: Fraction = 0.8
    """share of the frames in which a hinge keeps the next two limits"""
    most_tilt: Positive = 0.05
    """largest angle between the axis as either link carries it [rad]"""
    most_offset: Positive = 4e-3
    """largest distance between the point as either link carries it [m]"""
    least_angle_noise: Positive = 1e-5
    """smallest standard deviation of rotations that weighs them [rad]"""
    least_noise: Positive = 1e-6
    """smallest standard deviation of positions that weighs them [m]"""


@dataclass(frozen=True, kw_only=True)
class FreeFallSettings:
    """Which frames are free fall, for the centre of mass and gravity of an unknown body (`tossid.motion.free_fall`)."""

    clearance: Positive = 8e-3
    """height of the lowest point above the ground from which a frame is flight [m]"""
    margin: Count = 2
    """frames at either end of a stretch that are left out, since smoothing mixes them with contact"""
    fewest_frames: Count = 8
    """shortest stretch [frames]"""
    fewest_stretches: Count = 3
    """stretches below which there is no estimate"""
    huber: Positive = 2.0
    """rms residual, in medians over stretches, from which a stretch counts less"""
    iterations: Count = 8
    """reweightings"""
    worst_condition: Positive = 1e10
    """condition number of the normal equations beyond which the centre of mass is undetermined"""


@dataclass(frozen=True, kw_only=True)
class MomentumSettings:
    """Inertia and friction from the balance of momentum (`tossid.motion.momentum`)."""

    most_tosses: Count = 48
    """tosses, evenly drawn, that take part"""
    near: Positive = 2e-3
    """height of its way in an interval below which a point may touch the ground [m]"""
    free_rel: Positive = 3.0
    """standard deviation of a free impulse, in changes of momentum seen in its interval: large, so that it is free"""
    flight_density: Positive = 1e-6
    """density of white acceleration in flight [m²/s³]: none, but for numerical reasons"""
    gyration: Positive = 0.03
    """radius that compares its spin with its speed [m]"""
    slide_speed: Positive = 0.12
    """speed above which a touching point slides [m/s]"""
    slide_cosine: Fraction = 0.95
    """cosine of the turn of its direction in an interval above which it slides straight on"""
    slide_impulse: Positive = 0.25
    """change of the velocity, gravity apart, above which an interval holds an impact [m/s]"""
    across_rel: Positive = 0.05
    """standard deviation of the force across the direction of sliding, in sizes of a free impulse"""
    fewest_sliding: Count = 20
    """intervals of steady sliding below which there is no estimate of friction"""
    prior: Positive = 0.5
    """standard deviation of inertia (relative) and friction about their start, where tosses do not determine them"""
    difference: Positive = 1e-3
    """step of differences in inertia (relative) and friction"""
    iterations: Count = 4
    """most Gauss-Newton steps"""
    largest_step: Positive = 0.3
    """largest change in one step"""
    converged: Positive = 4e-3
    """relative change below which the steps end"""


@dataclass(frozen=True, kw_only=True)
class ParabolaSettings:
    """When a body of unknown shape flies: its centre of mass is on a parabola (`tossid.motion.parabola`)."""

    shortest: Positive = 0.06
    """duration of a window that a parabola is fitted to [s]; more where noise asks for it"""
    longest: Positive = 0.2
    """most that it may last [s]"""
    fewest_frames: Count = 6
    """fewest frames of a window"""
    noise_ratio: Positive = 15.0
    """windows are so long that a body that is carried misses the parabola by so many times the noise"""
    most_windows: Count = 6000
    """windows, evenly drawn, from which the centre of mass is found"""
    still: Positive = 2e-3
    """windows in which the pose hardly changes show no centre of mass: largest distance [m] and angle [rad]"""
    first_scale: Positive = 10.0
    """scale of the redescending loss at first, over the misfit of a body that is carried; it is halved step by step"""
    last_scale: Positive = 0.2
    """the same at last"""
    fewest_windows: Count = 6
    """windows on a parabola below which there is no flight"""
    iterations: Count = 6
    """refits to the windows that fly"""
    least_misfit: Positive = 2e-5
    """misfit with which a window flies in any case; exact data have none [m]"""
    deviations: Positive = 1.7
    """a window flies if its misfit is below so many of the typical one of flight"""
    most_carried: Fraction = 0.35
    """and below this share of the misfit of a body that is carried"""
    rest_speed: Positive = 0.05
    """speed of the centre of mass, and spin times gyration, below which a body is at rest [m/s]"""
