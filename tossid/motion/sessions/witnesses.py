"""What each toss says of the world that it was recorded in: gravity, the table, noise.

    fall      direction against which the common centre of mass falls, horizontal components [rad]
    gravity   size of its acceleration [m/s²]
    normal    normal of the faces that links rest on, horizontal components [rad]
    slope     normal of the plane through contact points, horizontal components [rad]
    height    of the faces that the object rests on, above z = 0 [m]
    noise     logarithms of the noise of positions [m] and orientations [rad]

None needs a simulator. The three tilts (`TILTS`) share nothing but the recorded poses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from tossid.motion.contact import lowest_corner
from tossid.motion.flight import first_parabola
from tossid.motion.kinematics import center_of_mass
from tossid.motion.noise import scatter
from tossid.motion.resting import resting_pose
from tossid.objects import GRAVITY, ObjectModel, body_poses, corner_positions
from tossid.rotations import quat_boxminus, quat_rotate
from tossid.types import PoseTrack

Array = NDArray[np.float64]
Seen = dict[str, tuple[Array, Array]]
"""By witness: its components (d,), and their information, the inverse of their covariance (d, d)."""

COLUMNS = {
    "fall": ("fall_x", "fall_y"),
    "gravity": ("gravity",),
    "normal": ("normal_x", "normal_y"),
    "slope": ("slope_x", "slope_y"),
    "height": ("height",),
    "noise": ("noise_position", "noise_angle"),
}
"""Witnesses, and the names of their components."""
TILTS = ("fall", "normal", "slope")
"""Witnesses that say how the recorded world is tilted."""

CLEAR_HEIGHT = 0.03
"""Height of the lowest stated corner above which nothing touches [m]."""
FEWEST_FLIGHT = 10
"""Frames of flight from the release on that a parabola is fitted to."""
FEWEST_FALLING = 5
"""Frames of flight that show whether a toss falls by gravity at all: films may have few frames a second."""
FALL_ERROR = 0.1
"""Share of gravity by which tosses may fall otherwise; the published recordings have 0.01 to 0.08 in the median."""
FLAT = np.deg2rad(8.0)
"""A face that points down within this angle is one that a link rests on [rad]."""
FACE_ERROR = 0.01
"""Standard deviation of a resting face's normal, which its own errors set and not the noise [rad]."""
CONTACT_HEIGHT = 0.02
"""A corner that turns back less than this above the toss's lowest one has touched the ground [m]."""
CONTACT_ERROR = 0.002
"""Standard deviation of a contact point's height: corners turn back between frames [m]."""
SAME_POINT = 0.01
"""Contact points nearer than this are one [m]."""

Face = tuple[int, Array, NDArray[np.int64]]
"""A link, the outward normal of one of its faces in its own axes, and the face's corners (indices)."""


@dataclass(frozen=True, eq=False)
class Witnesses:
    """What tosses say of their recording, toss by toss.

    Attributes:
        values: By witness, its components, (n, d); NaN where a toss does not have it.
        info: By witness, the inverse of the covariance of its own error, (n, d, d); 0 where a toss does not have it.
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
    faces, seen = link_faces(model), list[Seen]()
    places, speeds, lows = list[Array](), list[Array](), list[Array]()
    for track in tracks:
        corners, com = corner_positions(model, track.q), center_of_mass(model, track.q)
        low = corners[..., 2].min(axis=1)
        fall = fall_of(track.t, com, low)
        speeds.append(fall.pop("speed", (np.full(2, np.nan),))[0])
        seen.append({**fall, **_rest(track, model, faces), **_contacts(corners, low), **_noise(com, track.q)})
        places.append(track.q[-1, :2])
        lows.append(low[-2:])
        advance(1)
    values, info = {}, {}
    for name, components in COLUMNS.items():
        nothing = np.full(len(components), np.nan), np.zeros((len(components), len(components)))
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
        "fall": (-acceleration[:2] / size, np.eye(2) * (size / sigma) ** 2),
        "gravity": (np.array([size]), np.eye(1) / sigma**2),
        "speed": (velocity[:2], np.eye(2)),
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
    seen = [(fall["gravity"][0][0], fall["gravity"][1][0, 0] ** -0.5) for fall in falls if fall]
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


def _rest(track: PoseTrack, model: ObjectModel, faces: list[Face]) -> Seen:
    """The faces that links rest on at a toss's end: their mean normal, and the height of the lowest."""
    resting = resting_faces(track, model, faces)
    if not len(resting):
        return {}
    return {
        "normal": (resting[:, :2].mean(axis=0), np.eye(2) * len(resting) / FACE_ERROR**2),
        "height": (resting[:, 2].min()[None], np.eye(1) / CONTACT_ERROR**2),
    }


def resting_faces(track: PoseTrack, model: ObjectModel, faces: list[Face]) -> Array:
    """Of each link that rests on a face at a toss's end, the normal's horizontal components and the height, (k, 3).

    Args:
        track: Of a toss.
        model: The object.
        faces: Of its links, see `link_faces`.
    """
    pose = resting_pose(track) if faces else None
    if pose is None:
        return np.zeros((0, 3))
    quat, at = body_poses(model, pose)[1], corner_positions(model, pose)
    found = []
    for link in range(model.n_bodies):
        own = [face for face in faces if face[0] == link]
        if not own:
            continue
        ups = -quat_rotate(quat[link], np.array([normal for _, normal, _ in own]))
        best = int(np.argmax(ups[:, 2]))
        if ups[best, 2] > np.cos(FLAT):
            found.append([*ups[best, :2], at[own[best][2], 2].mean()])
    return np.array(found).reshape(-1, 3)


def _contacts(corners: Array, low: Array) -> Seen:
    """The slope of the ground between the points at which the lowest corner turns back."""
    points = contact_points(corners, low)
    if len(points) < 2:
        return {}
    off = points - points.mean(axis=0)
    info = off[:, :2].T @ off[:, :2] / CONTACT_ERROR**2
    # slopes that two points do not show are taken as near 0
    slope = np.linalg.solve(info + np.eye(2) / FLAT**2, off[:, :2].T @ off[:, 2] / CONTACT_ERROR**2)
    return {"slope": (-slope, info)}


def contact_points(corners: Array, low: Array) -> Array:
    """Where the lowest corner touched the ground, (k, 3), from the last to the first; one of points near each other.

    An impact lies between two frames: its height is where the lines through the two frames before it and after it meet.

    Args:
        corners: Of a toss, (n, n_c, 3) [m].
        low: Height of the lowest one, (n,) [m].
    """
    turns = np.flatnonzero((low[1:-1] <= low[:-2]) & (low[1:-1] < low[2:])) + 1
    turns = np.append(turns, len(low) - 1)
    points: list[Array] = []
    for turn in turns[low[turns] - low.min() < CONTACT_HEIGHT][::-1]:
        corner = int(np.argmin(corners[turn, :, 2]))
        point = corners[turn, corner].copy()
        if 2 <= turn < len(low) - 2:
            z = corners[turn - 2 : turn + 3, corner, 2]
            before, after = z[1] - z[0], z[4] - z[3]
            if before < 0 < after:
                met = (z[3] - 2 * after - z[1]) / (before - after)
                if 0 <= met <= 2:
                    point[2] = min(point[2], z[1] + before * met)
        if all(np.linalg.norm(point[:2] - other[:2]) > SAME_POINT for other in points):
            points.append(point)
    return np.array(points).reshape(-1, 3)


def _noise(com: Array, q: Array) -> Seen:
    """Noise from third differences, of the common centre of mass and of the base's orientation."""
    if len(q) < 8:
        return {}
    position = scatter(np.diff(com, n=3, axis=0))
    angle = scatter(np.diff(quat_boxminus(q[1:, 3:7], q[:-1, 3:7]), n=2, axis=0))
    return {"noise": (np.log(np.array([position, angle]) + 1e-9), np.eye(2))}


def link_faces(model: ObjectModel) -> list[Face]:
    """The faces of each link's convex hull; none of links that have no volume.

    Args:
        model: The object.
    """
    faces: list[Face] = []
    for link in range(model.n_bodies):
        own = np.flatnonzero(model.corner_body == link)
        if len(own) < 4 or model.roundness is not None:
            continue
        try:
            hull = ConvexHull(model.corner_pos[own])
        except QhullError:
            continue
        for plane in np.unique(np.round(hull.equations, 6), axis=0):
            on = np.abs(model.corner_pos[own] @ plane[:3] + plane[3]) < 1e-4 * model.width
            faces.append((link, plane[:3], own[on]))
    return faces
