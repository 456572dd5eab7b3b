"""What each toss says of the world that it was recorded in: gravity, the table, noise.

    fall      direction against which the common centre of mass falls, horizontal components [rad]
    gravity   size of its acceleration [m/s²]
    normal    normal of the plane that the object stands on, horizontal components [rad]
    height    of that plane above z = 0 [m]
    noise     logarithms of the noise of positions [m] and orientations [rad]

None needs a simulator. The two tilts (`TILTS`) share nothing but the recorded poses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.motion.contact import lowest_corner
from tossid.motion.flight import first_parabola
from tossid.motion.kinematics import center_of_mass
from tossid.motion.noise import scatter
from tossid.motion.resting import support_plane
from tossid.objects import GRAVITY, ObjectModel
from tossid.rotations import quat_boxminus
from tossid.types import PoseTrack

Array = NDArray[np.float64]
Seen = dict[str, tuple[Array, float]]
"""By witness: its components (d,), and the inverse of the variance of each."""

COLUMNS = {
    "fall": ("fall_x", "fall_y"),
    "gravity": ("gravity",),
    "normal": ("normal_x", "normal_y"),
    "height": ("height",),
    "noise": ("noise_position", "noise_angle"),
}
"""Witnesses, and the names of their components."""
TILTS = ("fall", "normal")
"""Witnesses that say how the recorded world is tilted."""

CLEAR_HEIGHT = 0.03
"""Height of the lowest stated corner above which nothing touches [m]."""
FEWEST_FLIGHT = 10
"""Frames of flight from the release on that a parabola is fitted to."""
FEWEST_FALLING = 5
"""Frames of flight that show whether a toss falls by gravity at all: films may have few frames a second."""
FALL_ERROR = 0.1
"""Share of gravity by which tosses may fall otherwise; the published recordings have 0.01 to 0.08 in the median."""
NORMAL_ERROR, HEIGHT_ERROR = 0.01, 0.002
"""Standard deviations of the normal [rad] and height [m] of the plane that an object stands on: errors of its stated
corners set them, and not the noise."""


@dataclass(frozen=True, eq=False)
class Witnesses:
    """What tosses say of their recording, toss by toss.

    Attributes:
        values: By witness, its components, (n, d); NaN where a toss does not have it.
        info: By witness, the inverse of the variance of its own error, (n,); 0 where a toss does not have it.
        places: Where tosses end, x and y [m], (n, 2).
        speeds: Horizontal velocity in flight [m/s], (n, 2); NaN where a toss has no flight.
        last_low: Heights of the lowest stated corner in the last frame but one, and in the last [m], (n, 2).
    """

    values: dict[str, Array]
    info: dict[str, Array]
    places: Array
    speeds: Array
    last_low: Array


def toss_witnesses(
    tracks: Sequence[PoseTrack],
    model: ObjectModel,
    *,
    advance: Callable[[int], None] = lambda count: None,
) -> Witnesses:
    """What each of many tosses says of its recording.

    Args:
        tracks: As recorded, z roughly up.
        model: The object.
        advance: Called after each toss.
    """
    seen, places, speeds, lows = list[Seen](), list[Array](), list[Array](), list[Array]()
    for track in tracks:
        com, low = center_of_mass(model, track.q), lowest_corner(model, track.q)
        fall = fall_of(track.t, com, low)
        speeds.append(fall.pop("speed", (np.full(2, np.nan), 0.0))[0])
        seen.append({**fall, **_rest(track, model), **_noise(com, track.q)})
        places.append(track.q[-1, :2])
        lows.append(low[-2:])
        advance(1)
    values, info = {}, {}
    for name, components in COLUMNS.items():
        nothing = np.full(len(components), np.nan), 0.0
        values[name], info[name] = map(np.array, zip(*(one.get(name, nothing) for one in seen), strict=True))
    return Witnesses(values, info, np.array(places), np.array(speeds), np.array(lows))


def fall_of(t: Array, com: Array, low: Array, *, fewest: int = FEWEST_FLIGHT) -> Seen:
    """A parabola through the common centre of mass, from the release until a corner is near the ground.

    Args:
        t: Times of a toss [s], (n,).
        com: The centre of mass [m], (n, 3).
        low: Height of the lowest corner [m], (n,).
        fewest: Frames of flight that it takes.

    Returns:
        Direction and size of the acceleration, and horizontal velocity; nothing where it does not fall long enough.
    """
    fit = first_parabola(t, com, low - low.min() > CLEAR_HEIGHT, fewest)
    if fit is None:
        return {}
    _, velocity, acceleration = fit.coefficients
    size = float(np.linalg.norm(acceleration))
    sigma = float((fit.noise + 1e-7) * np.sqrt(fit.unit_cov[2, 2]))
    if acceleration[2] > -0.5 * size:
        return {}
    return {
        "fall": (-acceleration[:2] / size, (size / sigma) ** 2),
        "gravity": (np.array([size]), sigma**-2),
        "speed": (velocity[:2], 1.0),
    }


def fall_words(tracks: Sequence[PoseTrack], model: ObjectModel, *, gravity: float = GRAVITY) -> str | None:
    """That tosses do not fall by gravity, in words, with what usually is the cause, and by which factor.

    Args:
        tracks: One a toss, from the release on, z roughly up.
        model: The object.
        gravity: Where they were recorded [m/s²].

    Returns:
        The words; None where they do fall, in the median, or where too little of them is flight.
    """
    falls = [
        fall_of(track.t, center_of_mass(model, track.q), lowest_corner(model, track.q), fewest=FEWEST_FALLING)
        for track in tracks
    ]
    seen = [(fall["gravity"][0][0], fall["gravity"][1] ** -0.5) for fall in falls if fall]
    if not seen:
        return None
    size, sigma = np.median(seen, axis=0)
    error = 1.25 * sigma / np.sqrt(len(seen))  # a median's standard error is a quarter larger than a mean's
    if abs(size - gravity) < max(FALL_ERROR * gravity, 3.0 * error):
        return None
    factor = gravity / size
    return (
        f"tosses fall with {size:.2f} m/s² (median of {len(seen)}), not with {gravity:g}: are the times right (a rate "
        f"{factor**0.5:.3g} times as high explains it), is the unit of length or the size of the tags ({factor:.3g} "
        f"times as large does so too), is gravity={gravity:g}, or did a smoother make the poses?"
    )


def _rest(track: PoseTrack, model: ObjectModel) -> Seen:
    """The normal of the plane that the object stands on at a toss's end, and its height."""
    plane = support_plane(track, model)
    if plane is None:
        return {}
    return {
        "normal": (plane.normal, NORMAL_ERROR**-2),
        "height": (np.array([plane.height]), HEIGHT_ERROR**-2),
    }


def _noise(com: Array, q: Array) -> Seen:
    """Noise from third differences, of the common centre of mass and of the base's orientation."""
    if len(q) < 8:
        return {}
    position = scatter(np.diff(com, n=3, axis=0))
    angle = scatter(np.diff(quat_boxminus(q[1:, 3:7], q[:-1, 3:7]), n=2, axis=0))
    return {"noise": (np.log(np.array([position, angle]) + 1e-9), 1.0)}
