"""Settings of tracking: how tag corners become poses with covariances (`tossid.vision.pose_graph`)."""

from __future__ import annotations

from dataclasses import dataclass

from tossid.settings.kinds import Count, NonNegative, Positive, advanced_part


@dataclass(frozen=True, kw_only=True)
class StreamSettings:
    """How much of a recording is tracked at once; bounds the memory."""

    piece: Positive = 20.0
    """length of a piece of a recording whose cameras and tags are known [s]"""
    disorder: NonNegative = 2.0
    """detections come in order of time to within this [s]"""
    border: Positive = 0.5
    """a piece ends at the widest gap between frames within this of its full length [s]"""
    whole_frames: Count = 4000
    """frames up to which a recording is tracked as a whole where something static, or a clock, is to be found"""
    stretches: Count = 20
    """of a longer one, so many stretches calibrate what is static"""
    stretch_frames: Count = 200
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
    stream: StreamSettings = advanced_part(StreamSettings)
    """long recordings"""
