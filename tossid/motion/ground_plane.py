"""The direction of gravity and the ground's plane from motion alone, for recordings with any world frame.

Free flight gives the direction of gravity. Where the object rests, the touching corners give the ground,
z = height + slope · (x, y), fitted robustly, since a hand may also have held the object still in the air. Errors that
the corners of one rest share (a face's own error) do not average out, so the covariance is a jackknife over rests.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.motion.local_motion import local_parabolas, scatter
from tossid.motion.stability import center_of_mass, mean_pose, stands, still_for, touching
from tossid.objects import GRAVITY, ObjectModel
from tossid.rotations import quat_exp, quat_mul, quat_to_matrix
from tossid.settings.segmentation import GroundSettings
from tossid.types import LongTrack, PoseTrack

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

DEFAULT = GroundSettings()


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

    @property
    def turn(self) -> Array:
        """Quaternion that takes the world's frame to one whose z is `up`, (4,)."""
        return upright(self.up)

    def levelled(self, track: PoseTrack) -> PoseTrack:
        """A track in a frame whose z is up, in which the ground has z = 0 at the origin.

        Args:
            track: In the world's frame.
        """
        quat, turn = np.broadcast_to(self.turn, (len(track.t), 4)), quat_to_matrix(self.turn)
        q = track.q.copy()
        q[:, :3] = q[:, :3] @ turn.T
        q[:, 2] -= self.height
        q[:, 3:7] = quat_mul(quat, q[:, 3:7])
        cov = track.q_cov
        if cov is not None:
            T = np.eye(cov.shape[-1])
            T[:3, :3] = turn
            cov = T @ cov @ T.T
        return PoseTrack(track.name, track.t, q, cov)


def upright(up: Array) -> Array:
    """The shortest rotation that takes a direction to the z axis, as a quaternion wxyz (4,).

    Args:
        up: A unit vector, (3,).
    """
    axis = np.cross(up, [0.0, 0.0, 1.0])
    length = float(np.linalg.norm(axis))
    if length < 1e-12:
        return np.array([1.0, 0.0, 0.0, 0.0]) if up[2] > 0 else np.array([0.0, 1.0, 0.0, 0.0])
    return quat_exp(axis / length * float(np.arccos(np.clip(up[2], -1, 1))))


def find_ground(
    track: PoseTrack | LongTrack, model: ObjectModel, *, gravity: float = GRAVITY, settings: GroundSettings = DEFAULT
) -> Ground:
    """Gravity's direction and the ground, from all flights and rests of a recording.

    Args:
        track: In any world frame, with tosses in it.
        model: The object.
        gravity: Its size [m/s²].
        settings: What counts as a fall and as a rest.

    Raises:
        InputError: The object rests in too few places.
    """
    up, sigma, n_falling = _up(track, model, gravity, settings)
    ground = Ground(up, sigma, 0.0, np.zeros(2), np.zeros((3, 3)), 0.0, 0, 0, n_falling)
    rests = [touching(model, q) for q in _rests(track, ground, settings) if stands(model, q)]
    fewest = settings.fewest_rests
    if len(rests) < fewest:
        raise InputError(f"the object rests in {len(rests)} places; the ground is found from {fewest} or more")
    for level in (True, False):
        plane, kept, off = _plane(rests, settings.least_scatter)
        cov = _clustered([rest for rest, good in zip(rests, kept, strict=True) if good], plane)
        rms, n = float(np.sqrt(np.mean(off[kept] ** 2))), int(kept.sum())
        ground = Ground(ground.up, sigma, float(plane[0]), plane[1:], cov, rms, n, len(rests) - n, n_falling)
        doubt = np.hypot(sigma, np.sqrt(max(cov[1, 1], cov[2, 2])))
        if not level or np.linalg.norm(ground.slope) > settings.level_sigmas * doubt:  # (false where doubt is NaN)
            break
        # the ground is level as far as flights show: its normal is then the better estimate of up
        turn = quat_to_matrix(ground.turn)
        normal = turn.T @ np.array([-plane[1], -plane[2], 1.0])
        ground = Ground(normal / np.linalg.norm(normal), sigma, 0.0, np.zeros(2), cov, rms, n, 0, n_falling)
        between = quat_to_matrix(ground.turn) @ turn.T
        rests = [rest @ between.T for rest in rests]
    return ground


def _blocks(n: int, margin: int, size: int) -> Iterator[tuple[slice, slice]]:
    """Blocks of frames with a margin on each side, and which of their frames are not margin."""
    for first in range(0, n, size):
        start, stop = max(first - margin, 0), min(first + size + margin, n)
        yield slice(start, stop), slice(first - start, min(first + size, n) - start)


def _up(
    track: PoseTrack | LongTrack, model: ObjectModel, gravity: float, settings: GroundSettings
) -> tuple[Array, float, int]:
    """The direction against gravity, its standard deviation [rad], and the number of frames; else the world's z."""
    index, ways = _falling(track, model, gravity, settings)
    shortest, same = settings.shortest_fall, np.cos(settings.same_direction)
    falling = _in_runs(index, shortest)
    index, ways = index[falling], ways[falling]
    up = np.array([0.0, 0.0, 1.0])
    if len(ways):
        some = ways[:: max(len(ways) // 1000, 1)]
        up = some[np.argmax([np.sum(some @ one > same) for one in some])]
        for _ in range(10):
            near = ways @ up > same
            near[near] = _in_runs(index[near], shortest)
            mean = np.median(ways[near] if near.any() else ways, axis=0)
            up = mean / np.linalg.norm(mean)
        ways = ways[near]
    n = len(ways)
    if n < settings.fewest_falling:
        return np.array([0.0, 0.0, 1.0]), float("nan"), 0
    across = ways - (ways @ up)[:, None] * up
    scatter = float(np.median(np.linalg.norm(across, axis=1))) / 1.1774  # median of a Rayleigh distribution
    # neighbouring frames share windows; the error of a median is 1.25 times that of a mean
    return up, 1.2533 * scatter / float(np.sqrt(n / (2 * settings.half_window + 1))), n


def _falling(
    track: PoseTrack | LongTrack, model: ObjectModel, gravity: float, settings: GroundSettings
) -> tuple[Ints, Array]:
    """Frames (k,) whose acceleration has gravity's size, and the direction against it (k, 3)."""
    half = settings.half_window
    n, longest = len(track.t), 1.5 * 2 * half * float(np.median(np.diff(track.t)))
    frames, ways = [], []
    for around, own in _blocks(n, half, settings.block_frames):
        part = track.frames(around)
        com = center_of_mass(model, part.q)
        noise = np.full(len(com), scatter(np.diff(com, n=3, axis=0)) + 1e-6)
        _, acceleration, _ = local_parabolas(part.t, com, half, noise)
        index = np.arange(around.start, around.stop)[own]
        span = track.t[np.minimum(index + half, n - 1)] - track.t[np.maximum(index - half, 0)]
        size = np.linalg.norm(acceleration[own], axis=1)
        chosen = (np.abs(size - gravity) < settings.falling) & (span < longest)
        frames.append(index[chosen])
        ways.append(-acceleration[own][chosen] / size[chosen, None])
    return np.concatenate(frames), np.concatenate(ways)


def _in_runs(index: Ints, shortest: int) -> Bools:
    """Which frames are in a long enough run: a hand accelerates like gravity for moments only."""
    run = np.cumsum(np.diff(index, prepend=index[:1]) > 1)
    return np.asarray(np.bincount(run)[run] >= shortest)


def _rests(track: PoseTrack | LongTrack, ground: Ground, settings: GroundSettings) -> list[Array]:
    """The pose (nq,) of each rest, in the ground's frame."""
    size = settings.block_frames
    n, dt = len(track.t), float(np.median(np.diff(track.t)))
    span = max(round(settings.still_time / dt), 4)
    if n <= span:
        return []
    still = []
    for around, _ in _blocks(n - span, 0, size):
        part = ground.levelled(track.frames(slice(around.start, around.stop + span)))
        quiet = still_for(part.q, span, settings.still_distance, settings.still_angle)
        quiet &= part.t[span:] - part.t[:-span] < 1.5 * span * dt
        still.append(around.start + np.flatnonzero(quiet))
    index = np.concatenate(still)
    runs = np.split(index, np.flatnonzero(np.diff(index) > 1) + 1) if len(index) else []
    # of a rest longer than a block, the end
    ends = [slice(max(run[0], run[-1] + 1 - size), run[-1] + 1 + span) for run in runs]
    return [mean_pose(ground.levelled(track.frames(end)).q) for end in ends]


def _design(rests: list[Array]) -> tuple[Array, Array, NDArray[np.int64]]:
    """Rows (1, x, y), heights z, and the rest that each belongs to."""
    points = np.concatenate(rests)
    number = np.repeat(np.arange(len(rests)), [len(rest) for rest in rests])
    return np.column_stack([np.ones(len(points)), points[:, :2]]), points[:, 2], number


def _plane(rests: list[Array], least_scatter: float) -> tuple[Array, Bools, Array]:
    """Height and slopes that most rests agree on, which do, and each one's distance [m]."""
    slopes = np.array([np.linalg.lstsq(*_design([rest])[:2], rcond=None)[0][1:] for rest in rests])
    plane = np.append(0.0, np.median(slopes, axis=0))
    A, z, number = _design(rests)
    off = np.array([(z - A @ plane)[number == i].mean() for i in range(len(rests))])
    # start at the lowest height that many rests share: above it, the object was held
    shared = np.array([np.sum(np.abs(off - one) < 10 * least_scatter) for one in off])
    plane[0] = np.min(off[shared >= 0.5 * shared.max()])
    for _ in range(20):
        off = np.array([(z - A @ plane)[number == i].mean() for i in range(len(rests))])
        near = np.abs(off) < 10 * least_scatter
        scale = 1.4826 * float(np.median(np.abs(off[near]))) if near.any() else 0.0
        kept = np.abs(off) < 4 * max(scale, least_scatter)
        plane = np.linalg.lstsq(A[kept[number]], z[kept[number]], rcond=None)[0]
    return plane, kept, off


def _clustered(rests: list[Array], plane: Array) -> Array:
    """Jackknife covariance (3, 3) of the plane: each rest is left out once, as its corners are not independent."""
    A, z, number = _design(rests)
    H, b, n = A.T @ A, A.T @ z, len(rests)
    without = np.empty((n, 3))
    for i in range(n):
        own = number == i
        without[i] = np.linalg.solve(H - A[own].T @ A[own], b - A[own].T @ z[own])
    off = without - plane
    return np.asarray((n - 1) / n * off.T @ off)
