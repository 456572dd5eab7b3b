"""Settings of a diagnosis's report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from tossid.settings.kinds import Bounds, Count, Fraction, NonNegative, Positive, Range


@dataclass(frozen=True, kw_only=True)
class ReportSettings:
    """What the figures of a diagnosis draw, and what its sentences name."""

    main_share: Fraction = 0.1
    """share of the gap above which a phase or a channel is named in the first sentences"""
    noisier: Positive = 1.1
    """measured noise over the stated one from which the first sentences speak of it"""
    misspecified: NonNegative = 0.05
    """what the diagnosis itself adds to the noise floor, as a share, from which the last sentences speak of it"""

    time_bin: Positive = 0.02
    """width of a cell in the figure over time [s]"""
    palest_excess: Positive = 0.3
    """excess deviance per frame at which the colours of the figure over time begin"""
    least_share: NonNegative = 0.1
    """remaining share of the original gap below which the shares of the remainder get no interval"""
    phase_line_frames: Fraction = 0.05
    """a phase's mean over time is drawn where at least this share of the tosses is in the phase, and three tosses"""
    named_corners: Annotated[int, Bounds(low=1, high=26)] = 12
    """corners that get a letter; of more corners, those with the largest shares of the gap"""
    azimuth_deg: float = -68.0
    """direction from which the object is seen in the figure of corners: angle about z [deg]"""
    elevation_deg: float = 22.0
    """direction from which the object is seen in the figure of corners: angle over the horizon [deg]"""
    percentiles: Range = (2.0, 98.0)
    """percentiles of the residual wrenches between which they are drawn"""
    wrench_bins: Count = 6
    """groups of equally many windows whose mean residual wrench is drawn"""
    label_letters: Count = 32
    """longest heading with the names of the effects; beyond it their number stands there"""
