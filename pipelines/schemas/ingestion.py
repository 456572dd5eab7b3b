"""Keys of ingest and of its stages."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pipelines.schemas.kinds import (
    Bounds,
    Count,
    Fraction,
    NonNegative,
    ObjectConfig,
    Positive,
    Seed,
)
from pipelines.schemas.launching import Launcher


@dataclass(frozen=True)
class DetectConfig:
    """How tags are looked for."""

    quad_decimate: Annotated[float, Bounds(low=1)]
    """reduction of the image where the object must be"""
    search_decimate: Annotated[float, Bounds(low=1)]
    """reduction where it must be looked for in the whole image"""
    predict: bool
    """look where the last poses say first; false searches every image whole"""
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
    """largest standard deviation of a position along any axis [m], where the track's median is not of that order"""
    max_angle_sigma: Positive
    """largest standard deviation of an orientation about any axis [rad], likewise"""
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
    clocks: bool
    """look whether cameras' clocks are apart, and find by how much"""


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
class VideoSource:
    """Videos of the tagged object, one file a camera, with the cameras' calibration and the tags' layout."""

    name: Literal["video"]
    """videos"""
    path: Path
    """recording folder: CAMERA.mp4 for each camera, CAMERA.txt with its frames' times beside, or none"""
    rate_hz: Positive | None
    """frames a second where no file has times; null: what cameras.yaml or the videos say"""


@dataclass(frozen=True)
class RosbagSource:
    """A ROS 1 or ROS 2 bag: AprilTag detections (apriltag_msgs) or camera images (sensor_msgs)."""

    name: Literal["rosbag"]
    """ROS bags"""
    path: Path
    """a bag (.bag, .bag.bz2, .mcap, or a ROS 2 bag's folder), or a folder with one"""
    set_up: Path | None
    """folder of cameras.yaml, camera_poses.yaml and tagslam.yaml; null: the bag's"""
    images: bool
    """detect tags in the bag's images even where it has detections"""


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


Source = FramesSource | VideoSource | RosbagSource | ContactNetsSource | PllSource | TumSource


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
    level: Literal["auto", "always", "never"]
    """frames: turn and shift the world so that the ground found from the tosses is z = 0; auto: where no fixed tag says
    where the ground is, and it is off by more than 1 cm or 1 degree"""
    seed: Seed
    """seed of the draw of splits"""
    splits: tuple[Fraction, Fraction, Fraction]
    """shares of tosses for train, validation and test"""
    defects: Literal["keep", "set_aside"]
    """imported tosses with what neither gravity nor contact explains (rules flight, speed, flip, jolt): set_aside gives
    them no split"""
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
    """recording folder (frames or videos), or a bag with images; null: the newest in data/raw"""
    recordings: str | None
    """several, by a pattern ('data/raw/*'): each is searched by a worker, those that have been are left as they are"""
    out: Path | None
    """detections to write (.npz), of several a folder; null: outputs/stages/RECORDING/detections.npz"""
    threads: Count | None
    """images searched at the same time; null: one a core"""
    workers: Count | None
    """recordings at the same time, of several; null: one a core, or as many as the cluster has workers"""
    launcher: Launcher
    """who searches several:"""
    object: ObjectConfig | None
    """what was tossed; none: what the recording says, else the cube:"""
    detect: DetectConfig
    """how tags are looked for:"""


@dataclass(frozen=True)
class TrackStageConfig:
    """Keys of `tossid track`."""

    recording: Path | None
    """recording folder (for its calibration), or a bag with detections; null: the newest in data/raw"""
    detections: Path | None
    """what `tossid detect` wrote; null: the bag's, else its default place for this recording"""
    out: Path | None
    """poses to write (.npz, with .txt of each body in the TUM format and the calibration beside);
    null: outputs/stages/RECORDING/poses.npz"""
    object: ObjectConfig | None
    """what was tossed; none: what the recording says, else every moving body of tagslam.yaml:"""
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
    level: Literal["auto", "always", "never"]
    """frames: turn and shift the world so that the ground found from the tosses is z = 0; auto: where no fixed tag says
    where the ground is, and it is off by more than 1 cm or 1 degree"""
    seed: Seed
    """seed of the draw of splits"""
    splits: tuple[Fraction, Fraction, Fraction]
    """shares of tosses for train, validation and test"""
    object: ObjectConfig | None
    """what was tossed; none: what the recording says, else the cube:"""
    segment: SegmentConfig
    """what counts as flight and as rest:"""
