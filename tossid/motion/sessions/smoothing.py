"""Whether tosses were measured, or are what a smoother made of measurements.

Two signs, neither of which needs the object's shape, and which only together are enough:

- They do not fall. Over `fall_time`, somewhere in a toss, a tossed object's centre of mass accelerates by gravity. A
  toss counts if it comes down by more than ½ g (w h)², with w frames of h seconds to a window: a fall from rest over
  that height holds w frames of flight. A smoother whose window is as long as a flight mixes it with contact.
- Their noise is correlated. Third and fourth differences of white noise have variances 20 and 70 sigma², a ratio of
  1.87 between their sizes; those of a smooth curve get smaller with every difference. Resting frames are left out.

Simulated tosses without noise are as smooth, but fall. An object that was only pushed or tipped over does not fall, but
its tracker's noise is white.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tossid.motion.stability import center_of_mass
from tossid.objects import GRAVITY, ObjectModel
from tossid.settings.sessions import SmoothingSettings
from tossid.types import PoseTrack

Array = NDArray[np.float64]

DEFAULT = SmoothingSettings()
WHITE = float(np.sqrt(70.0 / 20.0))
"""Size of the fourth differences of white noise over that of its third ones."""


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


def look_for_smoothing(
    tracks: Sequence[PoseTrack],
    model: ObjectModel,
    *,
    gravity: float = GRAVITY,
    settings: SmoothingSettings = DEFAULT,
) -> Smoothing:
    """Whether tosses fall, and whether their poses have a tracker's noise.

    Args:
        tracks: As recorded, z roughly up.
        model: The object; its common centre of mass is looked at.
        gravity: Where they were recorded [m/s²].
        settings: What counts as a fall, and what as smooth.

    Returns:
        Both signs, and what follows from them.
    """
    errors, third, fourth = [], [np.zeros(0)], [np.zeros(0)]
    for track in tracks:
        com = center_of_mass(model, track.q)
        error = _fall_error(track.t, com, gravity, settings)
        if error is not None:
            errors.append(error)
        a, b = _differences(track.t, com, settings)
        third.append(a)
        fourth.append(b)
    fall_error = float(np.median(errors)) if errors else float("nan")
    size = [np.abs(np.concatenate(parts)) for parts in (third, fourth)]
    enough = min(len(part) for part in size) >= settings.fewest_differences
    # noise-free rest in motion's place has differences of exactly 0
    roughness = float(np.median(size[1]) / np.median(size[0])) if enough and np.median(size[0]) > 0 else float("nan")
    falls = not (len(errors) >= settings.fewest_falls and fall_error > settings.fall_error * gravity)
    return Smoothing(fall_error, len(errors), roughness, falls, bool(not falls and roughness < settings.roughness))


def _fall_error(t: Array, com: Array, gravity: float, settings: SmoothingSettings) -> float | None:
    """Of all windows of a toss, the least distance of acceleration from free fall [m/s²]; None if it needs no fall."""
    step = float(np.median(np.diff(t)))
    width = max(settings.fewest_frames, int(np.ceil(settings.fall_time / step - 1e-3)) + 1)
    drop = float(np.max(np.maximum.accumulate(com[:, 2]) - com[:, 2]))
    if len(t) < width or drop < 0.5 * gravity * (width * step) ** 2:
        return None
    times = sliding_window_view(t, width)
    s = times - times.mean(axis=1, keepdims=True)
    basis = np.stack([np.ones_like(s), s, 0.5 * s**2], axis=-1)
    windows = np.swapaxes(sliding_window_view(com, width, axis=0), 1, 2)
    acceleration = (np.linalg.pinv(basis) @ windows)[:, 2]
    return float(np.linalg.norm(acceleration + np.array([0.0, 0.0, gravity]), axis=1).min())


def _differences(t: Array, com: Array, settings: SmoothingSettings) -> tuple[Array, Array]:
    """Third and fourth differences of positions, of frames that follow each other evenly while the object moves."""
    step = np.diff(t)
    good = np.abs(step - np.median(step)) < settings.uneven * np.median(step)
    good &= np.linalg.norm(np.diff(com, axis=0), axis=1) > settings.moving_speed * step
    found = []
    for order in (3, 4):
        if len(good) < order:
            return np.zeros(0), np.zeros(0)
        found.append(np.diff(com, n=order, axis=0)[sliding_window_view(good, order).all(axis=1)].ravel())
    return found[0], found[1]
