"""The gap: how far a world's predictions miss, where, and how much of it is left when effects are in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.evidence import CAP, N_PHASES, Evidence, student_deviance
from tossid.diagnosis.findings import Gap, Interval, Share, Step
from tossid.diagnosis.judging import RESTARTS, Candidate, Judge
from tossid.diagnosis.whitening import linearise
from tossid.diagnosis.windows import LENGTH, Windows, make_windows, moved_pose, steps_of
from tossid.motion import flight_states
from tossid.physics.effects import World
from tossid.rotations import geodesic_angle
from tossid.types import Phase, Toss

Array = NDArray[np.float64]

PHASES = (Phase.FLIGHT, Phase.IMPACT, Phase.SLIDE, Phase.ROLL, Phase.REST)
CHANNELS = ("p_x", "p_y", "p_z", "r_x", "r_y", "r_z")
"""Of the base; those of joints are joint_1 and so on."""
LENGTHS = (5, 10, LENGTH, 40)
RESAMPLES = 500
LEFT = 0.15
"""Share of a phase's first gap above which something is left there."""


def deviance(evidence: Evidence, residual: Array) -> Array:
    """(W, L, K) Student's deviance of whitened misses, in the windows that follow one another; 0 outside them."""
    return np.where(evidence.windows.counted[..., None], student_deviance(residual), 0.0)


def by_toss(evidence: Evidence, values: Array, n: int) -> Array:
    """(n,) sums over each toss's windows of (W, ...)."""
    sums = np.bincount(evidence.windows.toss, weights=values.reshape(len(values), -1).sum(1), minlength=n)
    return sums.astype(float)


def bootstrap_ratio(above: Array, below: Array, *, seed: int = 0) -> Interval:
    """sum(above) / sum(below) with its percentile interval over tosses."""
    rng = np.random.default_rng(seed)
    n = len(above)
    index = rng.integers(0, n, (RESAMPLES, n))
    bottom = below[index].sum(1)
    ratio = above[index].sum(1) / np.where(np.abs(bottom) > 1e-9, bottom, 1e-9)
    low, high = np.percentile(ratio, [2.5, 97.5])
    total = below.sum()
    return Interval(float(above.sum() / (total if abs(total) > 1e-9 else 1e-9)), float(low), float(high))


@dataclass(frozen=True)
class Floor:
    """What noise and uncertain first states alone leave: deviance (W, L, K), and the root mean square."""

    deviance: Array
    rms: float


def measure_gap(tosses: Sequence[Toss], state: Candidate, judge: Judge, floor: Floor) -> Gap:
    """The gap of a world, in all its cuts."""
    n, e, residual = judge.n, state.evidence, state.fitted.residual
    w = e.windows
    squares = np.where(w.counted[..., None], np.minimum(residual**2, CAP**2), 0.0)
    per_toss = by_toss(e, squares, n)
    count = by_toss(e, np.where(w.counted[..., None], np.ones_like(residual), 0.0), n)
    ratio = bootstrap_ratio(per_toss, count)
    total = Interval(*(float(np.sqrt(max(x, 0.0))) for x in (ratio.value, ratio.low, ratio.high)))
    excess = deviance(e, residual) - floor.deviance
    whole = by_toss(e, excess, n)
    share = []
    for phase in PHASES:
        inside = (w.phase == phase)[..., None]
        share.append(Share(phase.name.lower(), bootstrap_ratio(by_toss(e, np.where(inside, excess, 0.0), n), whole)))
    channels = []
    for c, name in enumerate(channels_of(residual.shape[-1])):
        channels.append(Share(name, bootstrap_ratio(by_toss(e, excess[..., c], n), whole)))
    toss = np.broadcast_to(w.toss[:, None], w.frame.shape)
    rows = np.stack([toss, w.frame * w.dt, w.phase, excess.mean(-1)], axis=-1)[w.counted]
    mean = per_toss / np.maximum(count, 1)
    middle = np.median(mean)
    far = middle + 8 * np.median(np.abs(mean - middle)) + 1.0
    odd = tuple(toss.name for toss, size in zip(tosses, mean, strict=True) if size > far)
    others = [length for length in LENGTHS if length != LENGTH]
    rms = dict(zip(others, judge.each(lambda length: _rms_of(tosses, length, state, judge), others), strict=True))
    lengths = tuple((length, rms.get(length, total.value), 1.0) for length in LENGTHS)
    return Gap(total, floor.rms, tuple(share), tuple(channels), lengths, rows, odd)


def channels_of(count: int) -> tuple[str, ...]:
    """Names of so many channels."""
    return CHANNELS + tuple(f"joint_{k + 1}" for k in range(count - len(CHANNELS)))


def _rms_of(tosses: Sequence[Toss], length: int, state: Candidate, judge: Judge) -> float:
    """Root mean square of whitened misses in windows of so many frames."""
    world, model = state.hypothesis.world(), state.hypothesis.base.object
    windows = make_windows(tosses, model, length=length, long=0, first_flights=False)
    # of short ones some are enough
    windows = windows.rows(np.arange(0, len(windows.toss), max(1, LENGTH // length)))
    kept, whitening = linearise(windows, world, n_threads=judge.n_threads)
    evidence = judge.with_engine(Evidence(kept, whitening, judge.n_threads), state.hypothesis, restarts=0)
    r = evidence.residual(world)[evidence.windows.inside]
    return float(np.sqrt(np.minimum(r**2, CAP**2).mean()))


def noise_floor(state: Candidate, judge: Judge, *, seed: int) -> Floor:
    """The floor, from motions that the world itself makes from the windows' states, measured as the tosses were.

    It is never above what the world leaves: noise that is smaller than stated is no gap that closes twice.
    """
    e, world = state.evidence, state.hypothesis.world()
    w = e.windows
    rng = np.random.default_rng(seed + 1)
    truth = w.predicted(world, n_threads=judge.n_threads)
    truth = np.where(np.isfinite(truth), truth, w.y[:, : truth.shape[1]])
    before, slow = _slow_errors(w, truth.shape[1], rng)
    noise = w.y_noise[:, : truth.shape[1]] * rng.normal(size=slow.shape) + slow
    y = moved_pose(truth, noise)
    first = w.prior[:, : w.channels] * rng.normal(size=before.shape) + before
    q, v = moved_pose(w.at_q, first), w.v  # velocities as far off as those recorded
    made = replace(w, y=y, q=q, v=v, at_q=q, at_v=v)
    # the other engine's share is part of what windows may show, and here there is none
    engines = None if e.engines is None else replace(e.engines, expected=0.0)
    kept, whitening = linearise(made, world, refine=6, restarts=RESTARTS, engines=engines, n_threads=judge.n_threads)
    r = Evidence(kept, whitening, judge.n_threads).residual(world)
    values, achieved, out = deviance(e, r), deviance(e, state.fitted.residual), np.zeros_like(r)
    for phase in range(N_PHASES):
        chosen = (w.phase == phase) & w.counted
        if chosen.any():
            out[chosen] = np.minimum(values[chosen].mean(0), achieved[chosen].mean(0))
    rms = (np.sqrt(np.minimum(x[w.counted] ** 2, CAP**2).mean()) for x in (r, state.fitted.residual))
    return Floor(out, float(min(rms)))


def _slow_errors(w: Windows, frames: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Errors that turn with the object (`Windows.slow`): of first poses (W, K) and of frames (W, frames, K)."""
    (W, L), K = w.inside.shape, w.channels
    drawn = np.zeros((W, L + 1, K))
    if w.slow.any():
        cov = w.slow.copy()
        index = np.arange(L + 1)
        cov[..., index, index] += 1e-9 * cov[..., :1, 0] + 1e-30
        drawn = (np.linalg.cholesky(cov) @ rng.normal(size=(W, K, L + 1, 1)))[..., 0].transpose(0, 2, 1)
    row = 1 + w.mix[..., :frames].argmax(axis=1)
    return drawn[:, 0], np.take_along_axis(drawn, row[..., None], axis=1)


def share_left(first: Candidate, last: Candidate, judge: Judge, floor: Floor) -> tuple[Interval, tuple[Share, ...]]:
    """Share of the first excess that is closed, each toss at the other folds' values; and phases with some left."""
    n = judge.n
    before = deviance(first.evidence, first.fitted.residual) - floor.deviance
    after = deviance(last.evidence, cross_fitted(last, judge)) - floor.deviance
    closed = bootstrap_ratio(
        by_toss(first.evidence, before, n) - by_toss(last.evidence, after, n), by_toss(first.evidence, before, n)
    )
    whole = by_toss(first.evidence, before, n)
    left = []
    for phase in PHASES:
        there = np.where((last.evidence.windows.phase == phase)[..., None], after, 0.0)
        share = bootstrap_ratio(by_toss(last.evidence, there, n), whole)
        if share.low > 0 and share.value > LEFT:
            left.append(Share(phase.name.lower(), share))
    return closed, tuple(left)


def cross_fitted(state: Candidate, judge: Judge) -> Array:
    """(W, L, K) whitened misses of every toss at values fitted to the other folds."""
    fitted, e = state.fitted, state.evidence
    if not fitted.hypothesis.effects:
        return fitted.residual
    out = fitted.residual.copy()
    for held in judge.folds:
        out[held[e.windows.toss]] = e.of_tosses(held).residual(fitted.of_part(~held).world())
    return out


def rollout_errors(
    tosses: Sequence[Toss], unseen: Sequence[Toss], state: Candidate, judge: Judge, begin: Windows | None = None
) -> Step:
    """Full-length rollouts from first states as flight tells them: of these tosses at values fitted to the other
    folds, of `unseen` ones, whose windows are to `begin` them, at the hypothesis's own."""
    errors = np.full((judge.n, 2), np.nan)
    for held in judge.folds:
        some = np.flatnonzero(held)
        chosen, own = [tosses[i] for i in some.tolist()], judge.windows.of_tosses(some)
        errors[held] = _errors(chosen, state.fitted.of_part(~held).world(), own, n_threads=judge.n_threads)
    squares = np.minimum(cross_fitted(state, judge) ** 2, CAP**2)
    counted = np.broadcast_to(state.evidence.windows.counted[..., None], squares.shape).astype(float)
    left = bootstrap_ratio(*(by_toss(state.evidence, each, judge.n) for each in (squares * counted, counted)))
    names = tuple(effect.name for effect in state.hypothesis.effects)
    if not unseen:
        return Step(names, *_means(errors), left)
    unseen_errors = _errors(unseen, state.hypothesis.world(), begin, n_threads=judge.n_threads)
    return Step(names, *_means(errors), left, *_means(unseen_errors))


def _errors(tosses: Sequence[Toss], world: World, windows: Windows | None = None, *, n_threads: int) -> Array:
    """(B, 2) mean distance [% of the object's width] and angle [deg] of rollouts from the recorded poses."""
    dt = float(np.median(np.concatenate([np.diff(toss.t) for toss in tosses])))
    q0, v0 = first_states(tosses, world, windows, n_threads=n_threads)
    steps = np.array([len(toss) - 1 for toss in tosses])
    run = world.roll_out(q0, v0, n_steps=steps, dt=dt, **steps_of(world), n_threads=n_threads)
    out = np.empty((len(tosses), 2))
    for row, toss in enumerate(tosses):
        q = run[row, : len(toss)]
        out[row, 0] = 100 * np.linalg.norm(q[:, :3] - toss.q[:, :3], axis=1).mean() / world.object.width
        out[row, 1] = np.rad2deg(geodesic_angle(q[:, 3:7], toss.q[:, 3:7])).mean()
    return out


def _means(errors: Array) -> tuple[Interval, Interval]:
    """Over tosses (B, 2), of those whose rollouts did not diverge."""
    good = errors[np.isfinite(errors).all(axis=1)]
    ones = np.ones(len(good))
    return bootstrap_ratio(good[:, 0], ones), bootstrap_ratio(good[:, 1], ones)


def first_states(
    tosses: Sequence[Toss], world: World, windows: Windows | None = None, *, n_threads: int = 1
) -> tuple[Array, Array]:
    """Recorded first states (B, nq), (B, nv) as each toss's first flight tells them in this world.

    Where that is a few frames, a ballistic fit has to do; of objects with joints, which have none, the first window.

    Args:
        windows: of these tosses, if they are at hand.
    """
    if windows is None:
        windows = make_windows(tosses, world.object)
    begin = np.flatnonzero(windows.frame[:, 0] == 1)
    if world.object.n_joints:
        # of a toss's windows that begin with it, the one of its first flight is the last
        begin = np.array([begin[windows.toss[begin] == i][-1] for i in range(len(tosses))])
        q, v = np.empty((len(tosses), world.object.nq)), np.empty((len(tosses), world.object.nv))
    else:
        begin, r = begin[windows.free[begin]], world.recording
        states = flight_states(tosses, world.object, gravity=world.gravity * r.length_scale / r.clock_rate**2)
        q, v = np.stack([s.q for s in states]), np.stack([s.v for s in states])
    if len(begin):
        kept, _ = linearise(windows.rows(begin), world, refine=6, restarts=RESTARTS, n_threads=n_threads)
        q[kept.toss], v[kept.toss] = kept.at_q, kept.at_v
    return q, v


__all__ = [
    "bootstrap_ratio",
    "by_toss",
    "cross_fitted",
    "deviance",
    "first_states",
    "measure_gap",
    "noise_floor",
    "rollout_errors",
    "share_left",
]
