"""The direction of gravity and the ground's plane from motion alone, for recordings with any world frame.

Free flight gives the direction of gravity. Where the object rests, the touching corners give the ground,
z = height + slope · (x, y), fitted robustly, since a hand may also have held the object still in the air. Errors that
the corners of one rest share (a face's own error) do not average out, so the covariance is a jackknife over rests.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.motion.contact import runs
from tossid.motion.flight import acceleration_deviation, half_width, local_parabolas
from tossid.motion.kinematics import center_of_mass
from tossid.motion.noise import frame_noise, scatter
from tossid.motion.resting import mean_pose, near, stands, still_for, touching
from tossid.motion.sessions.levelling import turned_track, upright
from tossid.objects import GRAVITY, ObjectModel
from tossid.robust import NORMAL_MAD
from tossid.rotations import quat_to_matrix
from tossid.types import LongTrack, PoseTrack

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Track = PoseTrack | LongTrack

HALF_WINDOW, LONGEST = 5, 0.16
"""Fewest frames on each side of the fit that gives an acceleration, and the longest time that it spans [s]."""
FALLING = 1.0
"""An object may fall where its acceleration's size is within this, or twice its error, of gravity's [m/s²]."""
SAME_DIRECTION = np.deg2rad(5.0)
"""Accelerations whose directions are this near are one gravity [rad]."""
SHORTEST_FALL = 8
"""Frames in a row that a fall has at least: a hand accelerates like gravity for moments only."""
FEWEST_FALLING = 30
"""Frames of falls from which gravity's direction is estimated."""
STILL_DISTANCE, STILL_ANGLE, STILL_TIME = 5e-4, 8e-3, 0.15
"""An object lies still within this [m] and this [rad], or four times a track's noise, for this long [s]."""
FEWEST_RESTS = 3
"""Places of rest that a plane is laid through at least."""
LEVEL_SIGMAS = 4.0
"""The ground is level where its slope is within so many standard deviations of gravity's direction."""
LEAST_SCATTER = 3e-4
"""Places of rest agree with a plane to this at best [m]."""
BLOCK_FRAMES = 10_000
"""Frames that are in memory at a time."""


@dataclass(frozen=True, eq=False)
class Ground:
    """The ground in the world's frame.

    Attributes:
        up: Unit vector, (3,): the ground's normal where it is level as far as flights show, else against gravity.
        gravity_sigma: Standard deviation of gravity's direction across [rad]; NaN where there were too few flights, and
            the ground is then taken as level.
        height: Of the ground at the origin, in a frame that is turned to `up` by the shortest rotation [m].
        slope: Of the ground in that frame, (2,).
        cov: Covariance of height and slope, (3, 3).
        rms: Scatter of rests about the plane [m].
        n_rests: Places of rest that the plane rests on.
        n_left_out: Places of rest that lie elsewhere.
        n_falling: Frames in free flight.
    """

    up: Array
    gravity_sigma: float
    height: float
    slope: Array
    cov: Array
    rms: float
    n_rests: int
    n_left_out: int
    n_falling: int

    @property
    def tilt(self) -> float:
        """Angle between `up` and the world's z [rad]."""
        return float(np.arccos(np.clip(self.up[2], -1, 1)))

    def levelled(self, track: PoseTrack) -> PoseTrack:
        """A track in a frame whose z is up, in which the ground has z = 0 at the origin.

        Args:
            track: In the world's frame.
        """
        return turned_track(track, upright(self.up), -self.height)


def find_ground(track: Track, model: ObjectModel, *, gravity: float = GRAVITY) -> Ground:
    """Gravity's direction and the ground, from all flights and rests of a recording.

    Args:
        track: In any world frame, with tosses in it.
        model: The object.
        gravity: Its size [m/s²].

    Raises:
        InputError: The object rests in too few places.
    """
    part = track.frames(slice(0, BLOCK_FRAMES))
    distance, angle = (float(np.median(noise)) for noise in frame_noise(part, center_of_mass(model, part.q)))
    up, sigma, n_falling = _up(track, model, gravity, distance)
    ground = Ground(up, sigma, 0.0, np.zeros(2), np.zeros((3, 3)), 0.0, 0, 0, n_falling)
    rests = [touching(model, q) for q in _rests(track, ground, distance, angle) if stands(model, q)]
    if len(rests) < FEWEST_RESTS:
        raise InputError(f"the object rests in {len(rests)} places; the ground is found from {FEWEST_RESTS} or more")
    ground = _with_plane(ground, rests)
    doubt = np.hypot(sigma, np.sqrt(max(ground.cov[1, 1], ground.cov[2, 2])))
    if np.linalg.norm(ground.slope) > LEVEL_SIGMAS * doubt:  # (false where doubt is NaN)
        return ground
    # the ground is level as far as flights show: its normal is then the better estimate of up
    turn = quat_to_matrix(upright(ground.up))
    normal = turn.T @ np.array([-ground.slope[0], -ground.slope[1], 1.0])
    up = normal / np.linalg.norm(normal)
    between = quat_to_matrix(upright(up)) @ turn.T
    return _with_plane(replace(ground, up=up), [rest @ between.T for rest in rests])


def _with_plane(ground: Ground, rests: list[Array]) -> Ground:
    """The ground with the plane that places of rest lie on, in a frame that is turned to `ground.up`."""
    plane, kept, off = _plane(rests)
    cov = _jackknife([rest for rest, good in zip(rests, kept, strict=True) if good], plane)
    rms, n = float(np.sqrt(np.mean(off[kept] ** 2))), int(kept.sum())
    return replace(
        ground, height=float(plane[0]), slope=plane[1:], cov=cov, rms=rms, n_rests=n, n_left_out=len(rests) - n
    )


def _blocks(n: int, margin: int) -> Iterator[tuple[slice, slice]]:
    """Blocks of frames with a margin on each side, and which of their frames are not margin."""
    for first in range(0, n, BLOCK_FRAMES):
        last = min(first + BLOCK_FRAMES, n)
        start = max(first - margin, 0)
        yield slice(start, min(last + margin, n)), slice(first - start, last - start)


def _up(track: Track, model: ObjectModel, gravity: float, noise: float) -> tuple[Array, float, int]:
    """The direction against gravity, its standard deviation [rad], and the number of frames; else the world's z."""
    dt = float(np.median(np.diff(track.t)))
    half = half_width(noise, dt, least=HALF_WINDOW, certain=0.5 * FALLING, longest=LONGEST)
    falling, against = _falling(
        track, model, gravity, half, max(FALLING, 2 * float(acceleration_deviation(noise, half, dt)))
    )
    falling = _in_runs(falling)
    if falling.any():
        # the direction that most frames share, then the median of those near it
        some = against[falling][:: max(int(falling.sum()) // 1000, 1)]
        up = some[np.argmax([np.sum(some @ one > np.cos(SAME_DIRECTION)) for one in some])]
        for _ in range(10):
            near = _in_runs(falling & (against @ up > np.cos(SAME_DIRECTION)))
            mean = np.median(against[near if near.any() else falling], axis=0)
            up = mean / np.linalg.norm(mean)
        falling = near
    n = int(falling.sum())
    if n < FEWEST_FALLING:
        return np.array([0.0, 0.0, 1.0]), float("nan"), 0
    across = against[falling] - (against[falling] @ up)[:, None] * up
    sigma = float(np.median(np.linalg.norm(across, axis=1))) / 1.1774  # median of a Rayleigh distribution
    # neighbouring frames share windows; the error of a median is 1.25 times that of a mean
    return up, 1.2533 * sigma / float(np.sqrt(n / (2 * half + 1))), n


def _falling(track: Track, model: ObjectModel, gravity: float, half: int, within: float) -> tuple[Bools, Array]:
    """Which frames (n,) accelerate with gravity's size, within some [m/s²], and the direction against it (n, 3)."""
    n, longest = len(track.t), 1.5 * 2 * half * float(np.median(np.diff(track.t)))
    falling, against = np.zeros(n, dtype=bool), np.zeros((n, 3))
    for around, own in _blocks(n, half):
        part = track.frames(around)
        com = center_of_mass(model, part.q)
        noise = np.full(len(com), scatter(np.diff(com, n=3, axis=0)) + 1e-6)
        acceleration = local_parabolas(part.t, com, half, noise)[1][own]
        index = np.arange(around.start, around.stop)[own]
        span = track.t[np.minimum(index + half, n - 1)] - track.t[np.maximum(index - half, 0)]
        size = np.linalg.norm(acceleration, axis=1)
        falling[index] = (np.abs(size - gravity) < within) & (span < longest)
        against[index] = -acceleration / np.maximum(size, 1e-12)[:, None]
    return falling, against


def _in_runs(falling: Bools) -> Bools:
    """Which frames are in a long enough run."""
    out = np.zeros_like(falling)
    for first, last in runs(falling):
        out[first : last + 1] = last + 1 - first >= SHORTEST_FALL
    return out


def _rests(track: Track, ground: Ground, noise: float, turn_noise: float) -> list[Array]:
    """The pose (nq,) of each rest, in the ground's frame."""
    distance, angle = max(STILL_DISTANCE, 4 * noise), max(STILL_ANGLE, 4 * turn_noise)
    n, dt = len(track.t), float(np.median(np.diff(track.t)))
    span = max(round(STILL_TIME / dt), 4)
    still = np.zeros(max(n - span, 0), dtype=bool)
    for around, _ in _blocks(len(still), 0):
        part = ground.levelled(track.frames(slice(around.start, around.stop + span)))
        quiet = still_for(part.q, span, distance, angle)
        still[around] = quiet & (part.t[span:] - part.t[:-span] < 1.5 * span * dt)
    # of a rest longer than a block, the end
    ends = [slice(max(first, last + 1 - BLOCK_FRAMES), last + 1 + span) for first, last in runs(still)]
    poses = list[Array]()
    for end in ends:
        pose = mean_pose(ground.levelled(track.frames(end)).q)
        if not (poses and near(pose[None], poses[-1], distance, angle)[0]):  # (one rest, which noise divides)
            poses.append(pose)
    return poses


def _design(rests: list[Array]) -> tuple[Array, Array, NDArray[np.int64]]:
    """Rows (1, x, y), heights z, and the rest that each belongs to."""
    points = np.concatenate(rests)
    number = np.repeat(np.arange(len(rests)), [len(rest) for rest in rests])
    return np.column_stack([np.ones(len(points)), points[:, :2]]), points[:, 2], number


def _plane(rests: list[Array]) -> tuple[Array, Bools, Array]:
    """Height and slopes that most rests agree on, which do, and each one's distance [m]."""
    A, z, number = _design(rests)
    size = np.bincount(number)

    def distances(plane: Array) -> Array:
        return np.bincount(number, z - A @ plane) / size

    slopes = np.array([np.linalg.lstsq(*_design([rest])[:2], rcond=None)[0][1:] for rest in rests])
    plane = np.append(0.0, np.median(slopes, axis=0))
    off = distances(plane)
    # start at the lowest height that many rests share: above it, the object was held
    shared = np.array([np.sum(np.abs(off - one) < 10 * LEAST_SCATTER) for one in off])
    plane[0] = np.min(off[shared >= 0.5 * shared.max()])
    for _ in range(20):
        off = distances(plane)
        near = np.abs(off) < 10 * LEAST_SCATTER
        scale = NORMAL_MAD * float(np.median(np.abs(off[near]))) if near.any() else 0.0
        kept = np.abs(off) < 4 * max(scale, LEAST_SCATTER)
        plane = np.linalg.lstsq(A[kept[number]], z[kept[number]], rcond=None)[0]
    return plane, kept, off


def _jackknife(rests: list[Array], plane: Array) -> Array:
    """Covariance (3, 3) of the plane: each rest is left out once, as its corners are not independent."""
    A, z, number = _design(rests)
    H, b, n = A.T @ A, A.T @ z, len(rests)
    own = [number == i for i in range(n)]
    # normal equations without one rest are those of all, less its own
    without = np.array([np.linalg.solve(H - A[i].T @ A[i], b - A[i].T @ z[i]) for i in own])
    off = without - plane
    return np.asarray((n - 1) / n * off.T @ off)
