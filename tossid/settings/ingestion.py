"""Settings of `tossid.ingest`: how recordings become a dataset of tosses."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Literal

from tossid.settings.kinds import Bounds, Checked, Count, Fraction, NonNegative, Positive, Seed, advanced, advanced_part
from tossid.settings.limits import LARGEST_GRAVITY
from tossid.settings.segmentation import SegmentSettings
from tossid.settings.tracking import TrackSettings


@dataclass(frozen=True, kw_only=True)
class CornerSettings:
    """How a tag's corners are measured to a fraction of a pixel (`tossid.vision.detection.corners`)."""

    contrast: Positive = 12.0
    """least difference between black border and white margin [grey levels]"""
    least_sigma: NonNegative = 0.007
    """least standard deviation of a corner [px]; measured on rendered tags"""
    iterations: Count = 12
    """most Gauss-Newton steps"""
    converged: Positive = 5e-3
    """the fit has converged when no edge moves more than this [px]"""
    correlation: Positive = 4.0
    """length along an edge over which the image's errors may be correlated [px]"""
    least_blur: Positive = 0.3
    """smallest standard deviation of the blur, the pixel's own area included [px]"""
    most_blur: Positive = 4.0
    """largest standard deviation of the blur [px]"""


@dataclass(frozen=True, kw_only=True)
class OcclusionSettings:
    """When something is taken to lie against a tag's edge (`tossid.vision.detection.occlusion`)."""

    brightness: Fraction = 0.85
    """least brightness of paper beyond an edge, between the tag's black (0) and what lies beyond its other edges (1)"""
    brightness_small: Fraction = 0.5
    """the same for a small tag, where blur mixes in what lies farther out"""
    small_cell: Positive = 1.5
    """width of a small tag's cell [px]"""
    large_cell: Positive = 3.0
    """width of a cell from which `brightness` holds [px]; in between, in proportion"""
    hidden_share: Fraction = 0.4
    """share of an edge with less brightness beyond it that makes it a hidden one"""
    points: Count = 12
    """places along an edge that are looked at"""


@dataclass(frozen=True, kw_only=True)
class PredictionSettings:
    """Where in a camera's next image the object is searched (`tossid.vision.detection.search_regions`)."""

    velocity_change: NonNegative = 1.0
    """a body's velocity may change by as much as it is, and by this much more, from frame to frame [m/s]"""
    margin: NonNegative = 8.0
    """margin around a tag, for its white border and blur [px]"""
    rms_ratio: Positive = 3.0
    """poses whose rms reprojection is less than this times the best one's (and `rms_slack` more) are possible"""
    rms_slack: NonNegative = 0.3
    """difference of reprojections that decides nothing [px]"""


@dataclass(frozen=True, kw_only=True)
class DetectSettings:
    """How tags are looked for."""

    quad_decimate: Annotated[float, Bounds(low=1)] = 1.0
    """reduction of the image where the object must be"""
    search_decimate: Annotated[float, Bounds(low=1)] = 2.0
    """reduction where it must be looked for in the whole image"""
    predict: bool = True
    """look where the last poses say first; false searches every image whole"""
    refine: bool = True
    """measure corners in the image, to a fraction of a pixel"""
    max_hamming: Annotated[int, Bounds(low=0, high=2)] = 1
    """most corrected bits"""
    min_margin: NonNegative = 12.0
    """least decision margin"""
    unrefined_sigma: Positive = advanced(0.4)
    """standard deviation of a corner as the AprilTag library gives it [px]; measured on rendered tags"""
    border: NonNegative = advanced(2.0)
    """least distance from the image's border of a corner that is not refined [px]; nearer ones are extrapolated"""
    hidden_sigma: NonNegative = advanced(0.5)
    """standard deviation, in cells, of corners at an edge that something lies against, and of a tag whose edges could
    not be fitted"""
    beside_hidden: Fraction = advanced(0.2)
    """share of `hidden_sigma` that the tag's other corners get"""
    fine_search: Count = advanced(4)
    """of this many frames in a row without a tag, one is searched whole at full resolution"""
    batch: Count = advanced(96)
    """frames of one camera that are searched in one go; bounds the memory"""
    corners: CornerSettings = advanced_part(CornerSettings)
    """corners to a fraction of a pixel"""
    occlusion: OcclusionSettings = advanced_part(OcclusionSettings)
    """edges that something lies against"""
    prediction: PredictionSettings = advanced_part(PredictionSettings)
    """where the object is searched"""


@dataclass(frozen=True, kw_only=True)
class TossSettings(Checked):
    """From tracked poses to a dataset of tosses."""

    gravity: Annotated[float, Bounds(above=0, high=LARGEST_GRAVITY)] = 9.81
    """gravity where it was recorded [m/s²]"""
    level: Literal["auto", "session", "always", "never"] = "auto"
    """turn and shift the world so that the ground found from the tosses is z = 0. session: that of each session of the
    recording. auto: that of each session where its tilt changes between sessions; of frames, the whole recording's
    where no fixed tag says where the ground is, and it is off by more than 1 cm or 1 degree. always: of frames, the
    whole recording's whatever it is. Imported tosses that rest farther from z = 0 are shifted, but for never"""
    level_height: Positive = advanced(0.01)
    """height of the ground above z = 0 from which on `level=auto` levels the world, and shifts imported tosses [m]"""
    level_tilt: Positive = advanced(math.radians(1.0))
    """tilt of the ground from which on `level=auto` levels the world [rad]"""
    seed: Seed = 0
    """seed of the draw of splits"""
    splits: tuple[Fraction, Fraction, Fraction] = (0.5, 0.3, 0.2)
    """shares of tosses for train, validation and test"""
    segment: SegmentSettings = field(default_factory=SegmentSettings)
    """frames: what counts as flight and as rest:"""


@dataclass(frozen=True, kw_only=True)
class IngestSettings(TossSettings):
    """From a recording, tracked poses or ready tosses to a dataset."""

    defects: Literal["keep", "set_aside"] = "keep"
    """imported tosses with what neither gravity nor contact explains (rules flight, speed, flip, jolt): set_aside gives
    them no split"""
    smoothed: Literal["refuse", "keep"] = "refuse"
    """imported tosses that a smoother made: they do not fall by gravity, and have no tracker's noise. refuse: an error
    says so. keep: they are ingested nevertheless"""
    turned: Literal["keep", "undo"] = "keep"
    """imported recordings that were turned about the vertical after they were tracked, each by its own angle. undo:
    they are turned back, so that all throws go along x"""
    copies: Literal["keep", "set_aside"] = "keep"
    """imported tosses that are earlier ones turned about the vertical. keep: each goes to the split of its first, so
    that no model is tested on what it was trained on. set_aside: they get no split"""
    lost: Literal["keep", "undo"] = "keep"
    """imported recordings that lost frames at impacts without a gap in their times. undo: what follows a loss is moved
    later by the time of the lost frames, and tosses whose loss cannot be judged get no split"""
    threads: Count | None = None
    """images searched at the same time; null: one a core"""
    detect: DetectSettings = field(default_factory=DetectSettings)
    """frames: how tags are looked for:"""
    track: TrackSettings = field(default_factory=TrackSettings)
    """frames: when a pose is accepted:"""
