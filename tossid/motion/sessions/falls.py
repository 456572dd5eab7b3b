"""Whether tosses fall by gravity; if not, whether a smoother made them, or what times or lengths would have to be.

Two signs of a smoother, neither of which needs the object's shape, and which only together are enough:

- Tosses do not fall. Over `FALL_TIME`, somewhere in a toss, a tossed object's centre of mass accelerates by gravity. A
  toss counts if it comes down by more than ½ g (w h)², with w frames of h seconds to a window: a fall from rest over
  that height holds w frames of flight. A smoother whose window is as long as a flight mixes it with contact.
- Their noise is correlated. Third and fourth differences of white noise have variances 20 and 70 sigma², a ratio of
  1.87 between their sizes; those of a smooth curve get smaller with every difference. Resting frames are left out.

Simulated tosses without noise are as smooth, but fall. An object that was only pushed or tipped over does not fall, but
its tracker's noise is white.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tossid.motion.contact import lowest_corner
from tossid.motion.flight import fit_polynomial
from tossid.motion.kinematics import center_of_mass
from tossid.motion.segmentation import segment
from tossid.motion.sessions.witnesses import fall_of
from tossid.objects import GRAVITY, ObjectModel
from tossid.settings.segmentation import SegmentSettings
from tossid.types import LongTrack, PoseTrack

Array = NDArray[np.float64]

FEWEST_FLIGHT = 5
"""Frames of flight that show an acceleration: films may have few frames a second."""
FALL_ERROR = 0.1
"""Share of gravity by which tosses may fall otherwise; the published recordings have 0.01 to 0.08 in the median."""
FEWEST_TOSSES = 2
"""Tosses from which on they are judged, or other times proposed: one may be a hand's motion."""

# other times
SCALES = 1.4 ** np.arange(-7.0, 8.0)
"""Factors of times that are tried; segmentation sees flight in times that are 0.85 to 1.3 times too long."""
RATES_HZ = (15.0, 1000.0)
"""Rates to which they may lead: fewer frames show no flight, and more are rare and take long."""
MOST_POSES = 20_000
"""So many of a track are tried; they hold a few minutes."""

# a smoother
FALL_TIME, FALL_FRAMES = 0.1, 4
"""Shortest stretch over which a toss's acceleration is looked at [s], and its fewest frames."""
ROUGHNESS, WHITE = 1.0, float(np.sqrt(70.0 / 20.0))
"""Size of fourth over third differences below which noise is no tracker's, and that of white noise."""
FEWEST_DIFFERENCES = 30
"""Numbers from which it is estimated."""
MOVING_SPEED = 0.1
"""Speed above which a frame counts for it [m/s]; filters rest where the object does."""
UNEVEN = 0.02
"""Largest difference of a frame's time step from the median, relative; others do not count for it."""


@dataclass(frozen=True)
class Smoothing:
    """How measured tosses look.

    Attributes:
        fall_error: How far the acceleration nearest to free fall is from it [m/s²], median over tosses; NaN where no
            toss comes down far enough.
        n_falls: Tosses that do.
        roughness: Size of fourth over third differences of positions in motion, median over frames; 1.87 for white
            noise, NaN where there are too few frames in a row.
        falls: Whether they fall, or too few come down far enough to tell.
        smoothed: Whether they do not, and are smoother than measurements are.
    """

    fall_error: float
    n_falls: int
    roughness: float
    falls: bool
    smoothed: bool


def look_for_smoothing(tracks: Sequence[PoseTrack], model: ObjectModel, *, gravity: float = GRAVITY) -> Smoothing:
    """Whether tosses fall, and whether their poses have a tracker's noise.

    Args:
        tracks: As recorded, z roughly up.
        model: The object; its common centre of mass is looked at.
        gravity: Where they were recorded [m/s²].

    Returns:
        Both signs, and what follows from them.
    """
    errors, third, fourth = [], [np.zeros(0)], [np.zeros(0)]
    for track in tracks:
        com = center_of_mass(model, track.q)
        error = _fall_error(track.t, com, gravity)
        if error is not None:
            errors.append(error)
        step = np.diff(track.t)
        good = np.abs(step - np.median(step)) < UNEVEN * np.median(step)
        good &= np.linalg.norm(np.diff(com, axis=0), axis=1) > MOVING_SPEED * step
        if len(good) >= 4:
            for order, found in ((3, third), (4, fourth)):
                in_a_row = sliding_window_view(good, order).all(axis=1)
                found.append(np.abs(np.diff(com, n=order, axis=0)[in_a_row]).ravel())
    fall_error = float(np.median(errors)) if errors else float("nan")
    size = [np.concatenate(parts) for parts in (third, fourth)]
    # noise-free rest in motion's place has differences of exactly 0
    enough = min(len(part) for part in size) >= FEWEST_DIFFERENCES and np.median(size[0]) > 0
    roughness = float(np.median(size[1]) / np.median(size[0])) if enough else float("nan")
    falls = not (len(errors) >= FEWEST_TOSSES and fall_error > FALL_ERROR * gravity)
    return Smoothing(fall_error, len(errors), roughness, falls, bool(not falls and roughness < ROUGHNESS))


def _fall_error(t: Array, com: Array, gravity: float) -> float | None:
    """Of all windows of a toss, the least distance of acceleration from free fall [m/s²]; None if it needs no fall."""
    step = float(np.median(np.diff(t)))
    width = max(FALL_FRAMES, int(np.ceil(FALL_TIME / step - 1e-3)) + 1)
    drop = float(np.max(np.maximum.accumulate(com[:, 2]) - com[:, 2]))
    if len(t) < width or drop < 0.5 * gravity * (width * step) ** 2:
        return None
    times = sliding_window_view(t, width)
    windows = sliding_window_view(com, width, axis=0).mT
    acceleration = fit_polynomial(times - times.mean(axis=1, keepdims=True), windows).coefficients[:, 2]
    return float(np.linalg.norm(acceleration + np.array([0.0, 0.0, gravity]), axis=1).min())


def fall_words(tracks: Sequence[PoseTrack], model: ObjectModel, *, gravity: float = GRAVITY) -> str | None:
    """That tracked tosses do not fall by gravity, in words, with what usually is the cause, and by which factor.

    Args:
        tracks: One a toss, from the release on, z roughly up.
        model: The object.
        gravity: Where they were recorded [m/s²].

    Returns:
        The words; None where they do fall, in the median, or where too little of them is flight.
    """
    seen = _falls(tracks, model)
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
    poses: PoseTrack | LongTrack, model: ObjectModel, *, gravity: float = GRAVITY, segments: SegmentSettings
) -> str | None:
    """The rate at which a track without tosses would have some, in words: that of a film in slow motion, for example.

    Args:
        poses: The track.
        model: The object.
        gravity: Where it was recorded [m/s²].
        segments: What is a toss.

    Returns:
        The words; None where there is no such rate.
    """
    count, factor = 0, 1.0
    part = poses.frames(slice(0, MOST_POSES))
    rate = 1 / float(np.median(np.diff(part.t)))
    for scale in SCALES[(rate / SCALES >= RATES_HZ[0]) & (rate / SCALES <= RATES_HZ[1])]:
        tracks, _ = segment(replace(part, t=scale * part.t), model, gravity=gravity, settings=segments)
        seen = _falls(tracks, model)
        if len(seen) >= max(FEWEST_TOSSES, count + 1):
            count, factor = len(seen), float(np.sqrt(gravity / np.median(seen[:, 0])) / scale)
    if not count:
        return None
    times = "is it a film in slow motion (source.rate_hz is its true rate)" if factor > 1 else "are its times right"
    return (
        f"with a rate {factor:.3g} times as high, {count} tosses fall by gravity: {times}, or are the tags "
        f"{factor**2:.3g} times as large as stated?"
    )


def _falls(tracks: Sequence[PoseTrack], model: ObjectModel) -> Array:
    """Acceleration in flight and its standard deviation [m/s²] of each toss that shows it, (n, 2)."""
    falls = [
        fall_of(track.t, center_of_mass(model, track.q), lowest_corner(model, track.q), fewest=FEWEST_FLIGHT)
        for track in tracks
    ]
    seen = [(fall["gravity"][0][0], fall["gravity"][1][0, 0] ** -0.5) for fall in falls if fall]
    return np.array(seen).reshape(-1, 2)
