"""Objects that lie still: how stable they are, how high the ground is, and errors of tracking that do not change.

Nothing in flight shows the order in which quaternions are written, where the body's frame is at its centre of mass: any
permutation of their parts turns as evenly. But what lies on the ground lies on a face, whose corners are equally high.

A tracker's calibration, or uneven ground, shifts and tilts an object that lies flat by another amount in every place
and on every face. The noise of single frames does not show this.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks
from scipy.spatial import ConvexHull
from scipy.stats import median_abs_deviation

from tossid.motion.kinematics import center_of_mass
from tossid.objects import ObjectModel, corner_heights, corner_positions
from tossid.rotations import (
    geodesic_angle,
    quat_conj,
    quat_continuous,
    quat_normalize,
    quat_rotate,
    wxyz_to_xyzw,
    xyzw_to_wxyz,
)
from tossid.types import PoseTrack, Toss

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

TOUCHING_REL = 0.05
"""How much higher than the lowest corner others are that touch, in widths of the object."""
HALF_TURN = np.deg2rad(179.5)
"""A body falls over where touching corners leave a wider gap about the centre of mass, seen from above [rad]."""
FLAT = np.deg2rad(8.0)
"""A facet that points down within this angle is one that an object stands on [rad]."""
REST_FRAMES = 8
"""Last frames of a toss in which an object has to lie still."""
REST_DISTANCE, REST_ANGLE = 1e-3, 0.02
"""It lies still within this [m] and this, joints too [rad]."""
LOOSELY = 5.0
"""Factor on both where a tracker's noise may be larger than the motion of what lies still."""
BOUNCE_RISE = 0.01
"""What a centre of mass falls before a bounce and rises after it, at least [m]."""

# the order of quaternions
MOST_RESTS = 200
"""Places of rest that are looked at."""
SAME_FACE = np.deg2rad(3.0)
"""Two rests whose downward directions in the body differ by less are on one face."""
FEWEST_ALIKE = 4
"""Rests of an unknown object from which on it can be said that they share faces."""
MOST_FLAT = 0.7
"""Share of the rests that are on a face in an order that is taken to be the right one."""
TIMES_BETTER = 4
"""Of the rests that are on a face in one order alone, so many times more must speak for the other one."""

# the scatter of places of rest
STILL_SIGMAS = 6.0
"""Standard deviations of noise within which an object lies still."""
FEWEST_TOSSES = 6
"""Tosses at rest from which a scatter is estimated."""
NOISE_RATIO = 2.0
"""Scatter over the noise's below which it counts as noise."""


def touching(model: ObjectModel, q: Array) -> Array:
    """The corners of the stated geometry that touch the ground if one does [m], (k, 3).

    Args:
        model: The object.
        q: Configuration, (nq,).
    """
    corners = corner_positions(model, q)
    return np.asarray(corners[corners[:, 2] < corners[:, 2].min() + TOUCHING_REL * model.width])


def stands(model: ObjectModel, q: Array) -> bool:
    """Whether the centre of mass is above the area between the touching corners.

    Args:
        model: The object.
        q: Configuration, (nq,).
    """
    around = touching(model, q)[:, :2] - center_of_mass(model, q)[:2]
    angle = np.sort(np.arctan2(around[:, 1], around[:, 0]))
    gaps = np.diff(np.append(angle, angle[0] + 2 * np.pi))
    return bool(gaps.max() < HALF_TURN)


class Support(NamedTuple):
    """The plane that an object at rest stands on.

    Attributes:
        normal: Horizontal components of its upward unit normal, (2,).
        height: Of the points that it stands on [m].
    """

    normal: Array
    height: float


def support_plane(track: PoseTrack, model: ObjectModel) -> Support | None:
    """The plane that an object stands on at a toss's end: the facet of its hull that is below its centre of mass.

    Args:
        track: Of a toss, z roughly up.
        model: The object.

    Returns:
        The plane; None where the object moves, is round, or the facet leans by more than `FLAT`.
    """
    pose = resting_pose(track) if model.roundness is None else None
    if pose is None:
        return None
    points, com = corner_positions(model, pose), center_of_mass(model, pose)
    hull = ConvexHull(points)
    down = np.flatnonzero(hull.equations[:, 2] < -np.cos(FLAT))
    if not len(down):
        return None
    n, d = hull.equations[down, :3], hull.equations[down, 3]
    # n · x + d = 0: of all facets that look down, the one under the centre of mass is the highest there
    under = int(np.argmax(-(n[:, :2] @ com[:2] + d) / n[:, 2]))
    return Support(-n[under, :2], float(points[hull.simplices[down[under]], 2].mean()))


def mean_pose(q: Array) -> Array:
    """Median position and joints and mean orientation of configurations near each other, (nq,).

    Args:
        q: Configurations, (n, nq).
    """
    pose = np.median(q, axis=0)
    pose[3:7] = quat_normalize(quat_continuous(q[:, 3:7]).mean(axis=0))
    return np.asarray(pose)


def near(q: Array, pose: Array, distance: Array | float, angle: Array | float) -> Bools:
    """Which configurations are near a pose, (n,).

    Args:
        q: Configurations, (n, nq).
        pose: The pose, (nq,), or one for each, (n, nq).
        distance: Largest distance [m].
        angle: Largest angle, of joints too [rad].
    """
    close = np.linalg.norm(q[:, :3] - pose[..., :3], axis=1) < distance
    turned = geodesic_angle(q[:, 3:7], pose[..., 3:7]) < angle
    joints = (np.abs(q[:, 7:] - pose[..., 7:]) < np.asarray(angle)[..., None]).all(axis=1)
    return np.asarray(close & turned & joints)


def still_for(q: Array, span: int, distance: Array | float, angle: Array | float) -> Bools:
    """Frames whose pose is the same half of `span` and `span` frames later, (n - span,).

    Args:
        q: Configurations, (n, nq).
        span: Number of frames.
        distance: What is the same [m].
        angle: What is the same [rad].
    """
    count = len(q) - span
    half, whole = (near(q[step : count + step], q[:count], distance, angle) for step in (span // 2, span))
    return np.asarray(half & whole)


def resting_pose(track: PoseTrack, *, times: float = 1.0) -> Array | None:
    """The pose (nq,) in which an object lies still at a track's end; None where it moves.

    Args:
        track: Of a toss.
        times: Factor on the distance and angle within which it lies still.
    """
    last = track.q[-REST_FRAMES:]
    if len(last) < REST_FRAMES:
        return None
    pose = mean_pose(last)
    return pose if near(last, pose, times * REST_DISTANCE, times * REST_ANGLE).all() else None


def rest_heights(tracks: Sequence[PoseTrack], model: ObjectModel) -> Array:
    """Height of the ground under each toss that comes to rest standing by itself [m], (k,).

    Args:
        tracks: One a toss, z up.
        model: The object.
    """
    poses = [resting_pose(track, times=LOOSELY) for track in tracks]
    return np.array([touching(model, q)[:, 2].mean() for q in poses if q is not None and stands(model, q)])


def bounce_heights(tracks: Sequence[PoseTrack], model: ObjectModel) -> Array:
    """Height of the lowest corner at the bounces of each toss that bounces [m], (k,).

    Args:
        tracks: One a toss, z up.
        model: The object.
    """
    bounces = [(t.q, find_peaks(-center_of_mass(model, t.q)[:, 2], prominence=BOUNCE_RISE)[0]) for t in tracks]
    return np.array([corner_heights(model, q[at]).min() for q, at in bounces if len(at)])


class OtherOrder(NamedTuple):
    """An order of quaternions in which objects lie on their faces, as they do not in the order that was read.

    Attributes:
        name: Columns of the quaternion, such as "qw qx qy qz".
        flat: Tosses that come to rest on a face, read so.
        as_read: The same, as they were read.
        rests: Tosses that come to rest.
    """

    name: str
    flat: int
    as_read: int
    rests: int


def other_order(tracks: Sequence[PoseTrack], model: ObjectModel, *, w_first: bool) -> OtherOrder | None:
    """The order in which quaternions were written, where places of rest refute the one that was read.

    Of an object without a stated shape, rests on one face share their downward direction in the body.

    Args:
        tracks: One a toss, z up.
        model: The object.
        w_first: Whether quaternions were read as written w x y z, else as x y z w. The other one is looked at.

    Returns:
        The order; None where the one that was read is no worse, or nothing tells.
    """
    chosen = np.unique(np.linspace(0, len(tracks) - 1, min(len(tracks), MOST_RESTS)).astype(int))
    poses = [pose for i in chosen if (pose := resting_pose(tracks[i], times=LOOSELY)) is not None]
    if not poses or (not model.is_stated and len(poses) < FEWEST_ALIKE):
        return None
    others = np.array(poses)
    others[:, 3:7] = (xyzw_to_wxyz if w_first else wxyz_to_xyzw)(others[:, 3:7])
    as_read, flat = _on_faces(np.array(poses), model), _on_faces(others, model)
    # of a cube, two fifths of what lies flat seem to in the other order as well: those say nothing
    better, worse = int((flat & ~as_read).sum()), int((as_read & ~flat).sum())
    if flat.mean() < MOST_FLAT or better <= TIMES_BETTER * worse:
        return None
    return OtherOrder("qx qy qz qw" if w_first else "qw qx qy qz", int(flat.sum()), int(as_read.sum()), len(poses))


def _on_faces(poses: Array, model: ObjectModel) -> Bools:
    """Which of resting poses (n, nq) are on a face, (n,)."""
    if model.is_stated:
        return np.array([stands(model, pose) for pose in poses])
    down = _downward(poses[:, 3:7])
    return np.asarray((down @ down.T > np.cos(SAME_FACE)).sum(axis=1) > 1)


def _downward(quat: Array) -> Array:
    """The downward direction in the body's axes, (n, 3)."""
    return quat_rotate(quat_conj(quat), np.array([0.0, 0.0, -1.0]))


class _Plane(NamedTuple):
    """The plane through the corners on which a toss ends.

    place (3,): its middle [m]; slope (2,); down (3,): the downward direction in the body; noise (2,): standard
    deviations of height [m] and tilt [rad] by the noise of poses.
    """

    place: Array
    slope: Array
    down: Array
    noise: Array


def rest_scatter(tosses: Sequence[Toss], model: ObjectModel, *, over_order: bool = False) -> tuple[float, float]:
    """Standard deviations, beyond noise, of the height [m] and the tilt [rad] at which an object comes to rest.

    A plane is fitted to the corners that touch. Heights are residuals of one plane through all places of rest and, with
    enough tosses, of an offset of the recorded frame in the body. Slopes are residuals of their median. So a wrong
    size, a tilted ground and a wrong frame are no scatter. Zeros where too few tosses end at rest, or where the scatter
    is that of the noise.

    Over the order of recording, neighbours are compared instead (von Neumann 1941), of which a change between sessions
    or a drift moves few or hardly any. What such a change does to all tosses together is no scatter then.

    Args:
        tosses: With measured poses.
        model: The object.
        over_order: Whether the tosses come in the order of recording, and neighbours are compared.
    """
    planes = [plane for toss in tosses if (plane := _plane(toss, model)) is not None]
    if len(planes) < FEWEST_TOSSES:
        return 0.0, 0.0
    places, slopes, downs, noises = (np.array(column) for column in zip(*planes, strict=True))
    shared = np.column_stack([np.ones(len(places)), places[:, :2]])
    if len(places) >= 2 * FEWEST_TOSSES:
        shared = np.column_stack([shared, downs])
    if over_order:
        shared, heights, off = (np.diff(x, axis=0) / np.sqrt(2) for x in (shared[:, 1:], places[:, 2], slopes))
    else:
        heights, off = places[:, 2], slopes - np.median(slopes, axis=0)
    tilt = median_abs_deviation(off, axis=None, scale="normal")
    noise = np.mean(noises, axis=0) / np.sqrt(REST_FRAMES)
    beyond = [
        float(np.sqrt(size**2 - small**2)) if size > NOISE_RATIO * small else 0.0
        for size, small in zip((_residual_scale(shared, heights), tilt), noise, strict=True)
    ]
    return beyond[0], beyond[1]


def _plane(toss: Toss, model: ObjectModel) -> _Plane | None:
    """The plane through the touching corners at a toss's end; None where it moves or touches in fewer than three."""
    q, cov = toss.measured
    if len(q) < REST_FRAMES:
        return None
    last, std = q[-REST_FRAMES:], np.sqrt(np.einsum("nii->ni", cov[-REST_FRAMES:]).mean(0))
    moved = np.abs(last[:, :3] - np.median(last[:, :3], axis=0)).max()
    if moved > STILL_SIGMAS * max(float(std[:3].max()), 1e-6):
        return None
    corners = np.median(corner_positions(model, last), axis=0)
    low = corners[corners[:, 2] < corners[:, 2].min() + TOUCHING_REL * model.width]
    middle = low[:, :2].mean(axis=0)
    A = np.column_stack([np.ones(len(low)), low[:, :2] - middle])
    if len(low) < 3 or np.linalg.cond(A.T @ A) > 1e6:
        return None
    height, *slope = np.linalg.lstsq(A, low[:, 2], rcond=None)[0]
    down = np.median(_downward(last[:, 3:7]), axis=0)
    return _Plane(np.append(middle, height), np.array(slope), down, np.array([std[2], std[3:5].max()]))


def _residual_scale(A: Array, y: Array) -> float:
    """Robust scale of what a linear fit of y (n,) to A (n, k) leaves, outliers left out of the fit."""
    kept = np.ones(len(y), bool)
    for _ in range(3):
        off: Array = y - A @ np.linalg.lstsq(A[kept], y[kept], rcond=1e-3)[0]
        kept = np.abs(off) <= 3 * median_abs_deviation(off, scale="normal")
    return float(median_abs_deviation(off, scale="normal"))
