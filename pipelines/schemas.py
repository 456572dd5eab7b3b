"""What every command can be told: the type and the meaning of each key.

Values live in `conf/`: none has a default here. The text under a field is its
documentation; `tossid COMMAND --help` prints it. A field whose type is a
dataclass with a `name`, and that has a folder in `conf/`, is a group:
`source=tum` takes `conf/source/tum.yaml`. Where members differ in their keys,
the field is a union, and the member's `name` picks the class.

Nothing heavy is imported here: help pages read this module.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal


@dataclass(frozen=True, slots=True)
class Bounds:
    """Limits of a number, inclusive; `above`: exclusive lower limit."""

    low: float | None = None
    high: float | None = None
    above: float | None = None


@dataclass(frozen=True, slots=True)
class Ordered:
    """Marks a pair of limits: the first is not above the second."""


Positive = Annotated[float, Bounds(above=0)]
NonNegative = Annotated[float, Bounds(low=0)]
Count = Annotated[int, Bounds(low=1)]
Fraction = Annotated[float, Bounds(low=0, high=1)]
Range = Annotated[tuple[float, float], Ordered()]
Span = Annotated[tuple[NonNegative, NonNegative], Ordered()]
Seed = Annotated[int, Bounds(low=0, high=2**32 - 1)]


# ---------------------------------------------------------------- the object


@dataclass(frozen=True)
class ObjectConfig:
    """The object that is tossed."""

    name: str
    """what it is called"""
    path: Path
    """its MJCF or URDF file; a relative path is sought in the working folder, then in tossid's own"""
    friction: NonNegative
    """Coulomb friction of object and ground"""
    restitution: Annotated[float, Bounds(low=0, high=1)]
    """Newton's restitution, 0 for none"""
    width: Positive | None
    """length that position errors refer to [m]; null: the longest edge of the base"""
    tags: Path | None
    """its AprilTags, in TagSLAM's tagslam.yaml form; null: none"""


# ---------------------------------------------------------------- ingest and its stages


@dataclass(frozen=True)
class DetectConfig:
    """How tags are looked for."""

    quad_decimate: Annotated[float, Bounds(low=1)]
    """reduction of the image near where the object was last seen"""
    search_decimate: Annotated[float, Bounds(low=1)]
    """reduction where it must be looked for in the whole image"""
    predict: bool
    """look near the last place first; false searches every image whole"""
    refine: bool
    """measure corners in the image, to a fraction of a pixel"""
    max_hamming: Annotated[int, Bounds(low=0, high=2)]
    """most corrected bits"""
    min_margin: NonNegative
    """least decision margin"""


@dataclass(frozen=True)
class TrackConfig:
    """When a pose is believed."""

    max_rms: Positive
    """largest rms reprojection of a frame [px]"""
    max_sigma: Positive
    """largest standard deviation of a position along any axis [m]"""
    max_angle_sigma: Positive
    """largest standard deviation of an orientation about any axis [rad]"""
    outlier: Positive
    """whitened rms residual beyond which one tag among several is dropped"""
    evidence: NonNegative
    """least difference in residuals for the images alone to decide between two poses"""
    max_spin: Positive
    """fastest turn that is believed [rad/s]"""
    max_speed: Positive
    """fastest motion that is believed [m/s]"""
    max_gap: Positive
    """longest time over which neighbours decide between two poses [s]"""


@dataclass(frozen=True)
class SegmentConfig:
    """What counts as flight and as rest."""

    rest_distance: Positive
    """distance from its final place within which the object rests [m]"""
    rest_angle: Positive
    """angle from its final orientation within which it rests [rad]"""
    min_rest: Positive
    """shortest rest [s]"""
    min_flight: Positive
    """shortest free flight [s]"""
    flight_acceleration: Positive
    """deviation from gravity that is still free flight [m/s²]"""
    energy: Positive
    """rise of energy over weight that only a hand can cause [m]"""
    ground: Positive
    """height of the lowest corner at which a flight can have ended on the ground [m]"""
    max_gap: Positive
    """longest gap in a toss [s]"""


@dataclass(frozen=True)
class FramesSource:
    """Camera frames of the tagged object, with the cameras' calibration and the tags' layout."""

    name: Literal["frames"]
    """camera frames"""
    path: Path | None
    """recording folder; null: the newest in data/raw"""


@dataclass(frozen=True)
class ContactNetsSource:
    """Tosses of the ContactNets cube as published: N.pt files in half widths."""

    name: Literal["contactnets"]
    """ContactNets' tensors"""
    path: Path
    """folder of N.pt files"""
    half_width: Positive
    """half of the cube's width, the file's unit of length [m]"""
    rate_hz: Positive
    """frames a second"""


@dataclass(frozen=True)
class PllSource:
    """Tosses as published with dair_pll: N.pt files in metres."""

    name: Literal["pll"]
    """dair_pll's tensors"""
    path: Path
    """folder of N.pt files"""
    rate_hz: Positive
    """frames a second"""


@dataclass(frozen=True)
class TumSource:
    """Tracked poses, one TUM trajectory file a toss."""

    name: Literal["tum"]
    """TUM trajectories"""
    path: Path
    """folder of NAME.txt files (NAME.joints.txt beside, for joints)"""


Source = FramesSource | ContactNetsSource | PllSource | TumSource


@dataclass(frozen=True)
class IngestConfig:
    """Keys of `tossid ingest`."""

    source: Source
    """what is read:"""
    object: ObjectConfig | None
    """what was tossed; none: what the recording says, else the elbow for pll and the cube for the rest:"""
    out: Path | None
    """the dataset to write (.h5); null: data/datasets/NAME.h5"""
    gravity: Positive
    """gravity where it was recorded [m/s²]"""
    seed: Seed
    """seed of the draw of splits"""
    splits: tuple[Fraction, Fraction, Fraction]
    """shares of tosses for train, validation and test"""
    threads: Count | None
    """images searched at the same time; null: one a core"""
    detect: DetectConfig
    """frames: how tags are looked for:"""
    track: TrackConfig
    """frames: when a pose is believed:"""
    segment: SegmentConfig
    """frames: what counts as flight and as rest:"""


@dataclass(frozen=True)
class DetectStageConfig:
    """Keys of `tossid detect`."""

    recording: Path | None
    """recording folder; null: the newest in data/raw"""
    out: Path | None
    """detections to write (.npz); null: outputs/stages/RECORDING/detections.npz"""
    threads: Count | None
    """images searched at the same time; null: one a core"""
    object: ObjectConfig | None
    """what was tossed; none: what the recording says, else the cube:"""
    detect: DetectConfig
    """how tags are looked for:"""


@dataclass(frozen=True)
class TrackStageConfig:
    """Keys of `tossid track`."""

    recording: Path | None
    """recording folder (for its calibration); null: the newest in data/raw"""
    detections: Path | None
    """what `tossid detect` wrote; null: its default place for this recording"""
    out: Path | None
    """poses to write (.npz, and .txt in the TUM format beside); null: outputs/stages/RECORDING/poses.npz"""
    object: ObjectConfig | None
    """what was tossed; none: what the recording says, else the cube:"""
    track: TrackConfig
    """when a pose is believed:"""


@dataclass(frozen=True)
class SegmentStageConfig:
    """Keys of `tossid segment`."""

    recording: Path | None
    """recording folder (for its object); null: the newest in data/raw"""
    poses: Path | None
    """what `tossid track` wrote; null: its default place for this recording"""
    out: Path | None
    """the dataset to write (.h5); null: data/datasets/RECORDING.h5"""
    gravity: Positive
    """gravity where it was recorded [m/s²]"""
    seed: Seed
    """seed of the draw of splits"""
    splits: tuple[Fraction, Fraction, Fraction]
    """shares of tosses for train, validation and test"""
    object: ObjectConfig | None
    """what was tossed; none: what the recording says, else the cube:"""
    segment: SegmentConfig
    """what counts as flight and as rest:"""


# ---------------------------------------------------------------- synthesize


@dataclass(frozen=True)
class LcpEngine:
    """tossid's own time stepping: rigid contact as a complementarity problem."""

    name: Literal["lcp"]
    """rigid contact"""
    substeps: Count
    """time steps a frame"""
    directions: Annotated[int, Bounds(low=0)]
    """0: the exact friction cone; 4, 6, 8, …: the polyhedral cone of so many directions"""


@dataclass(frozen=True)
class MujocoEngine:
    """MuJoCo, with contact as stiff as it bears."""

    name: Literal["mujoco"]
    """MuJoCo"""
    substeps: Count | None
    """time steps a frame; null: as many as its contact needs to be near rigid"""


Engine = LcpEngine | MujocoEngine


@dataclass(frozen=True)
class ReleaseConfig:
    """How tosses begin; each value is drawn between its two limits, the orientation from all."""

    height: Span
    """lowest corner above the ground [m]"""
    landing: NonNegative
    """radius of the disc about the origin in which it first comes down [m]"""
    speed: Span
    """horizontal speed [m/s]"""
    climb: Range
    """vertical velocity, upward [m/s]"""
    spin: Span
    """angular speed, about any axis [rad/s]"""
    joint: Range
    """joint angles, for an object with joints [rad]"""
    joint_rate: Range
    """joint rates [rad/s]"""


@dataclass(frozen=True)
class NoiseConfig:
    """Standard deviations of what is added to the true states (frames=false)."""

    position: NonNegative
    """of positions [m]"""
    rotation: NonNegative
    """of orientations [rad]"""
    joint: NonNegative
    """of joint angles [rad]"""
    velocity: NonNegative
    """of velocities [m/s]"""
    spin: NonNegative
    """of angular velocities [rad/s]"""
    joint_rate: NonNegative
    """of joint rates [rad/s]"""


@dataclass(frozen=True)
class CameraConfig:
    """The cameras around the tosses, and what their images look like (frames=true)."""

    renderer: Literal["opencv", "mujoco"]
    """opencv needs nothing of the system; mujoco needs EGL or OSMesa"""
    count: Annotated[int, Bounds(low=1, high=9)]
    """how many"""
    width: Annotated[int, Bounds(low=64, high=8192)]
    """image width [px]"""
    height: Annotated[int, Bounds(low=64, high=8192)]
    """image height [px]"""
    exposure_s: NonNegative
    """exposure [s]; motion blurs over it"""
    area: Positive
    """diameter of the disc on the ground that every camera sees [m]"""
    distance: Positive
    """from the middle of the area [m]"""
    elevation_deg: Annotated[float, Bounds(above=0, high=85)]
    """over the ground [deg]"""
    distorted: bool
    """with lens distortion"""
    samples: Count
    """rays a pixel"""
    noise: NonNegative
    """sensor noise [grey levels]"""
    blur: NonNegative
    """lens blur [px]"""
    quality: Annotated[int, Bounds(low=30, high=100)]
    """JPEG quality"""
    carry_s: Span
    """how long a hand carries the object to each release, between two limits [s]"""
    pause_s: Span
    """how long the object lies before the hand takes it, between two limits [s]"""


@dataclass(frozen=True)
class SynthesizeConfig:
    """Keys of `tossid synthesize`."""

    object: ObjectConfig
    """what is tossed:"""
    engine: Engine
    """what simulates:"""
    tosses: Count
    """how many"""
    frames: bool
    """camera frames (a recording for ingest), or states (a dataset for train)"""
    seed: Seed
    """seed of everything random"""
    rate_hz: Positive
    """frames a second"""
    gravity: NonNegative
    """downward [m/s²]"""
    seconds: Positive
    """the longest that a toss may take [s]"""
    rest_s: NonNegative
    """time at rest that ends a toss [s]"""
    out: Path | None
    """folder to write; null: data/raw/OBJECT-ENGINE-SEED"""
    splits: tuple[Fraction, Fraction, Fraction]
    """shares of tosses for train, validation and test (frames=false)"""
    release: ReleaseConfig
    """how tosses begin"""
    noise: NoiseConfig
    """what is added to the states"""
    camera: CameraConfig
    """the cameras"""


COMMANDS: dict[str, type] = {
    "detect": DetectStageConfig,
    "ingest": IngestConfig,
    "segment": SegmentStageConfig,
    "synthesize": SynthesizeConfig,
    "track": TrackStageConfig,
}
"""The schema of each command that takes keys."""
