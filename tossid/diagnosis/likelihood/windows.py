"""Windows: short stretches of tosses that are predicted from uncertain first states.

A toss is cut into consecutive windows, and its flights are in others besides. In each, the simulator f starts from a
state x that is a nuisance parameter: its pose is known as well as poses are measured, its velocity hardly at all
(recorded velocities lag, and are smeared over impacts). With S = df/dx and measured poses y with noise R, to first
order around x_0,

    y - f(x_0) - S (x_rec - x_0) ~ N(0, R + S P S^T),

where P is the covariance of the recorded state x_rec. Whitened by the Cholesky factor in the order of time (module
`whitening`), every entry is the innovation of one row and channel given the rows before it: of unit variance where the
simulator is right, whatever the first state was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.cuts import FrameClock, cut_consecutively, cut_flights, pose_std
from tossid.diagnosis.likelihood.residuals import mean_residuals
from tossid.diagnosis.likelihood.slow_errors import inverse_factors, slow_covariance
from tossid.motion.resting import rest_scatter
from tossid.objects import ObjectModel, corner_heights
from tossid.physics.effects import World
from tossid.settings.diagnosis.likelihood import LikelihoodSettings, SimulationSettings
from tossid.types import Toss, frame_time

Array = NDArray[np.float64]


class Steps(TypedDict):
    """How a window is simulated; the arguments of `World.roll_out`."""

    substeps: int
    impact_parts: int
    tolerance: float


def steps_of(world: World, settings: SimulationSettings = SimulationSettings()) -> Steps:
    """Simulator steps a frame, and parts of a step with an impact.

    Args:
        world: Compliant contact needs more parts; rigid impacts end steps.
        settings: The numbers.
    """
    parts = settings.impact_parts if world.object.compliance == 0 else settings.compliant_impact_parts
    return {"substeps": settings.substeps, "impact_parts": parts, "tolerance": settings.tolerance}


@dataclass(frozen=True)
class Windows:
    """W windows of tosses: a first frame, and at most F ticks after it, in at most L rows of K = nv channels.

    A tick is a frame of the camera's clock. Where frames are missing, their ticks are simulated and are in no row. In
    contact a row is a frame. In flight and at rest, where nothing is sudden, windows are longer and a row is the
    mean of a few frames: a weak force shows only over the whole of it. Channels are the base's position and rotation,
    and each joint.

    Attributes:
        q: (W, K + 1) recorded first poses.
        v: (W, K) recorded first velocities.
        at_q: (W, K + 1) first poses around which predictions are linearised.
        at_v: (W, K) first velocities around which predictions are linearised.
        y: (W, F, K + 1) measured poses; where a frame is missing, and after the last, the one before.
        y_noise: (W, F, K) standard deviations of these [m, rad].
        steps: (W,) ticks after the first frame.
        mix: (W, L, F) weights with which a row is the mean of ticks; 0 where a frame is missing.
        noise: (W, L, K) standard deviations of rows [m, rad].
        inside: (W, L) whether a row exists.
        toss: (W,) number of the toss.
        first: (W,) tick of the first frame in its toss.
        tick: (W, L) of a row's first frame in its toss.
        phase: (W, L) a row's `Phase`.
        dt: Time between ticks [s].
        prior: (W, 2 K) standard deviations of the recorded first states.
        slow: (W, K, L + 1, L + 1) each channel's covariances, between the first pose and all rows, of errors that
            change slowly with the object's attitude: a tracker's calibration. Zeros where there are none.
        root: (W, K, L + 1, L + 1) inverse Cholesky factors of each channel's whole covariance: slow errors and noise.
        clearance: (W,) least height of the stated object's corners over z = 0, at recorded poses [m].
        extent: (W, 3) farthest from the recorded origin, along the vertical and across it [m], and recorded first spin
            [rad/s].
        free: (W,) windows of flights, which end before the landing. Their frames are in other windows too: what flight
            alone shows needs no model of contact.
        stated: The stated object; None without one.
        settings: Of the likelihood that is made of these windows.
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
    first: NDArray[np.int64]
    tick: NDArray[np.int64]
    phase: NDArray[np.uint8]
    dt: float
    prior: Array
    slow: Array
    root: Array
    clearance: Array
    extent: Array
    free: NDArray[np.bool_]
    stated: ObjectModel | None
    settings: LikelihoodSettings

    @property
    def channels(self) -> int:
        """Number of channels, K."""
        return self.v.shape[1]

    @property
    def counted(self) -> NDArray[np.bool_]:
        """(W, L) rows of the consecutive windows, in which each frame is once."""
        return self.inside & ~self.free[:, None]

    @property
    def steady(self) -> NDArray[np.bool_]:
        """(W,) whether a window is a long one, all flight or all rest."""
        return np.asarray((self.mix > 0).sum(axis=2).max(axis=1, initial=0) > 1)

    @property
    def present(self) -> NDArray[np.bool_]:
        """(W, F) ticks that have a frame."""
        return np.asarray(self.mix.any(axis=1))

    def feels(self, world: World, other: World) -> NDArray[np.bool_]:
        """(W,) whether a window's motion can differ between two worlds: not where it stays above the ground of both.

        Args:
            world: One.
            other: Another, whose free motion may be the same.
        """
        if self.stated is None or not world.flies_like(other):
            return np.ones(len(self.steps), dtype=bool)
        ground = max(world.ground_height, other.ground_height, 0.0)
        below = np.maximum(*(each.lower_corners(self.stated, *self.extent.T) for each in (world, other)))
        return np.asarray(self.clearance < self.settings.windows.clearance + ground + below)

    def variances(self, index: NDArray[np.int64]) -> Array:
        """(n, K L) of the measured poses [m², rad²]; 1 in rows that do not exist.

        Args:
            index: (n,) of which windows.
        """
        found: Array = np.where(self.inside[index, :, None], self.noise[index] ** 2, 1.0)
        return found.reshape(len(index), self.inside.shape[1] * self.channels)

    def predicted(
        self,
        world: World,
        q: Array | None = None,
        v: Array | None = None,
        index: NDArray[np.int64] | None = None,
        *,
        near: bool = False,
        n_threads: int = 1,
    ) -> Array:
        """(n, F, K + 1) recorded poses as the world predicts them.

        Args:
            world: The simulator.
            q: (n, K + 1) first poses; those of linearisation if None.
            v: (n, K) first velocities, likewise.
            index: (n,) of which windows; of all, once or several times in turn, if None.
            near: Whether first states are near those of linearisation, by whose motions others may be found.
            n_threads: Of the simulator.
        """
        at = (self.at_q, self.at_v) if index is None else (self.at_q[index], self.at_v[index])
        q, v = at if q is None or v is None else (q, v)
        n_steps = np.tile(self.steps, len(q) // len(self.steps)) if index is None else self.steps[index]
        how = steps_of(world, self.settings.simulation)
        run = world.roll_out(q, v, n_steps=n_steps, dt=self.dt, near=at if near else None, **how, n_threads=n_threads)
        return run[:, 1:]

    def residuals(self, predicted: Array, index: NDArray[np.int64] | None = None) -> Array:
        """(n, L, K) measured minus predicted: position [m], rotation vector in the body frame [rad], joints [rad].

        Args:
            predicted: (n, f, K + 1) poses of at least as many frames as any of these windows has.
            index: As of `predicted`.
        """
        index = np.arange(len(predicted)) % len(self.steps) if index is None else index
        return mean_residuals(self.y, predicted, self.mix, self.steps, index)

    def rows(self, index: NDArray[np.int64]) -> Windows:
        """Some of the windows.

        Args:
            index: (n,) their numbers.
        """
        names = (field.name for field in fields(self) if field.name not in ("dt", "stated", "settings"))
        return replace(self, **{name: getattr(self, name)[index] for name in names})

    def of_tosses(self, index: NDArray[np.int64]) -> Windows:
        """The windows of some tosses, which are renumbered in the order given.

        Args:
            index: (n,) numbers of the tosses.
        """
        number = np.full(max(self.toss.max(initial=0), index.max(initial=0)) + 1, -1)
        number[index] = np.arange(len(index))
        some = self.rows(np.flatnonzero(number[self.toss] >= 0))
        return replace(some, toss=number[some.toss])


def make_windows(
    tosses: Sequence[Toss],
    model: ObjectModel | None = None,
    *,
    settings: LikelihoodSettings = LikelihoodSettings(),
    shift: int = 0,
    flights: bool = True,
    scatter: tuple[float, float] | None = None,
) -> Windows:
    """Tosses cut into consecutive windows, which end where many frames are missing or times are uneven.

    What is left at the end of a stretch is kept if it is half a window long.

    Args:
        tosses: Of one object.
        model: The object, from whose flights windows of their own are made and from whose poses at rest a tracker's
            slow errors are estimated; without it there are neither.
        settings: Of the likelihood.
        shift: Frames of each toss that are left out at its beginning, which shifts all windows.
        flights: Whether flights get windows of their own.
        scatter: Sizes of a tracker's slow errors [m], [rad], as other tosses show them; these tosses' own if None.
    """
    cut = settings.windows
    length, long = cut.length, cut.long
    dt = frame_time(tosses)
    most, K = max(length, long), tosses[0].v.shape[1]
    clocks = [FrameClock.of(toss, dt, min(cut.most_missing + 1, length), cut.time_step_tolerance) for toss in tosses]
    cuts = [(i, *each) for i, toss in enumerate(tosses) for each in cut_consecutively(toss, clocks[i], shift, cut)]
    consecutive = len(cuts)
    if model is not None and flights:
        cuts += [(i, *each) for i, toss in enumerate(tosses) for each in cut_flights(toss, clocks[i], model, cut)]
    if scatter is None:
        scatter = (0.0, 0.0) if model is None else rest_scatter(tosses, model)
    W = len(cuts)
    q, v, y = np.empty((W, K + 1)), np.empty((W, K)), np.empty((W, most, K + 1))
    y_noise, first_noise = np.empty((W, most, K)), np.empty((W, K))
    mix, tick, phase = np.zeros((W, length, most)), np.zeros((W, length), int), np.zeros((W, length), np.uint8)
    first, steps = np.empty(W, int), np.empty(W, int)
    least_std = np.array([cut.least_position_std] * 3 + [cut.least_rotation_std] * (K - 3))
    for w, (i, begin, end) in enumerate(cuts):
        toss, ticks = tosses[i], clocks[i].tick[begin : end + 1]
        poses, cov = toss.measured
        first[w], steps[w] = ticks[0], ticks[-1] - ticks[0]
        later = ticks[1:] - ticks[0] - 1
        at = begin + np.searchsorted(later, np.arange(most), side="right")
        std = np.maximum(pose_std(cov[begin : end + 1]), least_std)
        q[w], v[w], y[w] = poses[begin], toss.v[begin], poses[at]
        first_noise[w], y_noise[w] = std[0], std[at - begin]
        each = -(-int(steps[w]) // length)
        for row, block in enumerate(np.unique(later // each)):
            some = np.flatnonzero(later // each == block)
            mix[w, row, later[some]] = 1 / len(some)
            tick[w, row], phase[w, row] = ticks[1 + some[0]], toss.phase[begin + 1 + some[0]]
    inside = np.asarray(mix.any(axis=2))
    slow_std = np.array([scatter[0]] * 3 + [scatter[1]] * (K - 3))
    slow = slow_covariance(q[:, 3:7], y[..., 3:7], mix, slow_std, cut.attitude_scale)
    noise = np.where(inside[..., None], np.sqrt(mix**2 @ y_noise**2), 1.0)
    speeds = np.tile([cut.velocity_std] * 3 + [cut.spin_std] * (K - 3), (W, 1))
    return Windows(
        q=q,
        v=v,
        at_q=q.copy(),
        at_v=v.copy(),
        y=y,
        y_noise=y_noise,
        steps=steps,
        mix=mix,
        noise=noise,
        inside=inside,
        toss=np.array([i for i, _, _ in cuts]),
        first=first,
        tick=tick,
        phase=phase,
        dt=dt,
        prior=np.concatenate([first_noise, speeds], axis=1),
        slow=slow,
        root=inverse_factors(slow, np.concatenate([first_noise[:, None], noise], axis=1)),
        clearance=_clearance(model, q, y),
        extent=np.stack(
            [
                np.abs(y[..., 2]).max(axis=1),
                np.linalg.norm(y[..., :2], axis=-1).max(axis=1),
                np.linalg.norm(v[:, 3:6], axis=1),
            ],
            axis=1,
        ),
        free=np.arange(W) >= consecutive,
        stated=model,
        settings=settings,
    )


def _clearance(model: ObjectModel | None, q: Array, y: Array) -> Array:
    """(W,) least height of an object's corners [m] at first poses (W, K + 1) and frames (W, F, K + 1); -inf if None."""
    if model is None:
        return np.full(len(q), -np.inf)
    poses = np.concatenate([q[:, None], y], axis=1)
    low: Array = corner_heights(model, poses).min(axis=(1, 2))
    return low
