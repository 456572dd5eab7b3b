"""Frozen types that pass between rooms. They check themselves: a `Toss` that exists is a motion.

Units are SI. Configuration q = (position of the base frame [m, world],
quaternion wxyz, joints [rad or m]); velocity v = (linear [m/s, world, of the
base frame's origin], angular [rad/s, body frame], joint rates): MuJoCo's order.
A covariance of q lives in the tangent space: position [m², world], rotation
[rad², body frame, perturbation on the right], joints.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import lru_cache
from typing import TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from tossid.errors import MotionError
from tossid.settings.limits import VALUES

Array = NDArray[np.float64]
T = TypeVar("T")

Progress = Callable[[str, float], None]
"""Called by long work, with what is done now and the share that is done."""

QUAT_NORM_TOLERANCE = 1e-3
SPLITS = ("train", "validation", "test")

_OFF_CLOCK, _ON_CLOCK = 0.2, 0.95
"""Share of a frame by which time steps may miss a whole number of frames, and share of them that must not."""
_MOST_PARTS = 4
"""Most frames of the median time step."""


class Phase(IntEnum):
    """What the object does during a frame."""

    UNKNOWN = 0
    FLIGHT = 1
    IMPACT = 2
    SLIDE = 3
    ROLL = 4
    REST = 5


@dataclass(frozen=True, slots=True)
class Frame:
    """One image of one camera.

    Attributes:
        camera: The camera's name.
        t: Its time stamp [s].
        image: (height, width) grey levels.
    """

    camera: str
    t: float
    image: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Detection:
    """One AprilTag seen in one frame.

    Attributes:
        camera: The camera's name.
        t: The frame's time stamp [s].
        tag_id: The tag's id.
        corners: (4, 2) [px], pixel centres at integers (OpenCV), in the order bottom-left, bottom-right, top-right,
            top-left of the tag.
        corner_cov: (4, 2, 2) [px²], each corner's own.
        hamming: Corrected bits.
        margin: Decision margin.
    """

    camera: str
    t: float
    tag_id: int
    corners: Array
    corner_cov: Array
    hamming: int = 0
    margin: float = 0.0


@dataclass(frozen=True, slots=True)
class PoseTrack:
    """Tracked configurations. Frames may be missing: t is increasing, not uniform.

    Attributes:
        name: The track's name.
        t: (n,) times [s].
        q: (n, nq) configurations.
        q_cov: (n, nv, nv) covariances of q, None if unknown.
        v: (n, nv) recorded velocities, None where the source carries none.
    """

    name: str
    t: Array
    q: Array
    q_cov: Array | None = None
    v: Array | None = None

    def __post_init__(self) -> None:
        check_motion(self.t, self.q, self.v)
        if self.q_cov is not None:
            _check_cov("q_cov", self.q_cov, len(self.t), self.q.shape[1] - 1)

    def frames(self, which: slice) -> PoseTrack:
        """A stretch of it."""
        cov, v = (None if array is None else array[which] for array in (self.q_cov, self.v))
        return PoseTrack(self.name, self.t[which], self.q[which], cov, v)


@dataclass(frozen=True, slots=True)
class LongTrack:
    """A track of which only the times are in memory.

    Attributes:
        name: The track's name.
        t: (n,) times [s].
        read: Gives a stretch of its frames.
    """

    name: str
    t: Array
    read: Callable[[slice], PoseTrack]

    def frames(self, which: slice) -> PoseTrack:
        """A stretch of it."""
        return self.read(which)


@dataclass(frozen=True, slots=True)
class Toss:
    """One toss.

    Attributes:
        name: The toss's name.
        t: (n,) times [s].
        q: (n, nq) configurations.
        v: (n, nv) velocities.
        q_cov: (n, nv, nv) covariances of q.
        v_cov: (n, nv, nv) covariances of v.
        phase: (n,) of `Phase`.
        split: One of "train", "validation", "test", or "" where none was drawn.
        q_measured: (n, nq) the single poses that a smoother made q of, whose errors are independent from frame to
            frame; None where q itself is what was measured.
        q_measured_cov: (n, nv, nv) their covariances.
    """

    name: str
    t: Array
    q: Array
    v: Array
    q_cov: Array
    v_cov: Array
    phase: NDArray[np.uint8]
    split: str = ""
    q_measured: Array | None = None
    q_measured_cov: Array | None = None

    def __post_init__(self) -> None:
        check_motion(self.t, self.q, self.v)
        n, nv = self.v.shape
        _check_cov("q_cov", self.q_cov, n, nv)
        if (self.q_measured is None) != (self.q_measured_cov is None):
            raise MotionError("q_measured and q_measured_cov come together or not at all")
        if self.q_measured is not None and self.q_measured_cov is not None:
            if self.q_measured.shape != self.q.shape:
                raise MotionError(f"q_measured has shape {self.q_measured.shape}, expected {self.q.shape}")
            check_motion(self.t, self.q_measured, None)
            _check_cov("q_measured_cov", self.q_measured_cov, n, nv)
        _check_cov("v_cov", self.v_cov, n, nv)
        if self.phase.shape != (n,):
            raise MotionError(f"phase has shape {self.phase.shape}, expected ({n},)")
        if self.split not in ("", *SPLITS):
            raise MotionError(f"split is {self.split!r}, expected one of {', '.join(SPLITS)}")

    def __len__(self) -> int:
        return len(self.t)

    @property
    def measured(self) -> tuple[Array, Array]:
        """Poses (n, nq) with independent errors, and their covariances (n, nv, nv)."""
        if self.q_measured is None or self.q_measured_cov is None:
            return self.q, self.q_cov
        return self.q_measured, self.q_measured_cov

    def ticks(self, dt: float) -> NDArray[np.int64]:
        """(n,) place of each frame on a clock that starts at the first: missing frames are skipped.

        Args:
            dt: Between ticks [s], best the `frame_time` of the dataset.
        """
        steps = np.maximum(np.rint(np.diff(self.t) / dt), 1.0)
        return np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)

    def frames(self, which: slice) -> Toss:
        """A stretch of it."""
        arrays = ("t", "q", "v", "q_cov", "v_cov", "phase", "q_measured", "q_measured_cov")
        given = {name: getattr(self, name) for name in arrays}
        return replace(self, **{name: array[which] for name, array in given.items() if array is not None})


@dataclass(frozen=True, slots=True)
class Session:
    """Tosses in a row whose recording did not change.

    Attributes:
        first: Name of its first toss.
        last: Name of its last toss.
        n_tosses: How many it has.
        level: How far the recorded world's vertical leaned: horizontal components of the table's normal [rad]; None
            where the tosses do not decide it.
        level_sigma: Their standard errors [rad].
        levelled: Whether its tosses were turned so that this is 0.
        changed: What changed at its start: quantities, and the probability of such a change by chance.
        note: What a person should know of it.
    """

    first: str
    last: str
    n_tosses: int
    level: tuple[float, float] | None = None
    level_sigma: tuple[float, float] | None = None
    levelled: bool = False
    changed: Mapping[str, float] = field(default_factory=dict)
    note: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class RecordingOrder:
    """Tosses in the order in which they were recorded, what each says of its recording, and what was undone.

    A levelled pose is T x, where x is the recorded one, and T turns by `turn` and then shifts by `shift` along z.

    Attributes:
        sessions: In the order of recording.
        ordered_by: "times" or "names".
        names: Of the tosses, in the order of recording, (n,).
        quantities: Names of what each toss says, (k,).
        values: What each says, in SI, (n, k); NaN where it says nothing.
        places: Where each ends, x and y as recorded [m], (n, 2).
        turn: Quaternion wxyz by which each was turned, (n, 4).
        shift: By which each was raised [m], (n,).
        session_of: Index of each one's session, (n,).
        notes: What a person should know.
    """

    sessions: tuple[Session, ...]
    ordered_by: str
    names: tuple[str, ...]
    quantities: tuple[str, ...]
    values: Array
    places: Array
    turn: Array
    shift: Array
    session_of: NDArray[np.int64]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Rollout:
    """A predicted motion.

    Attributes:
        t: (n,) times [s].
        q: (n, nq) configurations.
        v: (n, nv) velocities.
        lam_n: (n, n_c) normal impulses of the step that ended at each frame [N s].
        unsolved: How many of its contact problems met no tolerance.
        diverged: Whether a state became NaN or infinite; from there on the motion stays where it was.
    """

    t: Array
    q: Array
    v: Array
    lam_n: Array
    unsolved: int = 0
    diverged: bool = False


class OnDemand(Sequence[T]):
    """Items that are read when they are asked for: all of them may be more than fits into memory."""

    def __init__(self, read: Callable[[int], T], count: int, *, kept: int) -> None:
        """Items that a function gives.

        Args:
            read: Gives item i.
            count: How many there are.
            kept: So many that were asked for last stay in memory.
        """
        self._read: Callable[[int], T] = lru_cache(kept)(read)
        self._at = range(count)

    def __len__(self) -> int:
        return len(self._at)

    @overload
    def __getitem__(self, which: int) -> T: ...
    @overload
    def __getitem__(self, which: slice) -> tuple[T, ...]: ...
    def __getitem__(self, which: int | slice) -> T | tuple[T, ...]:
        at = self._at[which]
        return self._read(at) if isinstance(at, int) else tuple(self._read(i) for i in at)


def check_motion(t: Array, q: Array, v: Array | None = None) -> None:
    """Raise `MotionError` (with the row) unless the arrays are a motion.

    Checks shape, finiteness, the limits of `tossid.settings.limits.ValueLimits`, increasing time and unit quaternions
    (within 1e-3).

    Args:
        t: (n,) times [s].
        q: (n, 7 + n_joints) configurations.
        v: (n, 6 + n_joints) velocities, or None.

    Raises:
        MotionError: They are not; it has the row.
    """
    if t.ndim != 1 or len(t) < 2:
        raise MotionError(f"time has shape {t.shape}, expected (n,) with n >= 2")
    if q.ndim != 2 or q.shape[0] != len(t) or q.shape[1] < 7:
        raise MotionError(f"q has shape {q.shape}, expected ({len(t)}, 7 + joints)")
    if v is not None and v.shape != (len(t), q.shape[1] - 1):
        raise MotionError(f"v has shape {v.shape}, expected ({len(t)}, {q.shape[1] - 1})")
    parts = [("time", t[:, None], VALUES.time), ("q", q, VALUES.position)]
    parts += [("v", v, VALUES.velocity)] if v is not None else []
    for name, values, _ in parts:
        bad = ~np.isfinite(values).all(axis=1)
        if bad.any():
            raise MotionError(f"{name} is not finite (NaN or infinity)", row=int(np.argmax(bad)))
    for name, values, limit in parts:
        bad = (np.abs(values) > limit).any(axis=1)
        if bad.any():
            row = int(np.argmax(bad))
            raise MotionError(f"{name} is {np.abs(values[row]).max():.4g}, expected at most {limit:g}", row=row)
    if t[-1] - t[0] > VALUES.duration:
        raise MotionError(f"time spans {t[-1] - t[0]:.4g} s, expected at most {VALUES.duration:g} s", row=len(t) - 1)
    steps = np.diff(t)
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0)) + 1
        raise MotionError(f"time does not increase ({t[row - 1]:.9g} s, then {t[row]:.9g} s)", row=row)
    norms = np.linalg.norm(q[:, 3:7], axis=1)
    bad = np.abs(norms - 1) > QUAT_NORM_TOLERANCE
    if bad.any():
        row = int(np.argmax(bad))
        raise MotionError(f"quaternion has norm {norms[row]:.4f}, expected 1", row=row)


def _check_cov(name: str, cov: Array, n: int, nv: int) -> None:
    if cov.shape != (n, nv, nv):
        raise MotionError(f"{name} has shape {cov.shape}, expected ({n}, {nv}, {nv})")
    bad = ~np.isfinite(cov).all(axis=(1, 2)) | (np.diagonal(cov, axis1=1, axis2=2) < 0).any(axis=1)
    if bad.any():
        raise MotionError(f"{name} is not finite or has a negative variance", row=int(np.argmax(bad)))
    bad = (np.abs(cov) > VALUES.covariance).any(axis=(1, 2))
    if bad.any():
        raise MotionError(f"{name} is larger than {VALUES.covariance:g}", row=int(np.argmax(bad)))


def frame_time(tosses: Sequence[Toss]) -> float:
    """The time between frames of all tosses [s]: the median, or a whole part of it where many frames are missing.

    Args:
        tosses: At least one.
    """
    steps = np.concatenate([np.diff(toss.t) for toss in tosses])
    median, usual = float(np.median(steps)), float(np.percentile(steps, 50, method="lower"))
    for guess in (median, *(usual / parts for parts in range(1, _MOST_PARTS + 1))):
        count = np.maximum(np.rint(steps / guess), 1.0)
        dt = float(np.median(steps / count))
        if np.mean(np.abs(steps / dt - count) < _OFF_CLOCK) >= _ON_CLOCK:
            return dt
    return median


def silent(what: str, share: float) -> None:
    """A `Progress` that nobody hears."""
