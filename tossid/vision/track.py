"""From tag corners to a pose track: one rigid object, cameras and tags at known poses."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError, ObjectError
from tossid.objects import ObjectModel
from tossid.rotations import geodesic_angle, quat_continuous
from tossid.types import Detection, PoseTrack
from tossid.vision.camera import Camera
from tossid.vision.pose_fit import Fit, Observations, fit_poses, observations, residuals, tag_candidates

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

DIFFERENT = np.deg2rad(20.0)
"""Poses further apart than this are different hypotheses, not one pose with an error."""


@dataclass(frozen=True, slots=True)
class TrackSettings:
    """When to believe a pose.

    max_rms: largest rms reprojection of a time step [px].
    max_sigma [m], max_angle_sigma [rad]: largest standard deviation of a pose along any axis.
    outlier: whitened rms residual beyond which one tag among several is dropped.
    evidence: least difference in robust squared residuals between two hypotheses for the images alone to decide.
    max_spin [rad/s], max_speed [m/s]: motion between frames that is still believed.
    max_gap: longest time [s] over which a neighbour decides between hypotheses.
    """

    max_rms: float = 1.5
    max_sigma: float = 0.005
    max_angle_sigma: float = 0.06
    outlier: float = 6.0
    evidence: float = 25.0
    max_spin: float = 50.0
    max_speed: float = 10.0
    max_gap: float = 0.06


@dataclass(frozen=True, slots=True)
class TrackReport:
    """What became of the detections.

    n_steps: time steps with detections. n_poses: poses kept. rms: reprojection of all kept corners [px],
    rms_by_camera, rms_by_tag: the same in parts. noise_scale: standard deviation of the residuals over what
    the detections' covariances promise (the poses' covariances are scaled with it).
    dropped_steps: time steps without a pose, by reason. dropped_tags: detections left out, by reason.
    """

    n_steps: int
    n_poses: int
    rms: float
    rms_by_camera: dict[str, float]
    rms_by_tag: dict[int, float]
    noise_scale: float
    dropped_steps: dict[str, int] = field(default_factory=dict)
    dropped_tags: dict[str, int] = field(default_factory=dict)


def track(
    detections: Iterable[Detection],
    cameras: Sequence[Camera],
    model: ObjectModel,
    *,
    settings: TrackSettings = TrackSettings(),
    name: str = "track",
) -> tuple[PoseTrack, TrackReport]:
    """Estimate the object's pose at every time step.

    Each tag alone allows two poses (IPPE). Of all tags' candidates the one that
    explains all tags of all cameras best is refined jointly with the best one
    that lies elsewhere; where the images do not decide between the two, the
    neighbours in time do, and where these do not either there is no pose.

    Args:
        detections: of roughly synchronised cameras, in any order.
        cameras: of known pose. model: one rigid body with tags.

    Returns:
        the track, with covariances, and what was dropped and why.

    Raises:
        ObjectError: the object has joints or no tags.
        InputError: a detection of an unknown camera, or too few to make a track.
    """
    if model.n_bodies != 1:
        raise ObjectError(f"object '{model.name}' has {model.n_bodies} bodies; tracking takes one rigid body")
    if not model.tags:
        raise ObjectError(f"object '{model.name}' has no tags to track")
    dropped_tags: Counter[str] = Counter()
    usable = _usable(detections, cameras, model, dropped_tags)
    if not usable:
        raise InputError("no detection of any of the object's tags: nothing to track")
    step, t = _group(usable)
    obs = observations(usable, step, cameras, model.tags)
    best, other, fit_best = _hypotheses(obs, len(t), model, settings, dropped_tags)
    dropped = _Dropped(len(t))
    fit, obs_kept, used = fit_best
    position, quat, information = fit.position, fit.quat, fit.information
    rms = _by_step(fit.pixels**2, obs_kept.step, len(t)) ** 0.5
    dropped.mark(~(fit.ok & used), "no pose fits")
    dropped.mark(~(rms < settings.max_rms), "reprojection")
    scale = _noise_scale(fit, obs_kept, len(t), dropped.kept)
    unsure = other.exists & (other.cost - best.cost < settings.evidence * scale**2)
    _decide(t, position, quat, other, unsure & dropped.kept, dropped, settings)
    swapped = dropped.swapped
    position[swapped], quat[swapped] = other.position[swapped], other.quat[swapped]
    information[swapped] = other.information[swapped]
    cov = _covariances(information, scale, dropped)
    wide = np.sqrt(np.linalg.eigvalsh(cov[:, :3, :3])[:, -1]) > settings.max_sigma
    wide |= np.sqrt(np.linalg.eigvalsh(cov[:, 3:, 3:])[:, -1]) > settings.max_angle_sigma
    dropped.mark(wide, "too uncertain")
    dropped.mark(_jumps(t, position, quat, dropped.kept, settings), "jump")
    keep = np.flatnonzero(dropped.kept)
    if len(keep) < 2:
        raise InputError(f"only {len(keep)} of {len(t)} time steps gave a pose ({_words(dropped.reasons)})")
    q = np.concatenate([position[keep], quat_continuous(quat[keep])], axis=1)
    report = _report(obs_kept, position, quat, dropped, scale, len(t), dropped_tags, model)
    return PoseTrack(name, t[keep], q, cov[keep]), report


def _covariances(information: Array, scale: float, dropped: _Dropped) -> Array:
    """Inverse of the information of the steps that are left, times the noise scale squared. (n, 6, 6)."""
    known = information.copy()
    known[~dropped.kept] = np.eye(6)
    inverse = np.linalg.inv(known)
    return np.asarray(0.5 * scale**2 * (inverse + np.swapaxes(inverse, -1, -2)), dtype=float)


class _Dropped:
    """Which steps are left, and why the others are not."""

    def __init__(self, n: int) -> None:
        self.kept = np.ones(n, dtype=bool)
        self.swapped = np.zeros(n, dtype=bool)
        self.reasons: Counter[str] = Counter()

    def mark(self, bad: Bools, reason: str) -> None:
        fresh = bad & self.kept
        if fresh.any():
            self.reasons[reason] += int(fresh.sum())
        self.kept &= ~bad


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """One pose a step (NaN where `exists` is False), refined."""

    position: Array
    quat: Array
    cost: Array
    information: Array
    exists: Bools


def _words(reasons: Counter[str]) -> str:
    return ", ".join(f"{reason}: {count}" for reason, count in reasons.most_common()) or "none dropped"


def _usable(
    detections: Iterable[Detection], cameras: Sequence[Camera], model: ObjectModel, dropped: Counter[str]
) -> list[Detection]:
    names = {camera.name for camera in cameras}
    ids = {tag.id for tag in model.tags}
    usable = []
    for detection in detections:
        if detection.camera not in names:
            raise InputError(f"a detection is of camera '{detection.camera}', which is not calibrated")
        if detection.tag_id not in ids:
            dropped["id not on the object"] += 1
        elif not (np.isfinite(detection.corners).all() and np.linalg.det(detection.corner_cov) > 0):
            dropped["corners or covariance not finite"] += 1
        else:
            usable.append(detection)
    usable.sort(key=lambda detection: detection.t)
    return usable


def _group(detections: Sequence[Detection]) -> tuple[Ints, Array]:
    """Time step of each detection, and the steps' times: cameras' frames within 0.4 periods are one step."""
    by_camera: dict[str, list[float]] = {}
    for detection in detections:
        times = by_camera.setdefault(detection.camera, [])
        if not times or detection.t > times[-1]:
            times.append(detection.t)
    gaps = np.concatenate([np.diff(times) for times in by_camera.values()])
    window = 0.4 * float(np.median(gaps)) if len(gaps) else 0.0
    t = np.array([detection.t for detection in detections])
    step = np.zeros(len(t), dtype=np.int64)
    first, index = t[0], 0
    for i in range(len(t)):
        if t[i] - first > window:
            first, index = t[i], index + 1
        step[i] = index
    return step, np.bincount(step, weights=t) / np.bincount(step)


def _by_step(values: Array, step: Ints, n: int) -> Array:
    """Mean over the detections of each step; NaN for none."""
    count = np.bincount(step, minlength=n)
    with np.errstate(invalid="ignore"):
        return np.bincount(step, weights=values, minlength=n) / np.where(count > 0, count, np.nan)


def _hypotheses(
    obs: Observations, n: int, model: ObjectModel, settings: TrackSettings, dropped: Counter[str]
) -> tuple[_Hypothesis, _Hypothesis, tuple[Fit, Observations, Bools]]:
    """The best pose of each step and the best that lies elsewhere, both refined on the same detections."""
    position, quat = tag_candidates(obs, model.tags)
    first, second, exists = _choose(obs, position, quat, n)
    usable = np.asarray(np.isfinite(first[0]).all(axis=1))
    start = (np.where(usable[:, None], first[0], 0.0), np.where(usable[:, None], first[1], [1.0, 0, 0, 0]))
    fit = fit_poses(obs, *start)
    # a tag that contradicts the others is dropped, the worst of a step first, and the rest fitted again
    for _ in range(3):
        counts = np.bincount(obs.step, minlength=n)
        worst = np.zeros(n)
        np.maximum.at(worst, obs.step, fit.whitened)
        outlier = (fit.whitened > settings.outlier) & (fit.pixels > 0.5) & (counts[obs.step] > 1)
        outlier &= fit.whitened >= worst[obs.step]
        if not outlier.any():
            break
        dropped["contradicts the other tags"] += int(outlier.sum())
        obs = obs.take(~outlier)
        fit = fit_poses(obs, fit.position, fit.quat, iterations=6)
    best = _Hypothesis(fit.position, fit.quat, fit.cost, fit.information, fit.ok & usable)
    chosen = np.flatnonzero(exists)
    p2, q2 = np.full((n, 3), np.nan), np.full((n, 4), np.nan)
    cost, information = np.full(n, np.inf), np.tile(np.eye(6), (n, 1, 1))
    there = np.zeros(n, dtype=bool)
    if len(chosen):
        number = np.full(n, -1, dtype=np.int64)
        number[chosen] = np.arange(len(chosen))
        own = number[obs.step] >= 0
        again = fit_poses(obs.take(own, number[obs.step[own]]), second[0][chosen], second[1][chosen])
        p2[chosen], q2[chosen], cost[chosen] = again.position, again.quat, again.cost
        information[chosen] = again.information
        # a second start that ran to the first pose is no alternative
        apart = geodesic_angle(again.quat, fit.quat[chosen]) > DIFFERENT
        there[chosen] = again.ok & apart
        better = there & (cost < best.cost) & best.exists
        if better.any():
            for mine, theirs in (
                (fit.position, p2),
                (fit.quat, q2),
                (fit.cost, cost),
                (fit.information, information),
            ):
                mine[better], theirs[better] = theirs[better], mine[better].copy()
            fit = fit_poses(obs, fit.position, fit.quat, iterations=2)
            best = _Hypothesis(fit.position, fit.quat, fit.cost, fit.information, best.exists)
    return best, _Hypothesis(p2, q2, cost, information, there), (fit, obs, usable)


def _choose(
    obs: Observations, position: Array, quat: Array, n: int
) -> tuple[tuple[Array, Array], tuple[Array, Array], Bools]:
    """Of all candidates of a step the one that explains all its detections best, and the best one elsewhere."""
    d = len(obs.step)
    start = np.searchsorted(obs.step, np.arange(n))
    counts = np.diff(np.append(start, d))
    # every candidate's detection against every detection of its step
    source = np.repeat(np.arange(d), counts[obs.step])
    offset = np.arange(len(source)) - np.repeat(np.cumsum(counts[obs.step]) - counts[obs.step], counts[obs.step])
    target = start[obs.step[source]] + offset
    edge = np.linalg.norm(np.roll(obs.pixels, -1, axis=1) - obs.pixels, axis=-1).mean(axis=1)
    cost = np.full((d, 2), np.inf)
    block = 50_000
    for k in range(2):
        total = np.zeros(d)
        for a in range(0, len(source), block):
            s, g = source[a : a + block], target[a : a + block]
            usable = np.isfinite(position[s, k, 0])
            r, _ = residuals(
                obs.take(g),
                np.where(usable[:, None], position[s, k], 0.0),
                np.where(usable[:, None], quat[s, k], [1.0, 0, 0, 0]),
            )
            square = np.sum(r**2, axis=-1) / (0.2 * edge[g, None]) ** 2
            share = np.where(np.isfinite(square), square / (1 + square), 1.0)  # Geman and McClure
            total += np.bincount(s, weights=np.where(usable, share.sum(axis=1), np.inf), minlength=d)
        cost[:, k] = total
    cost[~np.isfinite(position[..., 0])] = np.inf
    # best of both per detection, then of each step
    first = _least(cost.reshape(-1), np.repeat(obs.step, 2), n)
    flat_p, flat_q = position.reshape(-1, 3), quat.reshape(-1, 4)
    apart = geodesic_angle(flat_q, flat_q[first][np.repeat(obs.step, 2)]) > DIFFERENT
    second_cost = np.where(apart & np.isfinite(cost.reshape(-1)), cost.reshape(-1), np.inf)
    second = _least(second_cost, np.repeat(obs.step, 2), n)
    exists = np.isfinite(second_cost[second])
    return (flat_p[first], flat_q[first]), (flat_p[second], flat_q[second]), exists


def _least(cost: Array, step: Ints, n: int) -> Ints:
    """Index of the least cost of each step (steps sorted)."""
    order = np.lexsort((cost, step))
    return order[np.searchsorted(step[order], np.arange(n))]


def _noise_scale(fit: Fit, obs: Observations, n: int, kept: Bools) -> float:
    """Residuals over their promised size: root of the median over steps of χ² by its degrees of freedom."""
    corners = 8.0 * np.bincount(obs.step, minlength=n)
    steps = kept & (corners >= 16)
    if steps.sum() < 20:
        return 1.0
    square = np.bincount(obs.step, weights=8 * fit.whitened**2, minlength=n)[steps]
    freedom = corners[steps] - 6
    # the median of χ² with k degrees of freedom is about k (1 - 2/(9k))³
    return float(np.clip(np.sqrt(np.median(square / (freedom * (1 - 2 / (9 * freedom)) ** 3))), 0.3, 30.0))


def _decide(
    t: Array,
    position: Array,
    quat: Array,
    other: _Hypothesis,
    unsure: Bools,
    dropped: _Dropped,
    settings: TrackSettings,
) -> None:
    """Settle the unsure steps by their nearest settled neighbours in time, outward from these."""
    settled = dropped.kept & ~unsure
    q = quat.copy()
    chosen = np.zeros(len(t), dtype=np.int64)  # 1: the first, 2: the other hypothesis
    for order in (range(len(t)), range(len(t) - 1, -1, -1)):
        last = -1
        for i in order:
            if settled[i]:
                last = i
                continue
            if not unsure[i] or last < 0 or abs(t[i] - t[last]) > settings.max_gap:
                continue
            angles = geodesic_angle(np.stack([quat[i], other.quat[i]]), q[last])
            near, far = int(np.argmin(angles)), int(np.argmax(angles))
            allowed = 0.5 * DIFFERENT + settings.max_spin * abs(t[i] - t[last])
            if angles[near] < allowed and angles[far] > 2 * angles[near]:
                chosen[i], settled[i], last = near + 1, True, i
                q[i] = quat[i] if near == 0 else other.quat[i]
    dropped.swapped |= chosen == 2
    dropped.mark(unsure & (chosen == 0), "ambiguous")


def _jumps(t: Array, position: Array, quat: Array, kept: Bools, settings: TrackSettings) -> Bools:
    """Steps that neither neighbour in time can have led to or come from."""
    index = np.flatnonzero(kept)
    bad = np.zeros(len(t), dtype=bool)
    if len(index) < 3:
        return bad
    dt = np.diff(t[index])
    turn = geodesic_angle(quat[index[1:]], quat[index[:-1]])
    way = np.linalg.norm(np.diff(position[index], axis=0), axis=1)
    broken = (turn > 0.5 * DIFFERENT + settings.max_spin * dt) | (way > 0.02 + settings.max_speed * dt)
    # runs between breaks; a short run that is cut off on both sides is wrong, not its neighbours
    edges = np.concatenate([[0], np.flatnonzero(broken) + 1, [len(index)]])
    longest = np.diff(edges).max()
    for a, b in itertools.pairwise(edges):
        if b - a < min(5, longest):
            bad[index[a:b]] = True
    return bad


def _report(
    obs: Observations,
    position: Array,
    quat: Array,
    dropped: _Dropped,
    scale: float,
    n: int,
    dropped_tags: Counter[str],
    model: ObjectModel,
) -> TrackReport:
    own = dropped.kept[obs.step]
    obs = obs.take(own)
    r, _ = residuals(obs, position[obs.step], quat[obs.step])
    square = np.mean(np.sum(r**2, axis=-1), axis=1)

    def rms(index: Bools) -> float:
        return float(np.sqrt(np.mean(square[index])))

    return TrackReport(
        n_steps=n,
        n_poses=int(dropped.kept.sum()),
        rms=rms(np.ones(len(square), dtype=bool)),
        rms_by_camera={c.name: rms(obs.camera == i) for i, c in enumerate(obs.cameras) if (obs.camera == i).any()},
        rms_by_tag={tag.id: rms(obs.tag == i) for i, tag in enumerate(model.tags) if (obs.tag == i).any()},
        noise_scale=scale,
        dropped_steps=dict(dropped.reasons),
        dropped_tags=dict(dropped_tags),
    )
