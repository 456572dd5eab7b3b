"""Offsets of any size between cameras' clocks, from the rigid motion that they share, wherever the cameras stand.

Each camera alone gives the motion of what it sees, in its own frame. At the right offset, one rigid transform takes the
motion that one camera sees to the motion that another sees. Of all offsets at once, Fourier transforms give the sums
from which the best transform and its misfit follow (Kabsch 1976). A correlation of speeds (Kalibr; Furrer et al. 2017)
needs derivatives, and confuses flights of the same speed; this does neither.

The offsets are right to a fraction of a fast camera's frame time, or to some milliseconds; the graph refines them.
"""

from __future__ import annotations

import heapq
import itertools
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from tossid.errors import InputError
from tossid.rotations import matrix_to_quat, quat_boxminus, quat_exp, quat_mul, transform
from tossid.settings.tracking import TrackSettings
from tossid.types import Detection
from tossid.vision.cameras.camera import Camera
from tossid.vision.pose_graph.initial import choose
from tossid.vision.pose_graph.resect import resect
from tossid.vision.pose_graph.scene import Scene, gap, observe
from tossid.vision.pose_graph.state import given, is_known
from tossid.vision.setup.layout import Body, TagLayout

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Motions = dict[str, list[tuple[Array, Array]]]
"""By what is seen, a body or a tag of unknown pose: pieces of its motion, times (m,) and T_cam_target (m, 4, 4)."""

SAME = 0.0005
"""Clocks that are no further apart are one [s]."""
REACH = 0.25
"""Offset up to which nobody may have noticed, and which so is likelier than a larger one [s]."""
STEP = 0.01
"""Step of the offsets [s]."""
FRAME = 0.015
"""Of a faster camera, only frames that are so far apart are used [s]."""
LONGEST = 1200.0
"""Of a longer recording, only so much of the start of each camera is used [s]."""
AT_ONCE = 512
"""Detections whose poses are found together; bounds the memory."""
OVERLAP = 0.3
"""Time for which two cameras must see the same thing at an offset [s]."""
ARM, FLOOR = 0.1, 0.01
"""Distance from a body's origin at which its turns count, and misfit that is noise; in shares of its distance."""
EVIDENCE = 1.0
"""Least evidence for an offset [s]: a motion that is known to a tenth of its extent has 4.6 in each second."""
UNEXPLAINED = 0.3
"""Largest share of the motion's variance that the rigid transform may leave."""
MISFIT_SHARE = 0.8
"""An offset that nobody may have noticed must bring the misfit below this share of that without it."""
PEAK_RATIO = 2.0
"""Evidence over that for any other offset, from which an offset is taken."""
PEAK_REACH, PEAK_COUNT = 0.25, 0.8
"""The least misfit of a peak is looked for so far from its largest evidence [s], at no fewer frames than this share."""
PEAK_EDGE = 1 / 3
"""Of an offset's log(spread / misfit), the share at which its peak ends."""


@dataclass(frozen=True)
class Clocks:
    """What the search found.

    Attributes:
        offsets: By how much cameras' time stamps are late [s], by name, of those that are not most cameras' time.
        doubts: Of cameras whose clocks can neither be compared nor be taken to agree: by name, why.
    """

    offsets: dict[str, float] = field(default_factory=dict)
    doubts: dict[str, str] = field(default_factory=dict)

    def in_time(self, detections: Iterable[Detection]) -> Iterable[Detection]:
        """Detections with the offsets subtracted, in order of time if each camera's are; read anew each time."""
        return _InTime(detections, self.offsets) if self.offsets else detections


@dataclass(frozen=True)
class _InTime(Iterable[Detection]):
    """Detections with cameras' offsets subtracted; see `Clocks.in_time`."""

    detections: Iterable[Detection]
    offsets: dict[str, float]

    def __iter__(self) -> Iterator[Detection]:
        shifts = sorted({0.0, *self.offsets.values()})
        return heapq.merge(*map(self._shifted, shifts), key=lambda d: d.t)

    def _shifted(self, shift: float) -> Iterator[Detection]:
        for d in self.detections:
            if self.offsets.get(d.camera, 0.0) == shift:
                yield replace(d, t=d.t - shift) if shift else d


def clock_offsets(
    detections: Iterable[Detection], cameras: Sequence[Camera], layout: TagLayout, *, settings: TrackSettings
) -> Clocks:
    """By how much later than most cameras' a camera's time stamps are.

    Args:
        detections: In order of time, camera by camera; gone through once.
        cameras: Those that they are of.
        layout: Bodies and their tags.
        settings: Of the choice between two poses.
    """
    if len(cameras) < 2:
        return Clocks()
    motions: dict[int, Motions] = defaultdict(lambda: defaultdict(list))
    thinned = _thinned(detections)
    while some := list(itertools.islice(thinned, AT_ONCE)):
        try:
            scene = observe(some, cameras, layout, dropped=Counter())
        except InputError:  # none is of a tag of the scene
            continue
        _add_motions(scene, motions, settings)
    grids = {c: grid for c in motions if (grid := _Grid(motions[c], settings)).length}
    clocks, why = _chained(grids, lambda a, c: stand_together(cameras[a], cameras[c], layout.bodies))
    apart = _most_at_zero(clocks) if clocks else {}
    return Clocks(
        {cameras[c].name: offset for c, offset in apart.items()},
        {cameras[c].name: reason.format(cameras[source].name) for c, (source, reason) in why.items()},
    )


def _most_at_zero(clocks: dict[int, float]) -> dict[int, float]:
    """Clocks that differ from the offset that most cameras share; of two cameras, the first one's counts as zero."""
    agreed = min(clocks.values(), key=lambda one: sum(abs(one - other) > SAME for other in clocks.values()))
    return {c: offset - agreed for c, offset in clocks.items() if abs(offset - agreed) > SAME}


def stand_together(a: Camera, c: Camera, bodies: Sequence[Body]) -> bool:
    """Whether the pose between two cameras never changes."""
    rigs = {a.rig_body, c.rig_body}
    return len(rigs) == 1 or all(body.is_static for body in bodies if body.name in rigs)


def _thinned(detections: Iterable[Detection]) -> Iterator[Detection]:
    """Detections of each camera's first `LONGEST` seconds, without frames that follow each other too fast."""
    first: dict[str, float] = {}
    last: dict[str, float] = {}
    for d in detections:
        if d.t - first.setdefault(d.camera, d.t) > LONGEST:
            continue
        if d.camera not in last or d.t == last[d.camera] or abs(d.t - last[d.camera]) >= FRAME:
            last[d.camera] = d.t
            yield d


def _add_motions(scene: Scene, motions: dict[int, Motions], settings: TrackSettings) -> None:
    """The motions that each camera alone sees in a scene, of what may move before it."""
    T_body_tag = given(scene).tag
    is_static = np.array([body.is_static for body in scene.bodies])
    body = scene.body[scene.tag]
    moving = ~(is_static[body] & is_static[scene.rig[scene.camera]]) & (scene.count == 1)
    known = is_known(T_body_tag)
    # bodies by their number, tags of unknown pose after them
    target = np.where(known[scene.tag], body, len(scene.bodies) + scene.tag)
    T_target_tag = np.where(known[:, None, None], T_body_tag, np.eye(4))[scene.tag]
    for c in map(int, np.unique(scene.camera[moving])):
        for i in map(int, np.unique(target[moving & (scene.camera == c)])):
            rows = np.flatnonzero(moving & (scene.camera == c) & (target == i))
            n = len(scene.bodies)
            name = scene.bodies[i].name if i < n else f"tag {scene.tags[i - n].id}"
            motions[c][name].append(_lone_motion(scene, rows, T_target_tag[rows], settings))


def _lone_motion(scene: Scene, rows: Ints, T_target_tag: Array, settings: TrackSettings) -> tuple[Array, Array]:
    """Something's motion by one camera alone: times (m,) and T_cam_target (m, 4, 4), where that is certain.

    Args:
        scene: The sightings.
        rows: Those of the camera of the target's tags, (k,).
        T_target_tag: Pose of each row's tag on the target, (k, 4, 4).
        settings: Of the choice between two poses.
    """
    steps, group = np.unique(scene.step[rows], return_inverse=True)
    poses = resect(scene.sightings(rows, np.eye(4), T_target_tag, group), len(steps))
    t = scene.t[steps] + scene.delay[rows[np.searchsorted(group, np.arange(len(steps)))]]
    T, certain = choose(poses, t, settings)
    return t[certain], T[certain]


def _interpolated(t: Array, T: Array, times: Array, max_gap: float) -> tuple[Array, Bools]:
    """Poses at some times (k,), between poses (m, 4, 4) at times (m,) in order; and which lie within no `gap`."""
    position, quat = T[:, :3, 3], matrix_to_quat(T[:, :3, :3])
    after = np.clip(np.searchsorted(t, times), 1, len(t) - 1)
    before = after - 1
    step = t[after] - t[before]
    share = (times - t[before]) / step
    good = (share >= 0) & (share <= 1) & (step <= gap(t, max_gap))
    share = np.clip(share, 0, 1)[:, None]
    turn = quat_mul(quat[before], quat_exp(share * quat_boxminus(quat[after], quat[before])))
    return transform(position[before] * (1 - share) + position[after] * share, turn), np.asarray(good)


class _Grid:
    """One camera's motions at evenly spaced times.

    Attributes:
        t: First time [s].
        length: Number of times; 0 where there is no motion.
        poses: By what is seen: T_cam_target (length, 4, 4), and where that is known (length,).
        middle: Mean position of what is seen [m], (3,).
        distance: Median distance of it [m].
    """

    def __init__(self, motions: Motions, settings: TrackSettings) -> None:
        joined = {}
        for name, parts in motions.items():
            t, at = np.unique(np.concatenate([part[0] for part in parts]), return_index=True)
            if len(t) > 1:
                joined[name] = t, np.concatenate([part[1] for part in parts])[at]
        self.poses: dict[str, tuple[Array, Bools]] = {}
        self.length = 0
        if joined:
            self.t = min(t[0] for t, _ in joined.values())
            self.length = int((max(t[-1] for t, _ in joined.values()) - self.t) / STEP) + 2
            times = self.t + STEP * np.arange(self.length)
            self.poses = {name: _interpolated(t, T, times, settings.max_gap) for name, (t, T) in joined.items()}
            p = np.concatenate([T[:, :3, 3] for _, T in joined.values()])
            self.middle, self.distance = p.mean(axis=0), float(np.median(p[:, 2]))


def _chained(
    grids: dict[int, _Grid], together: Callable[[int, int], bool]
) -> tuple[dict[int, float], dict[int, tuple[int, str]]]:
    """Clocks of cameras, each by one that is placed before it; and of the others against which one, and why not."""
    order = sorted(grids, key=lambda c: -sum(int(good.sum()) for _, good in grids[c].poses.values()))
    clocks: dict[int, float] = {}
    why: dict[int, tuple[int, str]] = {}
    sources = order[:1]
    for source in sources:  # grows
        clocks.setdefault(source, 0.0)
        for c in order:
            if c in clocks or not together(source, c) or not grids[source].poses.keys() & grids[c].poses.keys():
                continue
            offset, reason = _compared(grids[source], grids[c])
            if offset is not None:
                clocks[c] = clocks[source] + offset
                sources.append(c)
                why.pop(c, None)
            elif c not in why or not reason:
                why[c] = source, reason
    ordered = {c: clocks[c] for c in sorted(clocks)}
    return ordered, {c: found for c, found in why.items() if found[1]}


def _compared(a: _Grid, b: _Grid) -> tuple[float | None, str]:
    """How late b's clock is against a's, or None, and why.

    Where several offsets explain what both see, an unnoticed one is taken, and zero if it is among these.
    """
    offset, count, misfit, spread = _overlaps(a, b)
    sharpness = _sharpness(misfit, spread)
    evidence = STEP * count * np.where(count > 0, sharpness, 0.0)
    near = np.flatnonzero((np.abs(offset) <= REACH) & np.isfinite(misfit))
    too_little = "it and {} see too little motion in common"
    if evidence.max() < EVIDENCE:
        is_still = len(near) > 0 and max(misfit[near].max(), spread[near].max()) < 10 * FLOOR**2
        return (0.0, "") if is_still else (None, too_little)
    best = int(np.argmax(evidence))
    outside = np.flatnonzero(sharpness < PEAK_EDGE * sharpness[best])
    at = np.searchsorted(outside, best)
    edges = outside[[at - 1, at]] if 0 < at < len(outside) else np.array([0, len(offset) - 1])
    rival = evidence.copy()
    rival[edges[0] : edges[1] + 1] = 0.0
    second = int(np.argmax(rival))
    explains = misfit < UNEXPLAINED * spread
    has_edges = np.isfinite(misfit[edges]).all()  # an even turn has none
    if not (explains[best] and evidence[best] > PEAK_RATIO * rival[second] and has_edges):
        likely = near[(explains & (PEAK_RATIO * evidence >= evidence[best]))[near]]
        if not len(likely):
            if not explains[best]:
                return None, "what it and {} see moves alike at no offset"
            offsets = f"{offset[best]:.2f} s and {offset[second]:.2f} s"
            return None, f"what it and {{}} see moves alike at offsets of {offsets}" if has_edges else too_little
        if np.abs(offset[likely]).min() <= STEP:
            return 0.0, ""
        best = int(likely[np.argmax(evidence[likely])])
    # the evidence leans to a longer overlap, the misfit does not
    peak = np.flatnonzero((np.abs(offset - offset[best]) <= PEAK_REACH) & (count >= PEAK_COUNT * count[best]))
    best = int(peak[np.argmin(misfit[peak])])
    least, where = _least(misfit, best)
    if abs(offset[best]) <= REACH:
        here = int(np.argmin(np.abs(offset)))
        if least > MISFIT_SHARE * _parabola(misfit, here, -offset[here] / STEP):
            return 0.0, ""
    return float(offset[best] + STEP * where), ""


def _overlaps(a: _Grid, b: _Grid) -> tuple[Array, Array, Array, Array]:
    """For each offset of b's clock, (k,) [s] in order: frames that both have, misfit (else infinite), and spread.

    A body counts as points on either side of its origin along its axes. The misfit is the mean square distance between
    both cameras' points after the best rigid transform, the spread that between points and their means over time, both
    over the squared distance from the cameras. The evidence for an offset is the time of overlap times
    log(spread / misfit).
    """
    n = fft.next_fast_len(a.length + b.length, real=True)
    distance = 0.5 * (a.distance + b.distance)
    arm = ARM * distance
    count = np.zeros(n)
    totals, spreads = np.zeros((2, 4, n)), np.zeros((2, n))
    cross = np.zeros((n, 3, 3))
    for name in a.poses.keys() & b.poses.keys():
        fa, fb = (_transformed(*grid.poses[name], grid.middle, n) for grid in (a, b))

        def shared(one: Array, other: Array) -> Array:
            return fft.irfft(np.conj(one) * other, n)

        seen = np.round(shared(fa["seen"], fb["seen"]))
        count += seen
        # sums of each camera's values over the frames that both have
        sums = ({k: shared(v, fb["seen"]) for k, v in fa.items()}, {k: shared(fa["seen"], v) for k, v in fb.items()})
        for side, of in enumerate(sums):
            totals[side] += np.concatenate([of["p"], of["p²"][None]])
            still = (of["p"] ** 2).sum(axis=0) + arm**2 / 3 * (of["R"] ** 2).sum(axis=(0, 1))
            spreads[side] += of["p²"] + arm**2 * seen - still / np.maximum(seen, 1)
        for i, j in itertools.product(range(3), range(3)):
            turns = sum(np.conj(fa["R"][j, k]) * fb["R"][i, k] for k in range(3))
            cross[:, i, j] += shared(fa["p"][j], fb["p"][i]) + fft.irfft(arm**2 / 3 * turns, n)
    enough = np.flatnonzero(count * STEP >= OVERLAP)
    count, cross, totals = count[enough], cross[enough], totals[..., enough]
    cross -= np.einsum("ik,jk->kij", totals[1, :3], totals[0, :3]) / count[:, None, None]
    u, s, vt = np.linalg.svd(cross)
    s[:, 2] *= np.sign(np.linalg.det(u @ vt))
    own = (totals[:, 3] - (totals[:, :3] ** 2).sum(axis=1) / count).sum(axis=0) + 2 * arm**2 * count
    lag = np.where(enough < b.length, enough, enough - n)
    frames, misfit = np.zeros(a.length + b.length), np.full(a.length + b.length, np.inf)
    spread, at = np.zeros(a.length + b.length), a.length + lag
    frames[at] = count
    misfit[at] = np.maximum(own - 2 * s.sum(axis=1), 0.0) / (count * distance**2)
    spread[at] = np.maximum(spreads.max(axis=0)[enough], 0.0) / (count * distance**2)
    return b.t - a.t + STEP * np.arange(-a.length, b.length), frames, misfit, spread


def _sharpness(misfit: Array, spread: Array) -> Array:
    return np.log(spread + FLOOR**2) - np.log(misfit + FLOOR**2)


def _transformed(T: Array, good: Bools, middle: Array, n: int) -> dict[str, Array]:
    """Fourier transforms of where a body is known, of its position, that squared, and its orientation."""
    p = np.where(good[:, None], T[:, :3, 3] - middle, 0.0)
    R = np.where(good[:, None, None], T[:, :3, :3], 0.0)
    values = {"seen": good.astype(float), "p": p.T, "p²": (p**2).sum(axis=1), "R": np.moveaxis(R, 0, -1)}
    return {name: fft.rfft(value, n) for name, value in values.items()}


def _parabola(misfit: Array, k: int, x: float) -> float:
    """The misfit x steps beside offset k, by the parabola through its two neighbours; infinite where it has none."""
    if not 0 < k < len(misfit) - 1:
        return float("inf")
    before, here, after = misfit[k - 1 : k + 2]
    return float(here + 0.5 * (after - before) * x + 0.5 * (after - 2 * here + before) * x**2)


def _least(misfit: Array, k: int) -> tuple[float, float]:
    """The least misfit near offset k, by the same parabola, and how many steps beside it that is."""
    before, here, after = misfit[max(k - 1, 0)], misfit[k], misfit[min(k + 1, len(misfit) - 1)]
    bend = after - 2 * here + before
    x = float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if np.isfinite(bend) and bend > 0 else 0.0
    return (_parabola(misfit, k, x) if x else float(here)), x
