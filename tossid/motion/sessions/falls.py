"""Whether tosses fall by gravity, and if not, what times or lengths would have to be for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tossid.motion.segmentation import segment
from tossid.motion.sessions.witnesses import fall_of
from tossid.objects import GRAVITY, ObjectModel, corner_positions
from tossid.settings.segmentation import SegmentSettings
from tossid.settings.sessions import WitnessSettings
from tossid.types import LongTrack, PoseTrack

Array = NDArray[np.float64]

FALL = WitnessSettings(fewest_flight=5)
"""Films may have few frames a second."""
FALL_ERROR = 0.1
"""Share of gravity by which tosses may fall otherwise before times or lengths are taken to be wrong."""
SCALES = 1.4 ** np.arange(-7.0, 8.0)
"""Factors of times that are tried; segmentation sees flight in times that are 0.85 to 1.3 times too long."""
RATES_HZ = (15.0, 1000.0)
"""Rates to which they may lead: fewer frames show no flight, and more are rare and take long."""
MOST_POSES = 20_000
"""So many of a track are tried; they hold a few minutes."""
FEWEST_TOSSES = 2
"""Tosses from which on other times are proposed: one may be a hand's motion."""


def fall_words(
    tracks: Sequence[PoseTrack],
    model: ObjectModel,
    *,
    gravity: float = GRAVITY,
    settings: WitnessSettings = FALL,
) -> str | None:
    """That tracked tosses do not fall by gravity, in words, with what usually is the cause, and by which factor.

    Args:
        tracks: One a toss, from the release on, z roughly up.
        model: The object.
        gravity: Where they were recorded [m/s²].
        settings: What counts as flight.

    Returns:
        The words; None where they do fall, in the median, or where too little of them is flight.
    """
    seen = _falls(tracks, model, settings)
    if not len(seen):
        return None
    size, sigma = np.median(seen, axis=0)
    error = 1.25 * sigma / np.sqrt(len(seen))  # a median's standard error is a quarter larger than a mean's
    if abs(size - gravity) < max(FALL_ERROR * gravity, 3.0 * error):
        return None
    factor = gravity / size
    return (
        f"tosses fall with {size:.2f} m/s² (median of {len(seen)}), not with {gravity:g}: are the frames' times right "
        f"(a rate {factor**0.5:.3g} times as high explains it), is the size of the tags ({factor:.3g} times as large "
        f"does so too), is gravity={gravity:g}?"
    )


def rate_words(
    poses: PoseTrack | LongTrack,
    model: ObjectModel,
    *,
    gravity: float = GRAVITY,
    segments: SegmentSettings,
    settings: WitnessSettings = FALL,
) -> str | None:
    """The rate at which a track without tosses would have some, in words: that of a film in slow motion, for example.

    Args:
        poses: The track.
        model: The object.
        gravity: Where it was recorded [m/s²].
        segments: What is a toss.
        settings: What counts as flight.

    Returns:
        The words; None where there is no such rate.
    """
    best = 0, 1.0
    part = poses.frames(slice(0, MOST_POSES))
    rate = 1 / float(np.median(np.diff(part.t)))
    for scale in SCALES[(rate / SCALES >= RATES_HZ[0]) & (rate / SCALES <= RATES_HZ[1])]:
        tracks, _ = segment(replace(part, t=scale * part.t), model, gravity=gravity, settings=segments)
        seen = _falls(tracks, model, settings)
        if len(seen) >= max(FEWEST_TOSSES, best[0] + 1):
            best = len(seen), float(np.sqrt(gravity / np.median(seen[:, 0])) / scale)
    count, factor = best
    if not count:
        return None
    times = "is it a film in slow motion (source.rate_hz is its true rate)" if factor > 1 else "are its times right"
    return (
        f"with a rate {factor:.3g} times as high, {count} tosses fall by gravity: {times}, or are the tags "
        f"{factor**2:.3g} times as large as stated?"
    )


def _falls(tracks: Sequence[PoseTrack], model: ObjectModel, settings: WitnessSettings) -> Array:
    """Acceleration in flight and its standard deviation [m/s²] of each toss that shows it, (n, 2)."""
    falls = [
        fall_of(track, model, corner_positions(model, track.q)[..., 2].min(axis=1), settings=settings)
        for track in tracks
    ]
    seen = [(fall["gravity"][0][0], fall["gravity"][1][0, 0] ** -0.5) for fall in falls if fall]
    return np.array(seen).reshape(-1, 2)
