"""Open-loop predictions from the starts of tosses, and their errors, which rollout training minimises."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import kernel
from tossid.models.predictor import Predictor
from tossid.motion import FlightState, frames_in_flight
from tossid.objects import ObjectModel, corner_heights
from tossid.types import Toss

Array = NDArray[np.float64]

SMALL_SINE = 1e-8
"""Sine of half an angle below which a rotation vector is twice the quaternion's vector."""


@dataclass(frozen=True)
class Shots:
    """Initial states, and what was measured after them: S shots of at most L frames.

    Attributes:
        q0: (S, nq) first configurations.
        v0: (S, nv) first velocities.
        n_steps: (S,) frames to predict.
        target: (S, L, nq) measured at frames 1 to L, held past a shot's own n_steps.
        toss: (S,) index of the toss.
        dt: Length of a frame [s].
        length: Half the object's width, the unit of errors of position [m].
    """

    q0: Array
    v0: Array
    n_steps: NDArray[np.int64]
    target: Array
    toss: NDArray[np.int64]
    dt: float
    length: float

    @property
    def inside(self) -> NDArray[np.bool_]:
        """(S, L): the frames that were measured."""
        return np.arange(self.target.shape[1]) < self.n_steps[:, None]

    def in_shares(self, count: int) -> list[Shots]:
        """The shots in shares, each evenly spread over the tosses, and each as large as those before it together.

        Args:
            count: Of tosses in the first share, at least; all shots are one share where there are not twice as many.
        """
        n, stride = int(self.toss.max()) + 1, 1
        while n // (2 * stride) >= count:
            stride *= 2
        shares = [self if stride == 1 else self.chosen(self.toss % stride == 0)]
        while stride > 1:
            shares.append(self.chosen(self.toss % stride == stride // 2))
            stride //= 2
        return shares

    def chosen(self, which: NDArray[np.bool_]) -> Shots:
        """Some of the shots.

        Args:
            which: (S,) marks them, at least one.
        """
        longest = int(self.n_steps[which].max())
        return replace(
            self,
            q0=self.q0[which],
            v0=self.v0[which],
            n_steps=self.n_steps[which],
            target=self.target[which, :longest],
            toss=self.toss[which],
        )


def first_states(
    tosses: Sequence[Toss], model: ObjectModel, predictor: Predictor, *, velocity_lag: float
) -> tuple[Array, Array]:
    """Recorded first states, with velocities brought forward over their lag by the model.

    A state in which the predictor's corners are in the ground is lifted out of it: contact that yields would throw it
    up, as a pose that is 5 mm too low loads its springs.

    Args:
        tosses: B of them, with true lengths.
        model: The object; its corners count where the predictor has none.
        predictor: Gives the corners, and the acceleration over the lag.
        velocity_lag: [s], see `motion.MeasurementModel`.

    Returns:
        q (B, nq) and v (B, nv).
    """
    q, v = np.stack([toss.q[0] for toss in tosses]), np.stack([toss.v[0] for toss in tosses])
    model = model.with_changes(corner_pos=predictor.corner_pos) if predictor.corner_pos is not None else model
    q[:, 2] += np.maximum(0.0, -corner_heights(model, q).min(axis=-1))
    return q, v + velocity_lag * predictor.acceleration(q, v) if velocity_lag else v


def make_shots(
    model: ObjectModel,
    tosses: Sequence[Toss],
    *,
    horizon: int,
    first: tuple[Array, Array],
    flight: Sequence[FlightState | None],
) -> Shots:
    """One shot from each toss's recorded first state, and one from the first state that its flight gives.

    Args:
        model: The object as it is estimated.
        tosses: With true lengths.
        horizon: Frames to predict after the object may first have touched the ground.
        first: Of `first_states`.
        flight: First states that flights gave; None where there is too little flight.
    """
    lengths = np.array([len(toss) for toss in tosses])
    n_steps = np.minimum(frames_in_flight(tosses, model) + horizon, lengths - 1)
    states: list[tuple[int, Array, Array]] = []
    for i, start in enumerate(flight):
        states.append((i, first[0][i], first[1][i]))
        if start is not None:
            states.append((i, start.q, start.v))
    index, q, v = zip(*states, strict=True)
    which = np.array(index)
    return _shots(model, [tosses[i] for i in index], which, np.stack(q), np.stack(v), n_steps[which])


def make_stretches(
    model: ObjectModel, tosses: Sequence[Toss], predictor: Predictor, *, steps: int, velocity_lag: float
) -> Shots:
    """One shot from every `steps`-th recorded state on, so many frames long (multiple shooting).

    For objects with joints: a few impacts after a recorded state, links may be anywhere.

    Args:
        model: The object as it is estimated.
        tosses: With true lengths.
        predictor: As of `first_states`.
        steps: Frames of a stretch; at most those of the longest toss.
        velocity_lag: [s], see `motion.MeasurementModel`.
    """
    steps = min(steps, max(len(toss) for toss in tosses) - 1)
    index, cut = zip(*stretches(tosses, steps), strict=True)
    q, v = first_states(cut, model, predictor, velocity_lag=velocity_lag)
    return _shots(model, cut, np.array(index), q, v, np.full(len(cut), steps))


def stretches(tosses: Sequence[Toss], steps: int) -> list[tuple[int, Toss]]:
    """Tosses cut into stretches of equal length, each with its toss's index; a shorter rest is left out.

    Args:
        tosses: Any.
        steps: Frames after the first.
    """
    return [
        (i, toss.frames(slice(first, first + steps + 1)))
        for i, toss in enumerate(tosses)
        for first in range(0, len(toss) - steps, steps)
    ]


def _shots(
    model: ObjectModel,
    recorded: Sequence[Toss],
    toss: NDArray[np.int64],
    q0: Array,
    v0: Array,
    n_steps: NDArray[np.int64],
) -> Shots:
    """Of S first states: what was recorded from each on, the index of its toss, and how many frames to predict."""
    target = np.empty((len(recorded), n_steps.max(), model.nq))
    for row, (each, n) in enumerate(zip(recorded, n_steps, strict=True)):
        target[row, :n] = each.q[1 : n + 1]
        target[row, n:] = each.q[n]
    return Shots(
        q0=q0,
        v0=v0,
        n_steps=n_steps,
        target=target,
        toss=toss,
        dt=float(np.median(np.concatenate([np.diff(each.t) for each in recorded]))),
        length=0.5 * model.width,
    )


def prediction_errors(predictor: Predictor, shots: Shots, *, n_threads: int = 1) -> Array:
    """How far predictions are from what was measured.

    Args:
        predictor: Rolls the first states out.
        shots: First states and targets.
        n_threads: For rollouts.

    Returns:
        (S, L, nv), predicted minus measured: base position in half widths, rotation vector in the body's frame [rad],
        joints [rad or m]. Zero past a shot's end.
    """
    run = predictor.rollout(shots.q0, shots.v0, n_steps=shots.n_steps, dt=shots.dt, n_threads=n_threads)
    error = np.empty((*shots.target.shape[:2], shots.v0.shape[1]))
    _fill_errors(run.q, shots.target, shots.n_steps, shots.length, error)
    return error


@kernel(allocates=False)
def _fill_errors(q, target, n_steps, length, error):  # type: ignore[no-untyped-def]
    """Predicted minus measured of frames 1 to n_steps of each motion, and zero after them.

    Args:
        q: (S, T + 1, nq) predicted configurations, T at least the largest of n_steps.
        target: (S, L, nq) measured ones at frames 1 to L.
        n_steps: (S,) frames to compare.
        length: Unit of the position's error [m].
        error: (S, L, nq - 1), filled: position, rotation vector in the measured body frame [rad], joints.
    """
    joints = q.shape[2] - 7
    for s in range(error.shape[0]):
        for frame in range(error.shape[1]):
            if frame >= n_steps[s]:
                for k in range(error.shape[2]):
                    error[s, frame, k] = 0.0
                continue
            for k in range(3):
                error[s, frame, k] = (q[s, frame + 1, k] - target[s, frame, k]) / length
            aw, ax, ay, az = q[s, frame + 1, 3], q[s, frame + 1, 4], q[s, frame + 1, 5], q[s, frame + 1, 6]
            bw, bx, by, bz = target[s, frame, 3], target[s, frame, 4], target[s, frame, 5], target[s, frame, 6]
            w = bw * aw + (bx * ax + by * ay + bz * az)  # the measured one's conjugate times the predicted one
            x = bw * ax - aw * bx - (by * az - bz * ay)
            y = bw * ay - aw * by - (bz * ax - bx * az)
            z = bw * az - aw * bz - (bx * ay - by * ax)
            sine = math.sqrt(x * x + y * y + z * z)
            scale = 2.0 * math.atan2(sine, abs(w)) / sine if sine > SMALL_SINE else 2.0
            if w < 0.0:
                scale = -scale
            error[s, frame, 3], error[s, frame, 4], error[s, frame, 5] = scale * x, scale * y, scale * z
            for j in range(joints):
                error[s, frame, 6 + j] = q[s, frame + 1, 7 + j] - target[s, frame, 7 + j]
