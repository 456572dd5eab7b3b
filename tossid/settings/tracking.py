"""Settings of tracking: how tag corners become poses with covariances (`tossid.vision.pose_graph`).

`TrackSettings` is what a user meets. Its parts hold the values of each stage, for studies from Python.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from tossid.settings.kinds import Count, Fraction, NonNegative, Positive, advanced_part


@dataclass(frozen=True, kw_only=True)
class SceneSettings:
    """How detections are sorted into time steps."""

    step_periods: Positive = 0.55
    """frames of different cameras within so many periods of the fastest camera are one time step"""
    still_pixels: Positive = 3.0
    """largest motion of a static tag in a static camera's images [px]; such sightings are merged into their mean"""


@dataclass(frozen=True, kw_only=True)
class ResectionSettings:
    """How a pose is fitted to tags that are seen from known places."""

    huber: Positive = 3.0
    """whitened residual of a corner beyond which Huber's loss grows linearly, here and in the pose graph [1]"""
    iterations: Count = 8
    """Gauss-Newton steps of a fit"""
    distinct_angle: Positive = math.radians(20.0)
    """angle above which two poses are two hypotheses, not one pose with an error [rad]"""
    proposing_tags: Count = 24
    """of one unknown pose, so many of the largest tags propose candidates"""
    judging_sightings: Count = 96
    """of one unknown pose, so many sightings judge the candidates"""
    fits_at_once: Count = 1000
    """unknown poses that are fitted together; bounds the memory"""


@dataclass(frozen=True, kw_only=True)
class FirstPoseSettings:
    """How one of the two poses that a flat tag allows is chosen before the pose graph."""

    cost_ratio: Positive = 3.0
    """least ratio of the two poses' squared residuals for the images alone to decide: errors that all sightings of a
    tag share (of a lens model, of a print) add to both"""
    last_resort: NonNegative = 2.0
    """difference of squared residuals over the noise that decides where nothing else does"""


@dataclass(frozen=True, kw_only=True)
class GraphSettings:
    """How the pose graph is optimised."""

    window: Count = 3000
    """time steps that are optimised together"""
    independent_window: Count = 60
    """as many where steps share no unknown; the slowest step sets how often all of them are linearised"""
    sampled_steps: Count = 20
    """of a recording longer than a window, so many time steps of each tag and camera, at least, calibrate these"""
    iterations: Count = 100
    """most steps of an optimisation"""
    weak_prior: Positive = 3.0
    """standard deviation of the prior that covariances are taken with where a pose is not determined [m, rad]"""
    clock_sigma: Positive = 0.002
    """standard deviation of a clock's offset before the graph, about what `clock_search` found [s]"""
    covariance_slack: Positive = 1.2
    """covariances are scaled by the residuals' noise where that differs from the corners' own by more than this factor;
    errors such as edges that spread are in the residuals and not in the pose"""


@dataclass(frozen=True, kw_only=True)
class GatingSettings:
    """Limits that bend with what a recording can give, beside the fixed ones of `TrackSettings`."""

    rms_sigmas: Positive = 6.0
    """a time step's rms reprojection passes within so many standard deviations of its corners"""
    sigma_medians: Positive = 50.0
    """a pose's standard deviation passes within so many times the track's median"""
    jump_angle: NonNegative = math.radians(10.0)
    """turn between two poses that is no jump, whatever the time between them [rad]"""
    jump_distance: NonNegative = 0.02
    """distance likewise [m]"""
    shortest_run: Count = 5
    """poses between two jumps that are left out if they are fewer"""
    outlier_pixels: NonNegative = 0.5
    """rms reprojection up to which no sighting is an outlier [px]"""


@dataclass(frozen=True, kw_only=True)
class ClockSearchSettings:
    """How offsets between cameras' clocks are found from what they see of the same motion."""

    reach: Positive = 0.25
    """largest offset that is looked for once clocks were set coarsely, at any offset, from all that is seen [s]"""
    steps: tuple[Positive, Positive, Positive] = (0.004, 0.001, 0.00025)
    """steps of the offsets that are tried, from coarse to fine [s]"""
    stretches: Count = 10
    """stretches of the recording that are used"""
    stretch_steps: Count = 120
    """time steps of each"""
    fewest_steps: Count = 20
    """time steps in which one camera alone has to place a body, for the others to be compared with it"""
    fewest_sightings: Count = 40
    """sightings of a tag of that body from which another camera's clock is looked for"""
    soft_pixels: Positive = 5.0
    """reprojection at which a corner's weight is halved (Geman and McClure) [px]"""
    misfit_share: Fraction = 0.6
    """an offset must bring the misfit below this share of the misfit without it"""
    same: Positive = 0.0005
    """clocks that are no further apart are one [s]"""
    sigmas: Positive = 5.0
    """the pose graph confirms an offset that is so many of its standard deviations from zero"""


@dataclass(frozen=True, kw_only=True)
class TagModelSettings:
    """When tags are more than flat squares with sharp edges: edges that spread in an image, and distorted prints."""

    fewest_sightings: Count = 50
    """sightings from which a spread of edges is estimated"""
    variance_ratio: Positive = 2.0
    """the spread's variance must be this many times what independent errors of corners give"""
    converged: Positive = 0.1
    """the estimate has converged when the spread changes by less than this share"""
    fewest_steps: Count = 20
    """time steps that must show a tag before its print is estimated"""
    passes: NonNegative = 6
    """most alternations between poses and tag model"""
    noise_share: Fraction = 0.75
    """the model is kept where it brings the noise below this share of the plain model's"""
    print_sigma: Positive = 0.01
    """prior standard deviation by which a print is wider, higher, or twisted out of its plane, in shares of its size"""


@dataclass(frozen=True, kw_only=True)
class SetupCheckSettings:
    """When the set-up is suspected, and what is tried then."""

    residual_ratio: Positive = 1.5
    """residuals over the noise from which the set-up is checked"""
    left_out_share: Fraction = 0.02
    """share of sightings that contradict the others from which it is checked"""
    steps: Count = 200
    """time steps that are used"""
    fewest_steps: Count = 20
    """time steps below which nothing is tried"""
    fewest_sightings: Count = 5
    """sightings by or of a suspect below which nothing is said of it"""
    least_distance: Positive = 0.001
    """something that is off by less than this [m] and by less than `least_angle` is not reported"""
    least_angle: Positive = math.radians(0.3)
    """see `least_distance` [rad]"""
    misfit_share: Fraction = 0.75
    """correcting the suspect must bring the misfit of the rest below this share of what it was"""
    most_suspects: Count = 4
    """most suspects that are reported of a body"""
    focal_step: Positive = 0.005
    """step of the focal lengths that are tried, as a share; 20 to either side"""
    center_step: Positive = 2.0
    """step of the principal points that are tried [px]; 20 to either side"""


@dataclass(frozen=True, kw_only=True)
class StreamSettings:
    """How a long recording is tracked in pieces."""

    piece: Positive = 20.0
    """length of a piece [s]"""
    disorder: NonNegative = 2.0
    """detections come in order of time to within this [s]"""
    border: Positive = 0.5
    """a piece ends at the widest gap between frames within this of its full length [s]"""
    whole_frames: Count = 12_000
    """frames up to which a recording is tracked as a whole where something static is to be calibrated"""
    stretches: Count = 20
    """of a longer one, so many stretches calibrate what is static"""
    stretch_frames: Count = 600
    """frames of each stretch"""


@dataclass(frozen=True, kw_only=True)
class TrackSettings:
    """When a pose is accepted, and how poses are found."""

    max_rms: Positive = 1.5
    """largest rms reprojection of a frame [px]"""
    max_sigma: Positive = 0.005
    """largest standard deviation of a position along any axis [m], where the track's median is not of that order"""
    max_angle_sigma: Positive = 0.06
    """largest standard deviation of an orientation about any axis [rad], likewise"""
    outlier: Positive = 6.0
    """whitened rms residual beyond which one tag among several is dropped"""
    evidence: NonNegative = 25.0
    """least difference in squared residuals over the noise for the images alone to decide between two poses"""
    max_spin: Positive = 50.0
    """fastest turn that is accepted [rad/s]"""
    max_speed: Positive = 10.0
    """fastest motion that is accepted [m/s]"""
    max_gap: Positive = 0.06
    """longest time over which neighbours decide between two poses [s]"""
    clocks: bool = True
    """look whether cameras' clocks are apart, and find by how much"""
    scene: SceneSettings = advanced_part(SceneSettings)
    """detections sorted into time steps"""
    resection: ResectionSettings = advanced_part(ResectionSettings)
    """fits of single poses"""
    first_poses: FirstPoseSettings = advanced_part(FirstPoseSettings)
    """choice between the two poses of a flat tag"""
    graph: GraphSettings = advanced_part(GraphSettings)
    """optimisation of the pose graph"""
    gating: GatingSettings = advanced_part(GatingSettings)
    """limits that bend with the recording"""
    clock_search: ClockSearchSettings = advanced_part(ClockSearchSettings)
    """search for clock offsets"""
    tag_model: TagModelSettings = advanced_part(TagModelSettings)
    """spread edges and distorted prints"""
    setup_check: SetupCheckSettings = advanced_part(SetupCheckSettings)
    """what is suspected of the set-up"""
    stream: StreamSettings = advanced_part(StreamSettings)
    """long recordings"""
