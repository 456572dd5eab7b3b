"""The motion of a whole synthetic recording: toss, rest, a hand that carries the object to the next release."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.motion.segmentation import rest_frame
from tossid.objects import ObjectModel, corner_heights, corner_positions
from tossid.parallel import in_threads
from tossid.rotations import quat_boxminus, quat_exp, quat_mul, right_jacobian_inv
from tossid.settings.rendering import RenderSettings
from tossid.types import Frame, Toss
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.shutter import Shutter
from tossid.vision.recordings.writing import RecordingWriter
from tossid.vision.rendering.render import DEFAULT_IMAGES, Renderer

Array = NDArray[np.float64]

HAND_SPEED = 2.5
"""Mean speed of a hand beyond which it takes longer [m/s]."""
HAND_UPWARD, HAND_SIDEWAYS = (5.0, 12.0), 3.0
"""Bounds of a hand's upward acceleration at the release, and its largest horizontal one along each axis [m/s²]."""


@dataclass(frozen=True, eq=False)
class Timeline:
    """A continuous motion at an even rate.

    Attributes:
        t: (n,) times [s].
        q: (n, nq) configurations.
        tosses: The true tosses on this clock, each from its release to its first frame of rest (as `segment` defines
            it).
        release: (m,) frames at which the tosses start.
        rest: (m,) frames at which they end.
        lift: (m,) frames at which a hand takes the object up before.
    """

    t: Array
    q: Array
    tosses: tuple[Toss, ...]
    release: NDArray[np.int64]
    rest: NDArray[np.int64]
    lift: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


def make_timeline(
    tosses: Sequence[Toss],
    model: ObjectModel,
    rng: np.random.Generator,
    *,
    start: float = 0.0,
    carry: tuple[float, float] = (0.35, 0.5),
    rest: tuple[float, float] = (0.15, 0.25),
) -> Timeline:
    """One motion that joins tosses.

    Before each toss a hand lifts the object from where it rests (before the first: where the last toss ends) and throws
    it: position and attitude are fifth-degree polynomials that end with the release's pose and velocity and an upward
    acceleration, so that free flight starts there.

    Args:
        tosses: Each at the same even rate, from its release to rest.
        model: The object.
        rng: Draws how long and how the hand carries.
        start: Time of the first frame [s].
        carry: Bounds of the time that a hand carries [s].
        rest: Bounds of the time at rest before that [s].

    Raises:
        InputError: There are no tosses, or tosses of different or uneven rates.
    """
    if not tosses:
        raise InputError("no tosses to make a recording of")
    steps = np.concatenate([np.diff(toss.t) for toss in tosses])
    dt = float(np.median(steps))
    if np.abs(steps - dt).max() > 1e-3 * dt:
        raise InputError("tosses of a recording must all have one even rate")
    pieces: list[Array] = []
    count = 0
    lift, release, at_rest, retimed = [], [], [], []
    previous = tosses[-1].q[-1]
    for toss in tosses:
        n_before = max(round(rng.uniform(*rest) / dt), 1) if pieces else max(round(0.1 / dt), 1)
        pieces.append(np.repeat(previous[None], n_before, axis=0))
        path = _carry(previous, toss, model, dt, rng, carry)
        pieces.append(path)
        count += n_before + len(path)
        end = rest_frame(toss.q)
        own = slice(0, max(end, 1) + 1)
        lift.append(count - len(path))
        release.append(count)
        at_rest.append(count + own.stop - 1)
        t: Array = start + dt * (count + np.arange(len(toss.t), dtype=float))
        retimed.append(replace(toss.frames(own), t=t[own]))
        pieces.append(toss.q)
        count += len(toss.q)
        previous = toss.q[-1]
    tail = max(round(rest[1] / dt), 1)
    pieces.append(np.repeat(previous[None], tail, axis=0))
    q = np.concatenate(pieces)
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    clock: Array = start + dt * np.arange(len(q), dtype=float)
    frames = (np.array(which, dtype=np.int64) for which in (release, at_rest, lift))
    return Timeline(clock, q, tuple(retimed), *frames)


def _carry(
    before: Array, toss: Toss, model: ObjectModel, dt: float, rng: np.random.Generator, bounds: tuple[float, float]
) -> Array:
    """Configurations from rest to just before the release, one frame apart. (n, nq)."""
    q1, v1 = toss.q[0], toss.v[0]
    distance = float(np.linalg.norm(q1[:3] - before[:3]))
    n = max(round(max(rng.uniform(*bounds), distance / HAND_SPEED) / dt), 4)
    T = n * dt
    s = np.arange(n) / n
    push = np.array([0.0, 0.0, 1.0]) * rng.uniform(*HAND_UPWARD)
    push += rng.uniform(-HAND_SIDEWAYS, HAND_SIDEWAYS, 3) * [1, 1, 0]
    p = before[:3] + _quintic(s, q1[:3] - before[:3], v1[:3] * T, push * T**2)
    turn = quat_boxminus(q1[3:7], before[3:7])
    rate = right_jacobian_inv(turn) @ v1[3:6]
    rotvec = _quintic(s, turn, rate * T, np.zeros(3))
    joints = before[7:] + _quintic(s, q1[7:] - before[7:], v1[6:] * T, np.zeros(model.n_joints))
    q = np.concatenate([p, quat_mul(before[3:7], quat_exp(rotvec)), joints], axis=1)
    # the hand lifts the object off the ground first; the bump ends with no velocity and no acceleration
    bump = 64 * (s * (1 - s)) ** 3
    clear = min(0.01 + 0.03 * float(rng.random()), 0.9 * float(corner_positions(model, q1)[:, 2].min()))
    low = corner_heights(model, q).min(axis=1) - clear * np.minimum(1, 6 * s)
    lift = float(np.max(np.where(low < 0, -low, 0.0) / np.maximum(bump, 0.02)))
    q[:, 2] += min(lift, 0.5) * bump
    return q


def _quintic(s: Array, end: Array, velocity: Array, acceleration: Array) -> Array:
    """Fifth-degree polynomial in s from rest at 0 to the given end, velocity and acceleration at s = 1. (n, k)."""
    x, v, a = end, velocity, acceleration
    c3 = 10 * x - 4 * v + 0.5 * a
    c4 = -15 * x + 7 * v - a
    c5 = 6 * x - 3 * v + 0.5 * a
    power = s[:, None]
    return np.asarray(power**3 * (c3 + power * (c4 + power * c5)))


@dataclass(frozen=True, eq=False)
class Filming:
    """How a motion is filmed.

    Attributes:
        shutter: Of all cameras.
        clocks: By camera, how much later than the truth its time stamps are [s]; 0 for those that are not named.
        dropped: Share of the frames that each camera loses, 0 to 1.
        hand: (n, 7) its pose in each frame of the motion, NaN where there is none (`hand.hand_poses`); None: never.
    """

    shutter: Shutter = field(default_factory=Shutter)
    clocks: dict[str, float] = field(default_factory=dict)
    dropped: float = 0.0
    hand: Array | None = None


DEFAULT_FILMING = Filming()


@dataclass(frozen=True, eq=False)
class FilmTruth:
    """What was filmed.

    Attributes:
        kept: (n, cameras) whether a camera's frame was written.
        visible: (n, cameras, tags) the share of each tag that a camera could see, NaN in frames that it lost.
    """

    kept: NDArray[np.bool_]
    visible: Array


def render_timeline(
    timeline: Timeline,
    model: ObjectModel,
    cameras: Sequence[Camera],
    writer: RecordingWriter,
    rng: np.random.Generator,
    *,
    settings: RenderSettings = DEFAULT_IMAGES,
    filming: Filming = DEFAULT_FILMING,
    threads: int = 2,
    progress: Callable[[int], None] | None = None,
) -> FilmTruth:
    """Render every frame of every camera into an open recording.

    A frame's time stamp is the middle of the exposure of the image's middle row, on the camera's own clock. The
    images depend on `rng` only, not on the number of threads, nor on which frames are dropped.

    Args:
        timeline: The motion.
        model: The object, with its tags.
        cameras: What films.
        writer: Of the recording.
        rng: Of the sensors' noise and of the dropped frames.
        settings: How images look.
        filming: Shutter, clocks, dropped frames and hand.
        threads: How many images are drawn at the same time.
        progress: Called with the number of images done since the last call.

    Raises:
        InputError: A clock gives times before zero.
    """
    t, q, shutter = timeline.t, timeline.q, filming.shutter
    dt = float(t[1] - t[0])
    for camera in cameras:
        shutter.check(camera.resolution[1], dt)
        if t[0] + filming.clocks.get(camera.name, 0.0) < 0:
            raise InputError(f"camera '{camera.name}': its clock would give times before zero")
    renderer = Renderer(model, cameras, settings)
    entropy = int(rng.integers(2**63))
    seeds = np.random.SeedSequence(entropy)
    kept = np.ones((len(t), len(cameras)), dtype=bool)
    if filming.dropped > 0:
        apart = np.random.default_rng(np.random.SeedSequence(entropy, spawn_key=(2**31,)))
        kept = apart.random(kept.shape) >= filming.dropped
        kept[[0, -1]] = True
    visible = np.full((*kept.shape, len(model.tags)), np.nan)
    jobs = [(i, c) for i in range(len(t)) for c in range(len(cameras))]

    def draw(job: tuple[tuple[int, int], np.random.SeedSequence]) -> None:
        (i, c), seed = job
        camera = cameras[c]
        if not kept[i, c]:
            return
        noise = np.random.default_rng(seed)
        exposure = shutter.expose(t, q, i, camera.resolution[1], settings.samples, filming.hand)
        image = renderer.draw(exposure, camera.name, noise)
        if model.tags:
            visible[i, c] = renderer.visible(exposure, camera.name)
        writer.write(Frame(camera.name, float(t[i]) + filming.clocks.get(camera.name, 0.0), image))

    block = 32 * len(cameras)
    for first in range(0, len(jobs), block):
        part = jobs[first : first + block]
        for _ in in_threads(draw, list(zip(part, seeds.spawn(len(part)), strict=True)), threads):
            pass
        if progress is not None:
            progress(len(part))
    return FilmTruth(kept, visible)
