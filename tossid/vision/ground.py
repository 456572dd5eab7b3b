"""Which way is up, and where the ground is, from the motion alone: for recordings whose world is not the ground's.

Free flight tells the direction of gravity in the world's frame. Where the object lay, the corners that touched tell the
ground, z = height + slope · (x, y), robustly: a hand may have held the object still in the air as well. What corners of
one rest have in common (a face's own error) is not averaged out within it: the covariance is a jackknife's over rests.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.objects import GRAVITY, ObjectModel
from tossid.rotations import quat_exp, quat_mul, quat_to_matrix
from tossid.types import LongTrack, PoseTrack
from tossid.vision.parabolas import local_parabolas, scatter
from tossid.vision.standing import center_of_mass, mean_pose, stands, still_for, touching

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

BLOCK = 10_000
"""Frames that are looked at at a time."""
HALF = 5
"""Frames on each side over which accelerations are looked at."""
FALLING = 1.0
"""How far from gravity's size [m/s²] the acceleration of what may be falling is."""
ALIKE = np.deg2rad(5.0)
"""Falls whose directions are so near are one gravity."""
RUN = 8
"""Frames in a row that a flight lasts at least."""
FEWEST_FALLING = 30
"""Frames of flight that are enough to tell up from."""
STILL, LONG = (0.0005, 0.008), 0.15
"""A rest: within so much [m], [rad], for so long [s]."""
FEWEST_RESTS = 3
LEVEL = 4.0
"""The ground is level where its slope is within so many standard deviations of gravity's direction."""
LEAST_SCATTER = 0.0003
"""[m] within which places of rest agree at the least."""


@dataclass(frozen=True, eq=False)
class Ground:
    """The ground in the world's frame.

    up: (3,) unit: the ground's normal where it is level as far as flights tell, else against gravity. gravity_sigma:
    standard deviation [rad] of gravity's direction across, NaN where flights did not tell (then the ground is taken as
    level). height [m], slope (2,): of the ground, in a frame that is turned to up by the shortest way, at its origin.
    cov: (3, 3) of height and slope. rms: scatter of rests about it [m]. n_rests, n_left_out: places of rest it goes by,
    and that lie elsewhere. n_falling: frames in free flight.
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
        """Of up against the world's z [rad]."""
        return float(np.arccos(np.clip(self.up[2], -1, 1)))

    @property
    def turn(self) -> Array:
        """Quaternion that takes the world's frame to one whose z is up. (4,)."""
        axis = np.cross(self.up, [0.0, 0.0, 1.0])
        length = float(np.linalg.norm(axis))
        if length < 1e-12:
            return np.array([1.0, 0.0, 0.0, 0.0]) if self.up[2] > 0 else np.array([0.0, 1.0, 0.0, 0.0])
        return quat_exp(axis / length * self.tilt)

    def levelled(self, track: PoseTrack) -> PoseTrack:
        """A track in a frame whose z is up, and in which the ground has z = 0 at the origin."""
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


def find_ground(track: PoseTrack | LongTrack, model: ObjectModel, *, gravity: float = GRAVITY) -> Ground:
    """Up and the ground, from all flights and rests of a recording.

    Args:
        track: in any world, with tosses in it. gravity: its size [m/s²].

    Raises:
        InputError: the object rests in fewer than `FEWEST_RESTS` places.
    """
    up, sigma, n_falling = _up(track, model, gravity)
    ground = Ground(up, sigma, 0.0, np.zeros(2), np.zeros((3, 3)), 0.0, 0, 0, n_falling)
    rests = [touching(model, q) for q in _rests(track, ground) if stands(model, q)]
    if len(rests) < FEWEST_RESTS:
        raise InputError(f"the object rests in {len(rests)} places; the ground is found from {FEWEST_RESTS} or more")
    for level in (True, False):
        plane, kept, off = _plane(rests)
        cov = _clustered([rest for rest, good in zip(rests, kept, strict=True) if good], plane)
        rms, n = float(np.sqrt(np.mean(off[kept] ** 2))), int(kept.sum())
        ground = Ground(ground.up, sigma, float(plane[0]), plane[1:], cov, rms, n, len(rests) - n, n_falling)
        doubt = np.hypot(sigma, np.sqrt(max(cov[1, 1], cov[2, 2])))
        if not level or np.linalg.norm(ground.slope) > LEVEL * doubt:  # (NaN: no gravity to differ from)
            break
        # level, as far as flights tell: the ground then is the better witness of up
        turn = quat_to_matrix(ground.turn)
        normal = turn.T @ np.array([-plane[1], -plane[2], 1.0])
        ground = Ground(normal / np.linalg.norm(normal), sigma, 0.0, np.zeros(2), cov, rms, n, 0, n_falling)
        between = quat_to_matrix(ground.turn) @ turn.T
        rests = [rest @ between.T for rest in rests]
    return ground


def _blocks(n: int, beside: int) -> Iterator[tuple[slice, slice]]:
    """`BLOCK` frames at a time with so many on each side of them, and which of these are the block's own."""
    for first in range(0, n, BLOCK):
        start, stop = max(first - beside, 0), min(first + BLOCK + beside, n)
        yield slice(start, stop), slice(first - start, min(first + BLOCK, n) - start)


def _up(track: PoseTrack | LongTrack, model: ObjectModel, gravity: float) -> tuple[Array, float, int]:
    """Against gravity, its uncertainty [rad], and from how many frames; the world's z where too few fall alike."""
    index, ways = _like_falling(track, model, gravity)
    falling = _in_runs(index)
    index, ways = index[falling], ways[falling]
    up = np.array([0.0, 0.0, 1.0])
    if len(ways):
        some = ways[:: max(len(ways) // 1000, 1)]
        up = some[np.argmax([np.sum(some @ one > np.cos(ALIKE)) for one in some])]
        for _ in range(10):
            near = ways @ up > np.cos(ALIKE)
            near[near] = _in_runs(index[near])
            mean = np.median(ways[near] if near.any() else ways, axis=0)
            up = mean / np.linalg.norm(mean)
        ways = ways[near]
    n = len(ways)
    if n < FEWEST_FALLING:
        return np.array([0.0, 0.0, 1.0]), float("nan"), 0
    across = ways - (ways @ up)[:, None] * up
    scatter = float(np.median(np.linalg.norm(across, axis=1))) / 1.1774  # of Rayleigh's law
    # neighbouring frames share their windows; a median's error is 1.25 times a mean's
    return up, 1.2533 * scatter / float(np.sqrt(n / (2 * HALF + 1))), n


def _like_falling(track: PoseTrack | LongTrack, model: ObjectModel, gravity: float) -> tuple[Ints, Array]:
    """Frames (k,) whose acceleration is of gravity's size, and the way against it (k, 3)."""
    n, longest = len(track.t), 1.5 * 2 * HALF * float(np.median(np.diff(track.t)))
    frames, ways = [], []
    for around, own in _blocks(n, HALF):
        part = track.frames(around)
        com = center_of_mass(model, part.q)
        noise = np.full(len(com), scatter(np.diff(com, n=3, axis=0)) + 1e-6)
        _, acceleration, _ = local_parabolas(part.t, com, HALF, noise)
        index = np.arange(around.start, around.stop)[own]
        span = track.t[np.minimum(index + HALF, n - 1)] - track.t[np.maximum(index - HALF, 0)]
        size = np.linalg.norm(acceleration[own], axis=1)
        chosen = (np.abs(size - gravity) < FALLING) & (span < longest)
        frames.append(index[chosen])
        ways.append(-acceleration[own][chosen] / size[chosen, None])
    return np.concatenate(frames), np.concatenate(ways)


def _in_runs(index: Ints) -> Bools:
    """Which of some frames stand in a row of `RUN`: a hand's acceleration is that of gravity in passing only."""
    run = np.cumsum(np.diff(index, prepend=index[:1]) > 1)
    return np.asarray(np.bincount(run)[run] >= RUN)


def _rests(track: PoseTrack | LongTrack, ground: Ground) -> list[Array]:
    """The poses at which the object lies still, one of each run of frames, in the ground's frame. (nq,) each."""
    n, dt = len(track.t), float(np.median(np.diff(track.t)))
    span = max(round(LONG / dt), 4)
    if n <= span:
        return []
    still = []
    for around, _ in _blocks(n - span, 0):
        part = ground.levelled(track.frames(slice(around.start, around.stop + span)))
        quiet = still_for(part.q, span, *STILL) & (part.t[span:] - part.t[:-span] < 1.5 * span * dt)
        still.append(around.start + np.flatnonzero(quiet))
    index = np.concatenate(still)
    runs = np.split(index, np.flatnonzero(np.diff(index) > 1) + 1) if len(index) else []
    # of a rest longer than a block, its end
    ends = [slice(max(run[0], run[-1] + 1 - BLOCK), run[-1] + 1 + span) for run in runs]
    return [mean_pose(ground.levelled(track.frames(end)).q) for end in ends]


def _design(rests: list[Array]) -> tuple[Array, Array, NDArray[np.int64]]:
    """Rows (1, x, y), heights z, and of which rest each is."""
    points = np.concatenate(rests)
    number = np.repeat(np.arange(len(rests)), [len(rest) for rest in rests])
    return np.column_stack([np.ones(len(points)), points[:, :2]]), points[:, 2], number


def _plane(rests: list[Array]) -> tuple[Array, Bools, Array]:
    """Height and slopes that most rests agree on, which do, and each one's distance [m]."""
    slopes = np.array([np.linalg.lstsq(*_design([rest])[:2], rcond=None)[0][1:] for rest in rests])
    plane = np.append(0.0, np.median(slopes, axis=0))
    A, z, number = _design(rests)
    off = np.array([(z - A @ plane)[number == i].mean() for i in range(len(rests))])
    # the lowest crowd of heights: what lies above is held
    crowd = np.array([np.sum(np.abs(off - one) < 10 * LEAST_SCATTER) for one in off])
    plane[0] = np.min(off[crowd >= 0.5 * crowd.max()])
    for _ in range(20):
        off = np.array([(z - A @ plane)[number == i].mean() for i in range(len(rests))])
        near = np.abs(off) < 10 * LEAST_SCATTER
        scale = 1.4826 * float(np.median(np.abs(off[near]))) if near.any() else 0.0
        kept = np.abs(off) < 4 * max(scale, LEAST_SCATTER)
        plane = np.linalg.lstsq(A[kept[number]], z[kept[number]], rcond=None)[0]
    return plane, kept, off


def _clustered(rests: list[Array], plane: Array) -> Array:
    """Covariance (3, 3) of the plane, rests being independent and their corners not: each is left out once."""
    A, z, number = _design(rests)
    H, b, n = A.T @ A, A.T @ z, len(rests)
    without = np.empty((n, 3))
    for i in range(n):
        own = number == i
        without[i] = np.linalg.solve(H - A[own].T @ A[own], b - A[own].T @ z[own])
    off = without - plane
    return np.asarray((n - 1) / n * off.T @ off)
