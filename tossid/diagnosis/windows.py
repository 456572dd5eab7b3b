"""Short predictions from states that are known as well as they were measured, and their whitened misses.

A toss is cut into windows, and its first flight is in one more. In each, the simulator f starts from a state x that is
a nuisance: its pose is known as well as poses are measured, its velocity hardly at all (recorded velocities lag, and
are smeared over impacts). With S = df/dx and poses y with noise R, to first order around x_0,

    y - f(x_0) - S (x_rec - x_0) ~ N(0, R + S P S^T),

P the covariance of the recorded state x_rec. Whitened by the Cholesky factor in the order of time (`whitening`), every
entry is the innovation of one frame and channel given the frames before it: of unit variance where the simulator is
right, whatever the first state was.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.misses import mean_misses
from tossid.motion.flight import flight_frames
from tossid.motion.resting import rest_scatter
from tossid.objects import GRAVITY, ObjectModel
from tossid.physics.effects import World
from tossid.rotations import quat_boxminus, quat_exp, quat_mul, quat_normalize
from tossid.types import Phase, Toss

Array = NDArray[np.float64]

LENGTH = 20
"""Frames of a window in contact; rows of any."""
LONG = 60
"""Frames of a window that is all flight or all rest."""
SHORTEST_FLIGHT = 6
"""Frames of a first flight that gets a window of its own."""
JUMP = 3.0
"""Gravity's change of velocity in a frame, times which, beside noise, a velocity jumps where something is hit."""
FLIGHT_WEIGHT = 100.0
"""What a window of free flight counts for, over one with contact. Contact is never modelled as well as flight: what
both speak of, flight decides (cut feedback; Plummer, Stat. Comput. 2015), but where it knows it ten times less well."""
BEFORE_LANDING = 10
"""Frames of flight that are left to the window with the landing, whose first velocity they tell."""
SPEED_PRIOR, SPIN_PRIOR = 0.5, 5.0
"""Standard deviations [m/s], [rad/s] of recorded velocities, as far as windows trust them."""
LEAST_NOISE = np.array([5e-6] * 3 + [5e-5] * 3)
"""Standard deviations [m], [rad] of poses that are said to be known better, as simulated ones may be: with less, first
states and noise are too far apart for whitening in double precision."""
STILL = 6.0
"""Standard deviations of a pose, by which one at rest may differ from another."""
SAME = 0.3
"""Standard deviations of poses by which predictions move, for what hangs on them to be taken again."""
UNEVEN = 0.3
"""Share by which a time step may differ from the median one."""
TURN = 1.0
"""[rad] by which an object turns until a tracker's slow errors are others: other tags come into view."""


class Steps(TypedDict):
    """How a window is simulated; see `simulate`."""

    substeps: int
    impact_parts: int
    tolerance: float


def steps_of(world: World) -> Steps:
    """Simulator steps a frame, and parts of a step with an impact where contact yields; rigid impacts end steps.

    Where contact yields, median errors after 24 frames are 0.7 to 3.3 mm in eight parts, 0.5 to 1.9 mm in 16.
    At this tolerance [m/s] nine windows in ten move by less than 5 % of the poses' noise, for half of the solver's
    work.
    """
    return {"substeps": 4, "impact_parts": 8 if world.object.compliance == 0 else 16, "tolerance": 1e-5}


@dataclass(frozen=True)
class Windows:
    """W windows of tosses: a first frame, and at most F frames after it, in at most L rows.

    In contact a row is a frame. In flight and at rest, where nothing is sudden, windows are longer and a row is the
    mean of a few frames: a weak force shows only over the whole of it.

    There are K channels: the base's position and rotation, and each joint, K = nv.
    q (W, K + 1), v (W, K): recorded first states. at_q, at_v: states around which predictions are linearised.
    y (W, F, K + 1): measured poses; y_noise (W, F, K): their standard deviations [m, rad]; steps (W,): frames after
    the first. mix (W, L, F): rows' means of frames. noise (W, L, K): of rows; inside (W, L): which rows there are.
    toss (W,): whose; frame (W, L): of a row's first frame. phase (W, L): of `Phase`. dt [s].
    prior (W, 2 K): standard deviations of the recorded states.
    slow (W, K, L + 1, L + 1): each channel's covariances, between the first pose and all rows, of errors that turn with
    the object: a tracker's calibration. Zeros: none. root (W, K, L + 1, L + 1): inverse Cholesky factors of each
    channel's whole covariance, these errors and the noise.
    free (W,): windows of first flights, up to the landing and with nothing else in them. Their frames are in the other
    windows once more: what flight alone shows needs no model of contact.
    """

    q: Array
    v: Array
    at_q: Array
    at_v: Array
    y: Array
    y_noise: Array
    steps: NDArray[np.int64]
    mix: Array
    noise: Array
    inside: NDArray[np.bool_]
    toss: NDArray[np.int64]
    frame: NDArray[np.int64]
    phase: NDArray[np.uint8]
    dt: float
    prior: Array
    slow: Array
    root: Array
    free: NDArray[np.bool_]

    @property
    def channels(self) -> int:
        """K."""
        return self.v.shape[1]

    @property
    def counted(self) -> NDArray[np.bool_]:
        """(W, L) rows of the windows that follow one another, in which each frame is once."""
        return self.inside & ~self.free[:, None]

    @property
    def steady(self) -> NDArray[np.bool_]:
        """(W,) windows that are long, all flight or all rest."""
        return np.asarray(self.inside.sum(1) < self.steps)

    @property
    def weights(self) -> Array:
        """(W,) what each window counts for: where only flight speaks clearly, contact is to add little."""
        return np.where(self.free, FLIGHT_WEIGHT, 1.0)

    def predicted(self, world: World, q: Array | None = None, v: Array | None = None, *, n_threads: int = 1) -> Array:
        """(W, F, K + 1) recorded poses as the world predicts them from (q, v), or from the states of linearisation."""
        q, v = (self.at_q if q is None else q), (self.at_v if v is None else v)
        steps = np.tile(self.steps, len(q) // len(self.steps))
        run = world.roll_out(q, v, n_steps=steps, dt=self.dt, **steps_of(world), n_threads=n_threads)
        return run[:, 1:]

    def misses(self, predicted: Array) -> Array:
        """(·, L, K) measured less predicted: position [m], rotation vector in the body's frame [rad], joints; 0
        outside."""
        return mean_misses(self.y, predicted, self.mix, self.steps)

    def rows(self, index: NDArray[np.int64]) -> Windows:
        """The windows of the given rows."""
        names = (field.name for field in fields(self) if field.name != "dt")
        return replace(self, **{name: getattr(self, name)[index] for name in names})

    def of_tosses(self, index: NDArray[np.int64]) -> Windows:
        """The windows of some tosses, which are numbered as they are given."""
        number = np.full(max(self.toss.max(initial=0), index.max(initial=0)) + 1, -1)
        number[index] = np.arange(len(index))
        some = self.rows(np.flatnonzero(number[self.toss] >= 0))
        return replace(some, toss=number[some.toss])


def difference(measured: Array, predicted: Array) -> Array:
    """(..., K) measured poses less predicted ones (..., K + 1)."""
    turned = quat_boxminus(measured[..., 3:7], predicted[..., 3:7])
    joints = measured[..., 7:] - predicted[..., 7:]
    return np.concatenate([measured[..., :3] - predicted[..., :3], turned, joints], axis=-1)


def moved_pose(q: Array, by: Array) -> Array:
    """Poses (..., K + 1) moved by (..., K), the inverse of `difference`."""
    turned = quat_normalize(quat_mul(q[..., 3:7], quat_exp(by[..., 3:6])))
    return np.concatenate([q[..., :3] + by[..., :3], turned, q[..., 7:] + by[..., 6:]], axis=-1)


def make_windows(
    tosses: Sequence[Toss],
    model: ObjectModel | None = None,
    *,
    length: int = LENGTH,
    long: int = LONG,
    skip: int = 0,
    first_flights: bool = True,
) -> Windows:
    """Cut tosses into windows that follow one another, and end where frames are missing; what is left at the end of
    a stretch is kept if half a window long.

    Args:
        model: whose first flights get windows of their own, and whose poses at rest tell static errors; without, there
            are neither.
        length: rows of a window, and frames of one that is neither all flight nor all rest.
        long: frames of one that is.
        skip: frames of each toss that are left out at its beginning, to cut it elsewhere.
        first_flights: whether they get windows.
    """
    dt = float(np.median(np.concatenate([np.diff(toss.t) for toss in tosses])))
    most, K = max(length, long), tosses[0].v.shape[1]
    cuts = [(i, first, n) for i, toss in enumerate(tosses) for first, n in _cuts(toss, dt, length, long, skip)]
    following = len(cuts)
    scatter = (0.0, 0.0) if model is None else rest_scatter(tosses, model)
    if model is not None and first_flights:
        cuts += [(i, first, n) for i, toss in enumerate(tosses) for first, n in _first_flight(toss, model, dt, long)]
    W = len(cuts)
    q, v, y = np.empty((W, K + 1)), np.empty((W, K)), np.empty((W, most, K + 1))
    y_noise, first_noise = np.empty((W, most, K)), np.empty((W, K))
    mix, frame, phase = np.zeros((W, length, most)), np.zeros((W, length), int), np.zeros((W, length), np.uint8)
    for w, (i, first, n) in enumerate(cuts):
        toss = tosses[i]
        poses, cov = toss.measured
        at = np.minimum(np.arange(first + 1, first + most + 1), first + n)
        std = np.maximum(_std(cov[first : first + n + 1]), np.append(LEAST_NOISE, [LEAST_NOISE[-1]] * (K - 6)))
        q[w], v[w], y[w] = poses[first], toss.v[first], poses[at]
        first_noise[w], y_noise[w] = std[0], std[at - first]
        each = -(-n // length)
        for row in range(-(-n // each)):
            some = np.arange(row * each, min((row + 1) * each, n))
            mix[w, row, some] = 1 / len(some)
            frame[w, row], phase[w, row] = first + 1 + some[0], toss.phase[first + 1 + some[0]]
    inside = np.asarray(mix.any(axis=2))
    slow = _slow(q[:, 3:7], y[..., 3:7], mix, np.array([scatter[0]] * 3 + [scatter[1]] * (K - 3)))
    noise = np.where(inside[..., None], np.sqrt(mix**2 @ y_noise**2), 1.0)
    speeds = np.tile([SPEED_PRIOR] * 3 + [SPIN_PRIOR] * (K - 3), (W, 1))
    return Windows(
        q=q,
        v=v,
        at_q=q.copy(),
        at_v=v.copy(),
        y=y,
        y_noise=y_noise,
        steps=np.array([n for _, _, n in cuts]),
        mix=mix,
        noise=noise,
        inside=inside,
        toss=np.array([i for i, _, _ in cuts]),
        frame=frame,
        phase=phase,
        dt=dt,
        prior=np.concatenate([first_noise, speeds], axis=1),
        slow=slow,
        root=_noise_root(slow, np.concatenate([first_noise[:, None], noise], axis=1)),
        free=np.arange(W) >= following,
    )


def _std(cov: Array) -> Array:
    """(n, K) standard deviations of covariances (n, K, K)."""
    out: Array = np.sqrt(np.maximum(np.einsum("nii->ni", cov), 0.0))
    return out


def _slow(first: Array, then: Array, mix: Array, scatter: Array) -> Array:
    """(W, K, L + 1, L + 1) covariances of errors that change with attitude as a smooth Gaussian process does.

    Args:
        first: (W, 4) attitudes; then: (W, F, 4), of which a row has that of the frame in its middle (mix (W, L, F)).
        scatter: (K,) standard deviations.
    """
    W, L, _ = mix.shape
    out = np.zeros((W, len(scatter), L + 1, L + 1))
    if not scatter.any():
        return out
    middle = np.rint((mix * np.arange(mix.shape[2])).sum(2)).astype(int)
    attitude = np.concatenate([first[:, None], np.take_along_axis(then, middle[..., None], axis=1)], axis=1)
    # of the chord between rotation matrices, 1 - cos(angle): of the angle itself, the process would be none
    apart = 2 * (1 - (attitude @ attitude.mT) ** 2)
    there = np.concatenate([np.ones((W, 1), bool), mix.any(axis=2)], axis=1)
    alike = np.exp(-apart / TURN**2) * there[:, :, None] * there[:, None, :]
    out[:] = scatter[:, None, None] ** 2 * alike[:, None]
    return out


def _noise_root(slow: Array, noise: Array) -> Array:
    """(W, K, L + 1, L + 1) inverse Cholesky factors of slow errors and noise; noise (W, L + 1, K)."""
    cov = slow.copy()
    index = np.arange(cov.shape[-1])
    cov[..., index, index] += noise.transpose(0, 2, 1) ** 2
    out: Array = np.linalg.inv(np.linalg.cholesky(cov))
    return out


def _first_flight(toss: Toss, model: ObjectModel, dt: float, long: int) -> list[tuple[int, int]]:
    """First frames and numbers of further frames of windows over the flight that a toss begins with.

    It ends where the stated object may touch the stated ground, or, as neither may be right, where the acceleration
    jumps or a frame is missing.
    """
    end = flight_frames(toss, model) - 1
    missing = np.flatnonzero(np.abs(np.diff(toss.t[: end + 1]) / dt - 1) > UNEVEN)
    end = min(end, int(missing[0])) if len(missing) else end
    if end < SHORTEST_FLIGHT:
        return []
    poses, cov = toss.measured
    # velocities over three frames, after less before
    place, s = poses[: end + 1, :3], 3
    bend = (place[2 * s :] - 2 * place[s:-s] + place[: -2 * s]) / (s * dt)
    noise = np.sqrt(6 * np.maximum(np.einsum("nii->ni", cov[: end + 1])[:, :3].max(), 0.0)) / (s * dt)
    jumped = np.flatnonzero(np.linalg.norm(bend - np.median(bend, axis=0), axis=1) > JUMP * GRAVITY * dt + 6 * noise)
    end = min(end, s + int(jumped[0])) if len(jumped) else end
    if end < SHORTEST_FLIGHT:
        return []
    parts = -(-end // long)
    edges = [end * k // parts for k in range(parts + 1)]
    return [(first, last - first) for first, last in itertools.pairwise(edges)]


def _cuts(toss: Toss, dt: float, length: int, long: int, skip: int) -> list[tuple[int, int]]:
    """First frames and numbers of further frames of a toss's windows."""
    missing = np.flatnonzero(np.abs(np.diff(toss.t) / dt - 1) > UNEVEN)
    flying = toss.phase == Phase.FLIGHT
    poses, cov = toss.measured
    std = _std(cov)
    out = []
    for begin, end in itertools.pairwise([-1, *missing.tolist(), len(toss) - 1]):
        first = max(begin + 1, skip)
        while end - first >= length // 2:
            landing = int(np.argmin(np.append(flying[first : end + 1], False)))
            near = slice(first, min(end, first + long) + 1)
            away = np.abs(difference(poses[near], poses[first])) > STILL * std[near]
            moving = int(np.argmax(np.append(away.any(axis=1), True)))
            n = min(max(landing - 1 - BEFORE_LANDING, moving - 1), long)
            if n <= length:
                n = min(length, end - first)
            out.append((first, n))
            first += n
    return out
