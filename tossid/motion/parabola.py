"""Free flight of a body of unknown shape, from its poses alone: its centre of mass is on a parabola.

With the body's recorded position p and rotation R and its centre of mass c in the body's frame, a flight has
p + R c = a + b t - g t²/2 e_z. Over a short window, a and b are projected out, so that c is what is left: the same for
all windows. Of two links, c has a part for each (`tossid.motion.links`). A redescending loss, whose scale shrinks
(graduated non-convexity), finds the windows that agree. What rests, slides or rolls does not fall, and what is hit
leaves its parabola.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.motion.kinematics import body_velocities, com_velocities
from tossid.motion.links import com_of_moments, turns
from tossid.objects import GRAVITY, ObjectModel, unstated_object
from tossid.objects.unstated import hinge_of
from tossid.rotations import quat_continuous
from tossid.settings.motion import ParabolaSettings, PhaseSettings
from tossid.types import Phase, PoseTrack

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

DEFAULT = ParabolaSettings()


@dataclass(frozen=True)
class Parabola:
    """How a body of unknown shape flies.

    Attributes:
        tree: The body, or the links and their hinge.
        com: Centre of mass in the body's frame, or each link's part c_b of it [m], (n_b, 3).
        gyration: Radius that compares spins with speeds [m]: a guess from how near the ground the centre of mass comes.
        gravity: Of free flight [m/s²].
        seconds: Duration of a window [s].
        frames: Fewest frames of a window.
        misfit: Root mean square below which a window flies [m].
    """

    tree: ObjectModel
    com: Array
    gyration: float
    gravity: float
    seconds: float
    frames: int
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
        touching, w = np.ones(len(t) - 1, dtype=bool), _frames(t, self.seconds, self.frames)
        if len(t) < w:
            return touching
        y, J = _windows(self.tree, t, q, self.gravity, w)
        rms = np.sqrt(np.mean((y + J @ self.com.ravel()) ** 2, axis=(1, 2)))
        for first in np.flatnonzero(rms < self.misfit):
            touching[first : first + w - 1] = False
        return touching

    def flying(self, t: Array, q: Array) -> Bools:
        """Frames in free flight, (n,): those with an interval beside them in which nothing else acts.

        Args:
            t: Times [s], (n,).
            q: Configurations, (n, nq).
        """
        free, out = ~self.may_touch(t, q), np.zeros(len(t), dtype=bool)
        out[1:] |= free
        out[:-1] |= free
        return out


def find_parabola(
    tracks: Sequence[PoseTrack],
    tree: ObjectModel | None = None,
    *,
    gravity: float = GRAVITY,
    settings: ParabolaSettings = DEFAULT,
) -> Parabola:
    """The centre of mass of a body and the misfit of its flights, from tracks of which nothing is known.

    Args:
        tracks: Of one rigid body or of two links on a hinge, z up.
        tree: The links and their hinge; None for one rigid body. Nothing else of it matters.
        gravity: Where they were recorded [m/s²].
        settings: Of the windows.

    Raises:
        InputError: The tracks have joints, or nothing in them falls.
    """
    tree = tree or unstated_object()
    if any(track.q.shape[1] != tree.nq for track in tracks):
        has = "is one rigid body" if not tree.n_joints else "is two links on a hinge"
        raise InputError(
            f"the unknown object {has} (object.links), and these tracks have {tracks[0].q.shape[1] - 7} joints"
        )
    noise = _noise(tracks)
    # rms of g t²/2 over T, less its line: g T² / (12 sqrt(5))
    needed = np.sqrt(settings.noise_ratio * noise * 12 * np.sqrt(5) / gravity)
    seconds = float(np.clip(needed, settings.shortest, settings.longest))
    y, J = _all_windows(tree, tracks, gravity, seconds, settings)
    carried = gravity * seconds**2 / (12 * np.sqrt(5))
    if len(y) < settings.fewest_windows:
        raise InputError(f"{len(y)} stretches of {seconds:.2g} s in which the object moves; there is no flight in them")
    com, scale = np.zeros(3 * tree.n_bodies), settings.first_scale * carried
    while scale > settings.last_scale * carried:
        scale *= 0.7
        rms = _misfit(y, J, com)
        com = _solve(y, J, 1 / (1 + (rms / scale) ** 2) ** 2)
    for _ in range(settings.iterations):
        rms = _misfit(y, J, com)
        flying = rms < settings.most_carried * carried
        if flying.sum() < settings.fewest_windows:
            raise InputError(
                f"the tosses show no flight: in {int(flying.sum())} of {len(rms)} stretches of {seconds:.2g} s some "
                f"point of the body falls at {gravity:g} m/s²; expected tosses that fly, z up, in metres and seconds"
            )
        typical = max(settings.least_misfit, settings.deviations * float(np.quantile(rms[flying], 0.3)))
        misfit = min(typical, settings.most_carried * carried)
        com = _solve(y, J, (rms < misfit).astype(float))
    parts = com.reshape(-1, 3)
    low = min(float(np.quantile(_heights(tree, track, parts), 0.02)) for track in tracks)
    gyration = float(np.clip(0.6 * low, 5e-3, 0.5))
    return Parabola(tree, parts, gyration, gravity, seconds, settings.fewest_frames, misfit)


def phases_of_motion(
    parabola: Parabola,
    t: Array,
    q: Array,
    v: Array,
    *,
    v_sigma: float = 0.0,
    limits: PhaseSettings = PhaseSettings(),
    settings: ParabolaSettings = DEFAULT,
) -> NDArray[np.uint8]:
    """Phase of every frame by motion alone, (n,) of `Phase`: flight, impact and rest; unknown where it is in contact.

    Without a shape, sliding cannot be distinguished from rolling.

    Args:
        parabola: Of the recording.
        t: Times [s], (n,).
        q: Configurations, (n, nq).
        v: Velocities, (n, nv).
        v_sigma: Standard error of a velocity [m/s].
        limits: What an impact is.
        settings: What rest is.
    """
    body, h = parabola.body(), np.diff(t)
    touching = parabola.may_touch(t, q)
    u = com_velocities(body, q, v).mean(axis=-2)
    turning = body_velocities(body, q, v)[1]
    spin = parabola.gyration * np.sqrt((turning**2).sum(-1).mean(-1))
    phase = np.full(len(t), int(Phase.UNKNOWN), dtype=np.uint8)
    flying = parabola.flying(t, q)
    change = np.diff(u, axis=0)
    change[:, 2] += parabola.gravity * h
    turned = v[:, None, 3:6] if not body.n_joints else turning
    jump = np.sqrt((change**2).sum(1) + parabola.gyration**2 * (np.diff(turned, axis=0) ** 2).sum(-1).mean(-1))
    least = np.maximum(limits.impact_weights * parabola.gravity * h, limits.impact_sigmas * np.sqrt(2.0) * v_sigma)
    phase[1:][(jump > least) & touching] = Phase.IMPACT
    phase[(np.linalg.norm(u, axis=1) < settings.rest_speed) & (spin < settings.rest_speed) & ~flying] = Phase.REST
    phase[flying] = Phase.FLIGHT
    return phase


def _misfit(y: Array, J: Array, com: Array) -> Array:
    """Root mean square of each window's distance from a parabola [m], (k,)."""
    return np.asarray(np.sqrt(np.mean((y + J @ com) ** 2, axis=1)))


def _solve(y: Array, J: Array, weights: Array) -> Array:
    """The centre of mass that weighted windows show [m], (3 n_b,); the origin along what no window turns about."""
    H, b = np.einsum("k,kai,kaj->ij", weights, J, J), np.einsum("k,kai,ka->i", weights, J, y)
    return np.asarray(-np.linalg.solve(H + (1e-6 * np.trace(H) + 1e-12) * np.eye(len(b)), b))


def _heights(tree: ObjectModel, track: PoseTrack, com: Array) -> Array:
    """Height of the centre of mass [m], (n,)."""
    return np.asarray(track.q[:, 2] + turns(tree, track.q)[:, 2] @ com.ravel())


def _noise(tracks: Sequence[PoseTrack]) -> float:
    """Standard deviation of recorded positions [m], from third differences of frames that follow each other evenly."""
    found = [np.zeros(0)]
    for track in tracks:
        h = np.diff(track.t)
        if len(h) < 4:
            continue
        even = (np.abs(h / np.median(h) - 1) < 0.2) & (np.linalg.norm(np.diff(track.q[:, :3], axis=0), axis=1) > 0)
        even = sliding_window_view(even, 3).all(axis=1)
        found.append(np.abs(np.diff(track.q[:, :3], n=3, axis=0))[even].ravel())
    every = np.concatenate(found)
    # the quieter half, as impacts and turning frames are in the other
    return float(np.quantile(every, 0.25) / 0.3186 / np.sqrt(20)) if len(every) else 0.0


def _frames(t: Array, seconds: float, fewest: int) -> int:
    """Frames of a window."""
    return max(fewest, int(np.ceil(seconds / float(np.median(np.diff(t))) - 1e-6)) + 1)


def _windows(tree: ObjectModel, t: Array, q: Array, gravity: float, w: int, stride: int = 1) -> tuple[Array, Array]:
    """Of each window of w frames, less its line in time: p + g t²/2 e_z (k, w, 3), and all R_b (k, w, 3, 3 n_b)."""
    place = np.arange(0, len(t) - w + 1, stride)[:, None] + np.arange(w)
    s = t[place] - t[place].mean(axis=1, keepdims=True)
    line = np.stack([np.ones_like(s), s / np.ptp(s, axis=1, keepdims=True)], axis=-1)
    apart = np.eye(w) - line @ np.linalg.pinv(line)
    p = q[place, :3]
    p[..., 2] += 0.5 * gravity * s**2
    R = turns(tree, q)[place]
    return apart @ p, np.einsum("kab,kbij->kaij", apart, R)


def _all_windows(
    tree: ObjectModel, tracks: Sequence[PoseTrack], gravity: float, seconds: float, settings: ParabolaSettings
) -> tuple[Array, Array]:
    """Evenly drawn windows in which the pose changes, (k, 3 w) and (k, 3 w, 3 n_b), of as many frames each."""
    counts = [_frames(track.t, seconds, settings.fewest_frames) for track in tracks]
    w = int(np.median(counts))
    total = sum(max(0, len(track.t) - w + 1) for track in tracks)
    stride = max(1, w // 3, -(-total // settings.most_windows))
    found = [
        _windows(tree, track.t, track.q, gravity, w, stride)
        for track in map(partial(_moving, settings=settings, w=w), tracks)
        if len(track.t) >= w
    ]
    if not found:
        return np.zeros((0, 3 * w)), np.zeros((0, 3 * w, 3 * tree.n_bodies))
    y, J = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return y.reshape(len(y), -1), J.reshape(len(J), -1, J.shape[-1])


def _moving(track: PoseTrack, settings: ParabolaSettings, w: int) -> PoseTrack:
    """The track up to where it stays at rest for good."""
    quat = quat_continuous(track.q[:, 3:7])
    far = np.linalg.norm(track.q[:, :3] - track.q[-1, :3], axis=1) > settings.still
    far |= 2 * np.linalg.norm(quat - quat[-1], axis=1) > settings.still
    far |= (np.abs(track.q[:, 7:] - track.q[-1, 7:]) > settings.still).any(axis=1)
    last = int(np.flatnonzero(far)[-1]) + 1 if far.any() else 0
    return PoseTrack(track.name, track.t[: max(last, 2)], track.q[: max(last, 2)])
