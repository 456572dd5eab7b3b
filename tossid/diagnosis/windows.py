"""Short predictions from states that are known as well as they were measured, and their whitened misses.

A toss is cut into windows, and its first flight is in one more. In each, the simulator f starts from a state x that is
a nuisance: its pose is known as well as poses are measured, its velocity hardly at all (recorded velocities lag, and
are smeared over impacts). With S = df/dx and poses y with noise R, to first order around x_0,

    y - f(x_0) - S (x_rec - x_0) ~ N(0, R + S P S^T),

P the covariance of the recorded state x_rec. Whitened by the Cholesky factor in the order of time, every entry is
the innovation of one frame and channel given the frames before it: of unit variance where the simulator is right,
whatever the first state was.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtri

from tossid.errors import SolverError
from tossid.motion.flight import flight_frames
from tossid.motion.resting import rest_scatter
from tossid.objects import GRAVITY, ObjectModel
from tossid.physics.effects import World
from tossid.rotations import quat_boxminus, quat_exp, quat_mul, quat_normalize
from tossid.types import Phase, Toss

Array = NDArray[np.float64]

LENGTH = 20
"""Frames of a window in contact; rows of any."""
FLIGHT = 60
"""Frames of a window that is all flight."""
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
LOST = 3.0
"""Miss [m, rad] that counts for a frame whose simulation diverged."""
UNEVEN = 0.3
"""Share by which a time step may differ from the median one."""
BAD = 3.0
"""Standard deviations of chi-squared by which a window's cost may exceed its mean."""
RESTART_STEPS, AFRESH_STEPS = 4, 6
SETTLED = 0.02
"""By how much a window's cost falls at least in a step, for another one."""
MOST_DAMPED = 1e3
TURN = 1.0
"""[rad] by which an object turns until a tracker's slow errors are others: other tags come into view."""
SAME = 0.3
"""Standard deviations of poses by which predictions differ, for derivatives to be taken again."""
_SPEEDS = np.arange(6, 12)
_MOST = np.array([0.01] * 3 + [0.1] * 3 + [1.0] * 3 + [10.0] * 3)
"""By how much a first state moves in a step."""
_STEPS = np.array([2e-4] * 3 + [2e-3] * 3 + [5e-3] * 3 + [3e-2] * 3)


def steps_of(world: World) -> dict[str, int]:
    """Simulator steps a frame, and parts of a step with an impact.

    With whole steps, near-rigid MuJoCo tosses miss by 1.49 standard deviations, in eight parts by 1.28 to 1.33; halving
    all steps costs more and brings less. Where contact yields, eight leave 5 mm after 40 frames and 32 leave 1.5 mm.
    """
    return {"substeps": 4, "impact_parts": 8 if world.object.compliance == 0 else 32}


@dataclass(frozen=True)
class Windows:
    """W windows of tosses of a single body: a first frame, and at most F frames after it, in at most L rows.

    In contact a row is a frame. In flight, where nothing is sudden, windows are longer and a row is the mean of a few
    frames: a weak force shows only over the whole of it.

    q (W, 7), v (W, 6): recorded first states. at_q, at_v: states around which predictions are linearised.
    y (W, F, 7): measured poses; y_noise (W, F, 6): their standard deviations [m, rad]; steps (W,): frames after the
    first. mix (W, L, F): rows' means of frames. noise (W, L, 6): of rows; inside (W, L): which rows there are.
    toss (W,): whose; frame (W, L): of a row's first frame. phase (W, L): of `Phase`. dt [s].
    prior (W, 12): standard deviations of the recorded states.
    slow (W, 2, L + 1, L + 1): covariances, of positions and of rotations, between the first pose and all rows, of
    errors that turn with the object: a tracker's calibration. Zeros: none. root (W, 6, L + 1, L + 1): inverse Cholesky
    factors of each channel's whole covariance, these errors and the noise.
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
    def counted(self) -> NDArray[np.bool_]:
        """(W, L) rows of the windows that follow one another, in which each frame is once."""
        return self.inside & ~self.free[:, None]

    @property
    def weights(self) -> Array:
        """(W,) what each window counts for: where only flight speaks clearly, contact is to add little."""
        return np.where(self.free, FLIGHT_WEIGHT, 1.0)

    def predicted(self, world: World, q: Array | None = None, v: Array | None = None, *, n_threads: int = 1) -> Array:
        """(W, F, 7) recorded poses as the world predicts them from (q, v), or from the states of linearisation."""
        q, v = (self.at_q if q is None else q), (self.at_v if v is None else v)
        steps = np.tile(self.steps, len(q) // len(self.steps))
        run = world.roll_out(q, v, n_steps=steps, dt=self.dt, **steps_of(world), n_threads=n_threads)
        return run[:, 1:]

    def misses(self, predicted: Array) -> Array:
        """(·, L, 6) measured less predicted: position [m], rotation vector in the body's frame [rad]; 0 outside."""
        W, F = len(self.y), predicted.shape[1]
        run = predicted.reshape(-1, W, F, 7)
        y = self.y[:, :F]
        out = np.concatenate([y[..., :3] - run[..., :3], quat_boxminus(y[..., 3:7], run[..., 3:7])], -1)
        out = np.clip(np.where(np.isfinite(out), out, LOST), -LOST, LOST)
        rows: Array = self.mix[..., :F] @ out
        return rows.reshape(-1, *rows.shape[2:])

    def rows(self, index: NDArray[np.int64]) -> Windows:
        """The windows of the given rows."""
        names = (field.name for field in fields(self) if field.name != "dt")
        return replace(self, **{name: getattr(self, name)[index] for name in names})


def make_windows(
    tosses: Sequence[Toss],
    model: ObjectModel | None = None,
    *,
    length: int = LENGTH,
    flight: int = FLIGHT,
    skip: int = 0,
    first_flights: bool = True,
) -> Windows:
    """Cut tosses into windows that follow one another, and end where frames are missing; what is left at the end of
    a stretch is kept if half a window long.

    Args:
        model: whose first flights get windows of their own, and whose poses at rest tell static errors; without, there
            are neither.
        length: rows of a window, and frames of one that is not all flight.
        flight: frames of one that is.
        skip: frames of each toss that are left out at its beginning, to cut it elsewhere.
        first_flights: whether they get windows.
    """
    dt = float(np.median(np.concatenate([np.diff(toss.t) for toss in tosses])))
    most = max(length, flight)
    cuts = [(i, first, n) for i, toss in enumerate(tosses) for first, n in _cuts(toss, dt, length, flight, skip)]
    following = len(cuts)
    scatter = (0.0, 0.0) if model is None else rest_scatter(tosses, model)
    if model is not None and first_flights:
        cuts += [(i, first, n) for i, toss in enumerate(tosses) for first, n in _first_flight(toss, model, dt, flight)]
    W = len(cuts)
    q, v, y = np.empty((W, 7)), np.empty((W, 6)), np.empty((W, most, 7))
    y_noise, first_noise = np.empty((W, most, 6)), np.empty((W, 6))
    mix, frame, phase = np.zeros((W, length, most)), np.zeros((W, length), int), np.zeros((W, length), np.uint8)
    for w, (i, first, n) in enumerate(cuts):
        toss = tosses[i]
        poses, cov = toss.measured
        at = np.minimum(np.arange(first + 1, first + most + 1), first + n)
        std = np.sqrt(np.maximum(np.einsum("nii->ni", cov[first : first + n + 1])[:, :6], 1e-14))
        q[w], v[w], y[w] = poses[first], toss.v[first], poses[at]
        first_noise[w], y_noise[w] = std[0], std[at - first]
        each = -(-n // length)
        for row in range(-(-n // each)):
            some = np.arange(row * each, min((row + 1) * each, n))
            mix[w, row, some] = 1 / len(some)
            frame[w, row], phase[w, row] = first + 1 + some[0], toss.phase[first + 1 + some[0]]
    inside = np.asarray(mix.any(axis=2))
    slow = _slow(q[:, 3:], y[..., 3:], mix, scatter)
    noise = np.where(inside[..., None], np.sqrt(mix**2 @ y_noise**2), 1.0)
    speeds = np.tile([SPEED_PRIOR] * 3 + [SPIN_PRIOR] * 3, (W, 1))
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


def _slow(first: Array, then: Array, mix: Array, scatter: tuple[float, float]) -> Array:
    """(W, 2, L + 1, L + 1) covariances of errors that change with attitude as a smooth Gaussian process does.

    Args:
        first: (W, 4) attitudes; then: (W, F, 4), of which a row has that of the frame in its middle (mix (W, L, F)).
        scatter: standard deviations [m], [rad].
    """
    W, L, _ = mix.shape
    out = np.zeros((W, 2, L + 1, L + 1))
    if not any(scatter):
        return out
    middle = np.rint((mix * np.arange(mix.shape[2])).sum(2)).astype(int)
    attitude = np.concatenate([first[:, None], np.take_along_axis(then, middle[..., None], axis=1)], axis=1)
    # of the chord between rotation matrices, 1 - cos(angle): of the angle itself, the process would be none
    apart = 2 * (1 - (attitude @ attitude.mT) ** 2)
    there = np.concatenate([np.ones((W, 1), bool), mix.any(axis=2)], axis=1)
    alike = np.exp(-apart / TURN**2) * there[:, :, None] * there[:, None, :]
    out[:, 0], out[:, 1] = scatter[0] ** 2 * alike, scatter[1] ** 2 * alike
    return out


def _noise_root(slow: Array, noise: Array) -> Array:
    """(W, 6, L + 1, L + 1) inverse Cholesky factors of slow errors and noise; noise (W, L + 1, 6)."""
    cov = np.repeat(slow, 3, axis=1)
    index = np.arange(cov.shape[-1])
    cov[..., index, index] += noise.transpose(0, 2, 1) ** 2
    out: Array = np.linalg.inv(np.linalg.cholesky(cov))
    return out


def _first_flight(toss: Toss, model: ObjectModel, dt: float, flight: int) -> list[tuple[int, int]]:
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
    parts = -(-end // flight)
    edges = [end * k // parts for k in range(parts + 1)]
    return [(first, last - first) for first, last in itertools.pairwise(edges)]


def _cuts(toss: Toss, dt: float, length: int, flight: int, skip: int) -> list[tuple[int, int]]:
    """First frames and numbers of further frames of a toss's windows."""
    missing = np.flatnonzero(np.abs(np.diff(toss.t) / dt - 1) > UNEVEN)
    flying = toss.phase == Phase.FLIGHT
    out = []
    for begin, end in itertools.pairwise([-1, *missing.tolist(), len(toss) - 1]):
        first = max(begin + 1, skip)
        while end - first >= length // 2:
            landing = int(np.argmin(np.append(flying[first : end + 1], False)))
            n = min(landing - 1 - BEFORE_LANDING, flight)
            if n <= length:
                n = min(length, end - first)
            out.append((first, n))
            first += n
    return out


@dataclass(frozen=True)
class Whitening:
    """Inverse Cholesky factors (W, 6 L, 6 L) of the misses' covariance, and the misses' mean (W, 6 L) at a right model.

    volume (W,): log determinant of the factors, which densities of different whitenings need to be compared.
    by_state (W, 6 L, 12): the predictions' derivatives by the first states, taken where misses were `at` (W, 6 L).
    other (W, 6 L): the other engine's difference.
    """

    root: Array
    mean: Array
    volume: Array
    by_state: Array
    at: Array
    other: Array

    def __call__(self, misses: Array) -> Array:
        """(W, L, 6) -> whitened (W, L, 6)."""
        W, L, _ = misses.shape
        flat = misses.reshape(W, -1) - self.mean
        return (self.root @ flat[..., None])[..., 0].reshape(W, L, 6)

    def rows(self, index: NDArray[np.int64]) -> Whitening:
        """Those of some windows."""
        return Whitening(*(getattr(self, field.name)[index] for field in fields(self)))


def linearise(
    windows: Windows,
    world: World,
    *,
    refine: int = 2,
    restarts: int = 0,
    near: Whitening | None = None,
    anew: bool = True,
    engines: tuple[Array, float] | None = None,
    n_threads: int = 1,
) -> tuple[Windows, Whitening]:
    """First states as the windows' own frames tell them under this world, and the whitening there.

    Args:
        refine: steps of Gauss and Newton, damped as Marquardt does, of the first states.
        restarts: how often windows that fit badly are begun anew, from the recorded states and from states near by:
            where contact opens or closes, the first state has several minima.
        near: the whitening of a world and states near by. Its derivatives spare those before the last; and those too
            in windows whose predictions are still the same.
        anew: whether the last are taken; if not, the whitening has the derivatives of `near`.
        engines: how another engine's predictions of the same rigid contact differ (W, L, 6), and how many times
            that is expected in the misses: the number is a nuisance of standard deviation 1.
    """
    W, L = windows.inside.shape
    none = np.zeros((W, L, 6)), 0.0
    other, center = engines or none
    other = other.reshape(W, 6 * L)
    kept, miss, S, cost = _estimated(windows, world, (other, center), refine, near, n_threads)
    n = 6 * windows.inside.sum(1)
    rng = np.random.default_rng(0)
    fresh = np.full(W, near is None)
    led = not np.array_equal(windows.at_v, windows.v)
    for turn in range(restarts):
        bad = np.flatnonzero(cost > n + BAD * np.sqrt(2 * n))
        if not len(bad):
            break
        some = kept.rows(bad)
        # once from what was recorded, if another hypothesis has led to where they are; then from near by
        afresh = led and turn == 0
        at_q, at_v = (some.q, some.v) if afresh else _moved(some.at_q, some.at_v, _near(some, S[bad], rng))
        tried, *there = _estimated(
            replace(some, at_q=at_q, at_v=at_v),
            world,
            (other[bad], center),
            AFRESH_STEPS if afresh else RESTART_STEPS,
            None,
            n_threads,
        )
        better = there[-1] < cost[bad]
        kept = _with_states(kept, bad[better], tried.at_q[better], tried.at_v[better])
        miss, S, cost = (_with(old, bad[better], new[better]) for old, new in zip((miss, S, cost), there, strict=True))
        fresh[bad[better]] = True
    at, stale = miss, np.zeros(0, int)
    if near is not None:
        moved = (np.abs(miss - near.at) / np.sqrt(_variances(windows))).max(1)
        stale = np.flatnonzero((moved > SAME) & ~fresh) if anew else stale
        if len(stale):
            S = _with(S, stale, _sensitivity(kept.rows(stale), world, n_threads=n_threads)[1])
        fresh[stale] = True
        at = np.where(fresh[:, None], miss, near.at)
    return kept, _whitening(kept, S, at, other, center, near, fresh)


def _with(values: Array, index: NDArray[np.int64], new: Array) -> Array:
    """A copy with rows replaced."""
    out = values.copy()
    out[index] = new
    return out


def _with_states(windows: Windows, index: NDArray[np.int64], at_q: Array, at_v: Array) -> Windows:
    """The windows, some of them at other states."""
    return replace(windows, at_q=_with(windows.at_q, index, at_q), at_v=_with(windows.at_v, index, at_v))


def _near(at: Windows, S: Array, rng: np.random.Generator) -> Array:
    """(W, 12) moves of first states, drawn from twice their posterior's spread."""
    columns, _ = _whitened(at, S.reshape(len(S), -1, 6, 12), np.zeros((len(S), *at.inside.shape[1:], 6)))
    H = columns.mT @ columns
    H[:, _SPEEDS, _SPEEDS] += at.prior[:, 6:] ** -2.0
    # H = L L^T, so that L^-T z has covariance H^-1
    draw = rng.normal(size=(len(S), 12, 1))
    return 2 * np.linalg.solve(np.linalg.cholesky(H).mT, draw)[..., 0]


def _variances(windows: Windows) -> Array:
    """(W, 6 L) of the poses; 1 outside."""
    W, L = windows.inside.shape
    return np.where(np.repeat(windows.inside, 6, axis=1), (windows.noise**2).reshape(W, 6 * L), 1.0)


def _estimated(
    windows: Windows,
    world: World,
    engines: tuple[Array, float],
    refine: int,
    near: Whitening | None,
    n_threads: int,
) -> tuple[Windows, Array, Array, Array]:
    """Windows at refined states, misses there (W, 6 L), derivatives S (W, 6 L, 12), and costs (W,): -2 log posterior,
    but for constants. A window whose cost falls no more is left as it is."""
    W, L = windows.inside.shape
    other, center = engines

    def examined(at: Windows, rows: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        if near is None:
            miss, S = _sensitivity(at, world, n_threads=n_threads)
        else:
            miss, S = at.misses(at.predicted(world, n_threads=n_threads)).reshape(len(rows), 6 * L), near.by_state[rows]
        return miss, S, _cost(at, (miss - center * other[rows]).reshape(-1, L, 6), other[rows].reshape(-1, L, 6))

    kept, damping, rows = windows, np.zeros(W), np.arange(W)
    miss, S, cost = examined(kept, rows)
    for _ in range(refine):
        some = kept.rows(rows)
        off = (miss[rows] - center * other[rows]).reshape(-1, L, 6)
        trial = _refined(some, off, S[rows], other[rows].reshape(-1, L, 6), damping[rows])
        trial_miss, trial_S, trial_cost = examined(trial, rows)
        better = trial_cost < cost[rows]
        falls = cost[rows] - trial_cost > SETTLED
        damping[rows] = np.where(better, damping[rows] / 10, np.maximum(10 * damping[rows], 1.0))
        index = rows[better]
        kept = _with_states(kept, index, trial.at_q[better], trial.at_v[better])
        miss, cost = _with(miss, index, trial_miss[better]), _with(cost, index, trial_cost[better])
        S = _with(S, index, trial_S[better]) if near is None else S
        rows = rows[falls | (~better & (damping[rows] < MOST_DAMPED))]
        if not len(rows):
            break
    return kept, miss, S, cost


def _whitened(at: Windows, by_state: Array | None, miss: Array) -> tuple[Array, Array]:
    """What the first state (W, L, 6, 12) and anything else (W, L, 6) put into the first recorded pose and into the
    misses, in standard deviations of the poses' errors: (W, 6 (L + 1), 12) and (W, 6 (L + 1)).

    Before `miss` comes the recorded first pose less that of linearisation, and before by_state's columns their 1.
    """
    W = len(miss)
    if by_state is None:
        columns = np.zeros((W, 0, 0))
    else:
        first = np.broadcast_to(np.eye(6, 12), (W, 1, 6, 12))
        stacked = np.concatenate([first, by_state], axis=1).transpose(0, 2, 1, 3)
        columns = (at.root @ stacked).reshape(W, -1, 12)
    whole = np.concatenate([_off(at)[:, None, :6], miss], axis=1).transpose(0, 2, 1)
    return columns, (at.root @ whole[..., None]).reshape(W, -1)


def _other(at: Windows, other: Array) -> Array:
    """(W, 6 (L + 1)) the other engine's difference (W, L, 6), whitened as misses are."""
    whole = np.concatenate([np.zeros_like(other[:, :1]), other], axis=1).transpose(0, 2, 1)
    out: Array = (at.root @ whole[..., None]).reshape(len(other), -1)
    return out


def _cost(at: Windows, miss: Array, other: Array) -> Array:
    """(W,) -2 log posterior of first states, but for constants, with the best share of the other engine."""
    _, r = _whitened(at, None, miss)
    o = _other(at, other)
    along = (o * r).sum(1) ** 2 / (1 + (o**2).sum(1))
    out: Array = np.minimum(r**2, 1e6).sum(1) - np.minimum(along, 1e6)
    return out + (_off(at)[:, 6:] ** 2 / at.prior[:, 6:] ** 2).sum(1)


def _refined(at: Windows, miss: Array, S: Array, other: Array, damping: Array) -> Windows:
    """States moved toward their posterior mean, by information: 12 numbers a window, and the other engine's share.

    damping (W,): Marquardt's.
    """
    columns, r = _whitened(at, S.reshape(len(S), -1, 6, 12), miss)
    columns = np.concatenate([columns, _other(at, other)[..., None]], axis=2)
    H, g = columns.mT @ columns, (columns.mT @ r[..., None])[..., 0]
    H[:, _SPEEDS, _SPEEDS] += at.prior[:, 6:] ** -2.0
    H[:, 12, 12] += 1.0
    g[:, 6:12] += _off(at)[:, 6:] / at.prior[:, 6:] ** 2
    index = np.arange(13)
    H[:, index, index] *= 1 + damping[:, None]
    delta = np.linalg.solve(H, g[..., None])[:, :12, 0]
    at_q, at_v = _moved(at.at_q, at.at_v, np.clip(delta, -_MOST, _MOST))
    return replace(at, at_q=at_q, at_v=at_v)


def _whitening(
    windows: Windows,
    S: Array,
    at: Array,
    other: Array,
    center: float,
    near: Whitening | None,
    fresh: NDArray[np.bool_],
) -> Whitening:
    """Whitening of windows; `near` has the factors where no derivatives are fresh and the other engine is as it was."""
    mean = (S @ _off(windows)[..., None])[..., 0] + center * other
    mean[~np.repeat(windows.inside, 6, axis=1)] = 0.0
    new = np.arange(len(S)) if near is None else np.flatnonzero(fresh | (other != near.other).any(1))
    some, by_pose = windows.rows(new), S[new, :, :6]
    W, L = some.inside.shape
    slow = np.repeat(some.slow, 3, axis=1)
    # the first pose's own error (its noise and slow part), its speeds, and the other engine
    first = np.sqrt(some.prior[:, :6] ** 2 + slow[:, :, 0, 0])
    speeds = S[new, :, 6:] * some.prior[:, None, 6:]
    SP = np.concatenate([by_pose * first[:, None], speeds, other[new, :, None]], axis=2)
    cov = SP @ SP.mT
    index = np.arange(cov.shape[1])
    cov[:, index, index] += _variances(some)
    if slow.any():
        # rows' slow errors are those of the first pose, as far as they are alike
        shared = (by_pose[:, :, None, :] * slow[:, :, 0, 1:].transpose(0, 2, 1)[:, None]).reshape(W, 6 * L, 6 * L)
        cov -= shared + shared.mT
        blocks = cov.reshape(W, L, 6, L, 6)
        for c in range(6):
            blocks[:, :, c, :, c] += slow[:, c, 1:, 1:]
    root = np.zeros((len(S), *cov.shape[1:])) if near is None else near.root.copy()
    for k, factor in zip(new, np.linalg.cholesky(cov), strict=True):
        root[k] = _inverse_lower(factor)
    return Whitening(root, mean, np.log(np.einsum("wii->wi", root)).sum(1), S, at, other)


def _inverse_lower(factor: Array) -> Array:
    """Inverse of a lower triangular matrix; LAPACK's own is six times as fast as a general one."""
    inverse, status = dtrtri(factor, lower=1)
    if status:
        raise SolverError("a window's covariance is singular", total=1)
    return np.asarray(inverse)


def _sensitivity(windows: Windows, world: World, *, n_threads: int) -> tuple[Array, Array]:
    """Misses (W, 6 L) at the states of linearisation, and S (W, 6 L, 12)."""
    W, L = windows.inside.shape
    q, v = [windows.at_q], [windows.at_v]
    for j in range(12):
        delta = np.zeros((W, 12))
        delta[:, j] = _STEPS[j]
        moved_q, moved_v = _moved(windows.at_q, windows.at_v, delta)
        q.append(moved_q)
        v.append(moved_v)
    run = windows.predicted(world, np.concatenate(q), np.concatenate(v), n_threads=n_threads)
    miss = windows.misses(run).reshape(13, W, 6 * L)
    S = (miss[0] - miss[1:]) / _STEPS[:, None, None]
    return miss[0], np.moveaxis(S, 0, -1)


def _off(at: Windows) -> Array:
    """Recorded first states less those of linearisation (W, 12)."""
    turned = quat_boxminus(at.q[:, 3:7], at.at_q[:, 3:7])
    return np.concatenate([at.q[:, :3] - at.at_q[:, :3], turned, at.v - at.at_v], axis=1)


def _moved(q: Array, v: Array, delta: Array) -> tuple[Array, Array]:
    turned = quat_normalize(quat_mul(q[:, 3:7], quat_exp(delta[:, 3:6])))
    return np.concatenate([q[:, :3] + delta[:, :3], turned], axis=1), v + delta[:, 6:]
