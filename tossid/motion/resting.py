"""Poses of resting objects: how high the ground is, how quaternions are ordered, and errors that do not change.

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
from scipy.stats import median_abs_deviation

from tossid.motion.stability import center_of_mass, mean_pose, near, stands, touching
from tossid.objects import ObjectModel, corner_heights, corner_positions
from tossid.rotations import quat_conj, quat_rotate, wxyz_to_xyzw, xyzw_to_wxyz
from tossid.settings.motion import RestScatterSettings
from tossid.settings.sessions import WitnessSettings
from tossid.types import PoseTrack, Toss

Array = NDArray[np.float64]

DEFAULT = RestScatterSettings()
WITNESS = WitnessSettings()
_STILL = 5.0
"""A tracker's noise is up to so many times what an object may move that lies still."""
_MOST_RESTS = 200
"""Places of rest that are looked at for the order of quaternions."""
_SAME_FACE = np.deg2rad(3.0)
"""Two rests whose downward directions in the body differ by less are on one face."""
_FEWEST_ALIKE = 4
"""Rests of an unknown object from which on it can be said that they share faces."""


_MOST_FLAT = 0.7
"""Share of the rests that are on a face in an order that is taken to be the right one."""
_TIMES_BETTER = 4
"""Of the rests that are on a face in one order alone, so many times more must speak for the other one."""


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


def resting_pose(track: PoseTrack, *, settings: WitnessSettings = WITNESS, times: float = 1.0) -> Array | None:
    """The pose (nq,) in which an object lies still at a track's end; None where it moves.

    Args:
        track: Of a toss.
        settings: Over how many frames, and within what.
        times: Factor on the distance and angle within which it lies still.
    """
    last = track.q[-settings.rest_frames :]
    if len(last) < settings.rest_frames:
        return None
    pose = mean_pose(last)
    is_still = near(last, pose, times * settings.rest_distance, times * settings.rest_angle).all()
    return pose if is_still else None


def rest_heights(tracks: Sequence[PoseTrack], model: ObjectModel) -> Array:
    """Height of the ground under each toss that comes to rest standing by itself [m], (k,).

    Args:
        tracks: One a toss, z up.
        model: The object.
    """
    poses = [resting_pose(track, times=_STILL) for track in tracks]
    return np.array([touching(model, q)[:, 2].mean() for q in poses if q is not None and stands(model, q)])


def bounce_heights(tracks: Sequence[PoseTrack], model: ObjectModel, *, rise: float = 0.01) -> Array:
    """Height of the lowest corner at the bounces of each toss that bounces [m], (k,).

    Args:
        tracks: One a toss, z up.
        model: The object.
        rise: What the centre of mass falls before a bounce and rises after it, at least [m].
    """
    found = []
    for track in tracks:
        bounces, _ = find_peaks(-center_of_mass(model, track.q)[:, 2], prominence=rise)
        if len(bounces):
            found.append(float(corner_heights(model, track.q[bounces]).min()))
    return np.array(found)


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
    chosen = np.unique(np.linspace(0, len(tracks) - 1, min(len(tracks), _MOST_RESTS)).astype(int))
    poses = [pose for i in chosen if (pose := resting_pose(tracks[i], times=_STILL)) is not None]
    if not poses or (not model.is_stated and len(poses) < _FEWEST_ALIKE):
        return None
    others = np.array(poses)
    others[:, 3:7] = (xyzw_to_wxyz if w_first else wxyz_to_xyzw)(others[:, 3:7])
    as_read, flat = _on_faces(np.array(poses), model), _on_faces(others, model)
    # of a cube, two fifths of what lies flat seem to in the other order as well: those say nothing
    better, worse = int((flat & ~as_read).sum()), int((as_read & ~flat).sum())
    if flat.mean() < _MOST_FLAT or better <= _TIMES_BETTER * worse:
        return None
    return OtherOrder("qx qy qz qw" if w_first else "qw qx qy qz", int(flat.sum()), int(as_read.sum()), len(poses))


def _on_faces(poses: Array, model: ObjectModel) -> NDArray[np.bool_]:
    """Which of resting poses (n, nq) are on a face, (n,)."""
    if model.is_stated:
        return np.array([stands(model, pose) for pose in poses])
    down = quat_rotate(quat_conj(poses[:, 3:7]), np.array([0.0, 0.0, -1.0]))
    alike = down @ down.T > np.cos(_SAME_FACE)
    return np.asarray(alike.sum(axis=1) > 1)


def rest_scatter(
    tosses: Sequence[Toss], model: ObjectModel, *, over_order: bool = False, settings: RestScatterSettings = DEFAULT
) -> tuple[float, float]:
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
        settings: What is at rest, and what is noise.
    """
    n_frames = settings.frames
    places, downs, slopes, noises = [], [], [], []
    for toss in tosses:
        q, cov = toss.measured
        if len(q) < n_frames:
            continue
        last, std = q[-n_frames:], np.sqrt(np.einsum("nii->ni", cov[-n_frames:]).mean(0))
        if np.abs(last[:, :3] - np.median(last[:, :3], axis=0)).max() > settings.still_sigmas * max(
            float(std[:3].max()), 1e-6
        ):
            continue
        corners = np.median(corner_positions(model, last), axis=0)
        low = corners[corners[:, 2] < corners[:, 2].min() + settings.touching_height * model.width]
        A = np.column_stack([np.ones(len(low)), low[:, :2] - low[:, :2].mean(0)])
        if len(low) < 3 or np.linalg.cond(A.T @ A) > 1e6:
            continue
        height, *slope = np.linalg.lstsq(A, low[:, 2], rcond=None)[0]
        places.append([*low[:, :2].mean(0), height])
        downs.append(np.median(quat_rotate(quat_conj(last[:, 3:7]), np.array([0.0, 0.0, -1.0])), axis=0))
        slopes.append(slope)
        noises.append([std[2], std[3:5].max()])
    if len(places) < settings.fewest_tosses:
        return 0.0, 0.0
    height = _scatter(np.array(places), np.array(downs), settings.fewest_tosses, over_order=over_order)
    off = np.diff(slopes, axis=0) / np.sqrt(2) if over_order else slopes - np.median(slopes, axis=0)
    tilt = median_abs_deviation(off, axis=None, scale="normal")
    noise = np.mean(noises, axis=0) / np.sqrt(n_frames)
    found = [
        float(np.sqrt(size**2 - small**2)) if size > settings.noise_ratio * small else 0.0
        for size, small in zip((height, tilt), noise, strict=True)
    ]
    return found[0], found[1]


def _scatter(places: Array, downs: Array, fewest: int, *, over_order: bool) -> float:
    """Robust scatter of the heights of places (n, 3) about a plane and, with enough tosses, an offset in the body.

    downs: the downward direction in the body's axes, (n, 3). Over the order, of the differences between neighbours.
    """
    shared = [np.ones(len(places)), places[:, 0], places[:, 1]]
    if len(places) >= 2 * fewest:
        shared += list(downs.T)
    A, heights = np.column_stack(shared), places[:, 2]
    if over_order:
        A, heights = np.diff(A[:, 1:], axis=0) / np.sqrt(2), np.diff(heights) / np.sqrt(2)
    kept = np.ones(len(heights), bool)
    for _ in range(3):
        off: Array = heights - A @ np.linalg.lstsq(A[kept], heights[kept], rcond=1e-3)[0]
        kept = np.abs(off) <= 3 * median_abs_deviation(off, scale="normal")
    return float(median_abs_deviation(off, scale="normal"))
