"""Settings of the figures of trainings, evaluations and studies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from tossid.settings.kinds import Bounds, Count, Fraction, Positive


@dataclass(frozen=True, kw_only=True)
class FigureSettings:
    """What the figures draw, and from when on they draw it otherwise."""

    film_size: tuple[Count, Count] = (480, 360)
    """width and height of a film [px]"""
    film_stride: Count = 2
    """every so many-th frame of a toss is in its film"""
    hull_pictures: Count = 24
    """most pictures in the film of a hull over tosses"""
    hull_reach: Positive = 1.6
    """half the edge of what it shows, over the largest distance of a corner from the middle along an axis"""
    poses: Annotated[int, Bounds(low=2)] = 7
    """poses in the film strip of a toss"""
    log_ratio: Positive = 20.0
    """errors are drawn on a logarithmic axis if the largest is beyond so many times the largest median"""
    named_outliers: Count = 5
    """most outliers of a model that are named"""
    fewest_for_band: Count = 5
    """with fewer tosses, each is drawn by itself instead of a band"""
    highest_band: Positive = 2.5
    """multiple of the largest mean error at which the axis cuts bands off"""
    fewest_share: Fraction = 0.25
    """times at which fewer than this share of the tosses (or fewer than two) are under way are not drawn"""
    shift_share: Positive = 0.15
    """shifts of corners are exaggerated until the largest is about this share of the object's width"""
    reached_inertia: Positive = 0.05
    """relative error of the inertia below which a start has reached the truth"""
    reached_com_m: Positive = 1e-3
    """error of the centre of mass below which a start has reached the truth [m]"""
    ground_gap: Positive = 2.0
    """standard deviations of the corners' heights within which a corner counts as on the ground"""
    least_gib: Positive = 0.125
    """where the axis of memory begins [GiB]"""
