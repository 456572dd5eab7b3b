"""Free fall of an object of unknown shape, from its poses alone: its centre of mass is on a parabola.

With the body's recorded position p and rotation R and its centre of mass c in the body's frame, flight has

    p + R c = a + b t - g t²/2 e_z.

Of two links on a hinge, p + R_1 c_1 + R_2 c_2 moves so, with the parts c_b of the common centre of mass
(`tossid.motion.links`). Over a stretch of frames, a and b are eliminated by projecting on what no line in time
explains. What is left is linear in c and g, which are the same for all stretches.

`find_parabola` knows g and looks for the windows that fly: a redescending loss, whose scale shrinks (graduated
non-convexity), finds those that agree on c. What rests, slides or rolls does not fall, and what is hit leaves its
parabola. `free_fall` knows the stretches and finds c and g with their errors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.motion.contact import runs
from tossid.motion.flight import without_line
from tossid.motion.links import com_of_moments, determined, turns
from tossid.objects import GRAVITY, ObjectModel, unstated_object
from tossid.objects.unstated import hinge_of
from tossid.robust import in_medians, reweighted
from tossid.rotations import quat_continuous
from tossid.types import PoseTrack, Toss

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

RMS_OF_FALL = 12 * np.sqrt(5.0)
"""The rms of g t²/2 over a time T, less its line, is g T² over this: the misfit of a body that is carried."""

# windows in which a body of unknown shape may fly
SECONDS = (0.06, 0.2)
"""Shortest and longest duration of a window [s]."""
WINDOW_FRAMES = 6
"""Fewest frames of a window."""
NOISE_RATIO = 15.0
"""Windows are so long that a body that is carried misses the parabola by so many times the noise."""
MOST_WINDOWS = 6000
"""Windows, evenly drawn, from which the centre of mass is found."""
FEWEST_WINDOWS = 6
"""Windows on a parabola below which there is no flight."""
STILL = 2e-3
"""What moves by less from its last pose [m, rad] stays at rest, and shows no centre of mass."""
SCALES = (10.0, 0.2)
"""First and last scale of the redescending loss, over the misfit of a body that is carried."""
SHRINK = 0.7
"""Factor from one scale to the next."""
REFITS = 6
"""Refits to the windows that fly."""
LEAST_MISFIT = 2e-5
"""Misfit with which a window flies in any case; exact data have none [m]."""
DEVIATIONS = 1.7
"""A window flies if its misfit is below so many of the typical one of flight."""
MOST_CARRIED = 0.35
"""And below this share of the misfit of a body that is carried."""

# stretches of flight above a known ground
CLEARANCE = 8e-3
"""Height of the lowest point above the ground from which a frame is flight [m]."""
MARGIN = 2
"""Frames at either end of a stretch that are left out, since smoothing mixes them with contact."""
STRETCH_FRAMES = 8
"""Shortest stretch."""
FEWEST_STRETCHES = 3
"""Stretches below which there is no estimate."""
OUTLIER = 2.0
"""Rms residual, in medians over stretches, from which a stretch counts less."""
REWEIGHTINGS = 8
WORST_CONDITION = 1e10
"""Condition number of the normal equations beyond which the centre of mass is undetermined."""


@dataclass(frozen=True)
class FreeFall:
    """What flight shows of a rigid body, or of two links.

    Attributes:
        com: Centre of mass in the body's frame, or each link's part c_b of it [m], (n_b, 3).
        com_deviation: Their standard errors [m], (n_b, 3).
        gravity: Downward acceleration [m/s²].
        gravity_deviation: Its standard error [m/s²].
    """

    com: Array
    com_deviation: Array
    gravity: float
    gravity_deviation: float


@dataclass(frozen=True)
class Parabola:
    """How a body of unknown shape flies.

    Attributes:
        tree: The body, or the links and their hinge.
        com: Centre of mass in the body's frame, or each link's part c_b of it [m], (n_b, 3).
        gyration: Radius that compares spins with speeds [m]: a guess from how near the ground the centre of mass comes.
        gravity: Of free flight [m/s²].
        seconds: Duration of a window [s].
        misfit: Root mean square below which a window flies [m].
    """

    tree: ObjectModel
    com: Array
    gyration: float
    gravity: float
    seconds: float
    misfit: float

    def body(self) -> ObjectModel:
        """The body, of which nothing else is stated."""
        equal = np.full(len(self.com), 1 / len(self.com))
        com = com_of_moments(self.tree, self.com, equal)
        return unstated_object(com=com, gyration=self.gyration, hinge=hinge_of(self.tree))

    def may_touch(self, t: Array, q: Array) -> Bools:
        """Whether something else than gravity may act between a frame and the next, (n - 1,).

        An interval flies if some window around it does.

        Args:
            t: Times [s], (n,).
            q: Configurations, (n, nq).
        """
        touching, w = np.ones(len(t) - 1, dtype=bool), _window_frames(t, self.seconds)
        if len(t) < w:
            return touching
        y, J = _windows(self.tree, t, q, self.gravity, w)
        for first in np.flatnonzero(_misfit(y, J, self.com.ravel()) < self.misfit):
            touching[first : first + w - 1] = False
        return touching

    def flying(self, t: Array, q: Array) -> Bools:
        """Frames in free flight, (n,): those with an interval beside them in which nothing else acts.

        Args:
            t: Times [s], (n,).
            q: Configurations, (n, nq).
        """
        free = np.concatenate([[False], ~self.may_touch(t, q), [False]])
        return np.asarray(free[1:] | free[:-1])


def free_fall(tosses: Sequence[Toss], tree: ObjectModel, clearance: Callable[[Toss], Array]) -> FreeFall:
    """Centre of mass and gravity from all stretches of flight.

    A stretch that is no free fall (a hand, a collision) counts less: Huber's weights on the stretches' rms residuals.

    Args:
        tosses: Of one rigid body, or of two links on a hinge.
        tree: The body, or the links and their hinge; nothing else of it matters.
        clearance: Height of the object's lowest point above the ground in each frame of a toss [m], (n,).

    Returns:
        Estimates with standard errors, the stretch being the unit (a sandwich estimate).

    Raises:
        InputError: There is too little flight.
    """
    free = determined(tree)
    stretches = []
    for toss in tosses:
        for first, last in runs(clearance(toss) > CLEARANCE):
            n = last + 1 - first - 2 * MARGIN
            if n >= STRETCH_FRAMES:
                own = slice(first + MARGIN, first + MARGIN + n)
                y, fall, R = (part[0] for part in _less_line(tree, toss.t[own], toss.q[own], n))
                J = np.concatenate([-R @ free, np.zeros((n, 3, 1))], axis=2)
                J[:, 2, -1] = -fall
                stretches.append((J.reshape(3 * n, -1), y.ravel()))
    if len(stretches) < FEWEST_STRETCHES:
        raise InputError(
            f"{len(stretches)} stretches of flight of at least {STRETCH_FRAMES} frames; "
            f"a centre of mass needs at least {FEWEST_STRETCHES}"
        )
    normal = np.array([J.T @ J for J, _ in stretches])
    right = np.array([J.T @ y for J, y in stretches])

    def fit(weights: Array) -> tuple[tuple[Array, Array], Array]:
        H = np.einsum("s,sij->ij", weights, normal)
        if np.linalg.cond(H) > WORST_CONDITION:
            raise InputError("the body hardly turns in flight: its centre of mass cannot be told from its position")
        found = np.linalg.solve(H, np.einsum("s,si->i", weights, right))
        rms = np.array([np.sqrt(np.mean((y - J @ found) ** 2)) for J, y in stretches])
        return (found, H), in_medians(rms)

    (found, H), weights = reweighted(fit, len(stretches), limit=OUTLIER, iterations=REWEIGHTINGS)
    score = np.array([w * J.T @ (y - J @ found) for w, (J, y) in zip(weights, stretches, strict=True)])
    inverse = np.linalg.inv(H)
    # the sandwich: stretches are independent of each other, and their frames are not
    covariance = inverse @ (score.T @ score) @ inverse
    com, com_var = free @ found[:-1], np.diag(free @ covariance[:-1, :-1] @ free.T)
    return FreeFall(
        com.reshape(-1, 3),
        np.sqrt(com_var).reshape(-1, 3),
        float(found[-1]),
        float(np.sqrt(covariance[-1, -1])),
    )


def find_parabola(
    tracks: Sequence[PoseTrack], tree: ObjectModel | None = None, *, gravity: float = GRAVITY
) -> Parabola:
    """The centre of mass of a body and the misfit of its flights, from tracks of which nothing is known.

    Args:
        tracks: Of one rigid body or of two links on a hinge, z up.
        tree: The links and their hinge; None for one rigid body. Nothing else of it matters.
        gravity: Where they were recorded [m/s²].

    Raises:
        InputError: The tracks have joints, or nothing in them falls.
    """
    tree = tree or unstated_object()
    if any(track.q.shape[1] != tree.nq for track in tracks):
        has = "is one rigid body" if not tree.n_joints else "is two links on a hinge"
        raise InputError(
            f"the unknown object {has} (object.links), and these tracks have {tracks[0].q.shape[1] - 7} joints"
        )
    seconds = float(np.clip(np.sqrt(NOISE_RATIO * _noise(tracks) * RMS_OF_FALL / gravity), *SECONDS))
    y, J = _all_windows(tree, tracks, gravity, seconds)
    carried = gravity * seconds**2 / RMS_OF_FALL
    if len(y) < FEWEST_WINDOWS:
        raise InputError(f"{len(y)} stretches of {seconds:.2g} s in which the object moves; there is no flight in them")
    com, scale = np.zeros(3 * tree.n_bodies), SCALES[0] * carried
    while scale > SCALES[1] * carried:
        scale *= SHRINK
        # Geman and McClure's weights: windows that do not fall count less and less as the scale shrinks
        com = _solve(y, J, 1 / (1 + (_misfit(y, J, com) / scale) ** 2) ** 2)
    for _ in range(REFITS):
        rms = _misfit(y, J, com)
        flying = rms < MOST_CARRIED * carried
        if flying.sum() < FEWEST_WINDOWS:
            raise InputError(
                f"the tosses show no flight: in {int(flying.sum())} of {len(rms)} stretches of {seconds:.2g} s some "
                f"point of the body falls at {gravity:g} m/s²; expected tosses that fly, z up, in metres and seconds"
            )
        typical = max(LEAST_MISFIT, DEVIATIONS * float(np.quantile(rms[flying], 0.3)))
        misfit = min(typical, MOST_CARRIED * carried)
        com = _solve(y, J, (rms < misfit).astype(float))
    heights = [track.q[:, 2] + turns(tree, track.q)[:, 2] @ com for track in tracks]
    low = min(float(np.quantile(height, 0.02)) for height in heights)
    gyration = float(np.clip(0.6 * low, 5e-3, 0.5))
    return Parabola(tree, com.reshape(-1, 3), gyration, gravity, seconds, misfit)


def _less_line(tree: ObjectModel, t: Array, q: Array, w: int, stride: int = 1) -> tuple[Array, Array, Array]:
    """Of each window of w frames, less its line in time: p (k, w, 3), t²/2 (k, w), and all R_b (k, w, 3, 3 n_b)."""
    place = np.arange(0, len(t) - w + 1, stride)[:, None] + np.arange(w)
    s = t[place] - t[place].mean(axis=1, keepdims=True)
    less = without_line(s)
    R = np.einsum("kab,kbij->kaij", less, turns(tree, q)[place])
    return less @ q[place, :3], (less @ (0.5 * s**2)[..., None])[..., 0], R


def _windows(tree: ObjectModel, t: Array, q: Array, gravity: float, w: int, stride: int = 1) -> tuple[Array, Array]:
    """p + g t²/2 e_z (k, 3 w) and its derivatives by c (k, 3 w, 3 n_b) of each window, less its line in time."""
    y, fall, J = _less_line(tree, t, q, w, stride)
    y[..., 2] += gravity * fall
    return y.reshape(len(y), -1), J.reshape(len(y), y[0].size, -1)


def _misfit(y: Array, J: Array, com: Array) -> Array:
    """Root mean square of each window's distance from a parabola [m], (k,)."""
    return np.asarray(np.sqrt(np.mean((y + J @ com) ** 2, axis=1)))


def _solve(y: Array, J: Array, weights: Array) -> Array:
    """The centre of mass that weighted windows show [m], (3 n_b,); the origin along what no window turns about."""
    H, b = np.einsum("k,kai,kaj->ij", weights, J, J), np.einsum("k,kai,ka->i", weights, J, y)
    return np.asarray(-np.linalg.solve(H + (1e-6 * np.trace(H) + 1e-12) * np.eye(len(b)), b))


def _noise(tracks: Sequence[PoseTrack]) -> float:
    """Standard deviation of recorded positions [m], from third differences of what is not at rest to the last digit."""
    third = np.abs(np.concatenate([np.diff(track.q[:, :3], n=3, axis=0).ravel() for track in tracks]))
    third = third[third > 0]
    # the quieter half, as impacts and turning frames are in the other; a normal distribution's quartile is 0.3186 σ
    return float(np.quantile(third, 0.25) / 0.3186 / np.sqrt(20)) if len(third) else 0.0


def _window_frames(t: Array, seconds: float) -> int:
    return max(WINDOW_FRAMES, int(np.ceil(seconds / float(np.median(np.diff(t))) - 1e-6)) + 1)


def _all_windows(tree: ObjectModel, tracks: Sequence[PoseTrack], gravity: float, seconds: float) -> tuple[Array, Array]:
    """Evenly drawn windows in which the pose changes, as of `_windows`, of as many frames each."""
    w = int(np.median([_window_frames(track.t, seconds) for track in tracks]))
    total = sum(max(0, len(track.t) - w + 1) for track in tracks)
    stride = max(1, w // 3, -(-total // MOST_WINDOWS))
    moving = [(track, _moving_frames(track)) for track in tracks]
    found = [_windows(tree, track.t[:n], track.q[:n], gravity, w, stride) for track, n in moving if n >= w]
    if not found:
        return np.zeros((0, 3 * w)), np.zeros((0, 3 * w, 3 * tree.n_bodies))
    y, J = zip(*found, strict=True)
    return np.concatenate(y), np.concatenate(J)


def _moving_frames(track: PoseTrack) -> int:
    """Frames up to where the object stays at rest for good."""
    quat = quat_continuous(track.q[:, 3:7])
    far = np.linalg.norm(track.q[:, :3] - track.q[-1, :3], axis=1) > STILL
    far |= 2 * np.linalg.norm(quat - quat[-1], axis=1) > STILL
    far |= (np.abs(track.q[:, 7:] - track.q[-1, 7:]) > STILL).any(axis=1)
    return max(int(np.flatnonzero(far)[-1]) + 1 if far.any() else 0, 2)
