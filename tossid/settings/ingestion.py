"""Settings of `tossid.ingest`: how recordings become a dataset of tosses."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from tossid.settings.kinds import Bounds, Checked, Count, Fraction, NonNegative, Seed
from tossid.settings.limits import LARGEST_GRAVITY
from tossid.settings.tracking import TrackSettings


@dataclass(frozen=True, kw_only=True)
class DetectSettings(Checked):
    """How tags are looked for."""

    quad_decimate: Annotated[float, Bounds(low=1)] = 1.0
    """reduction of the image where the object must be"""
    search_decimate: Annotated[float, Bounds(low=1)] = 2.0
    """reduction where it must be looked for in the whole image"""
    predict: bool = True
    """look where the last tags say first; false searches every image whole"""
    refine: bool = True
    """measure corners in the image, to a fraction of a pixel"""
    max_hamming: Annotated[int, Bounds(low=0, high=2)] = 1
    """most corrected bits"""
    min_margin: NonNegative = 12.0
    """least decision margin"""


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
    seed: Seed = 0
    """seed of the draw of splits"""
    splits: tuple[Fraction, Fraction, Fraction] = (0.5, 0.3, 0.2)
    """shares of tosses for train, validation and test"""


@dataclass(frozen=True, kw_only=True)
class IngestSettings(TossSettings):
    """From a recording, tracked poses or ready tosses to a dataset."""

    defects: Literal["keep", "set_aside"] = "keep"
    """imported tosses with what neither gravity nor contact explains (rules flight, speed, flip, jolt): set_aside gives
    them no split"""
    turned: Literal["keep", "undo"] = "keep"
    """imported recordings that were turned about the vertical after they were tracked, each by its own angle. undo:
    they are turned back, so that all throws go along x"""
    copies: Literal["keep", "set_aside"] = "keep"
    """imported tosses that are earlier ones turned about the vertical. keep: each goes to the split of its first, so
    that no model is tested on what it was trained on. set_aside: they get no split"""
    threads: Count | None = None
    """images searched at the same time; null: one a core"""
    detect: DetectSettings = field(default_factory=DetectSettings)
    """frames: how tags are looked for:"""
    track: TrackSettings = field(default_factory=TrackSettings)
    """frames: when a pose is accepted:"""
