"""Open-loop rollouts against measured tosses: the metrics of CONTRACT.md, with intervals over tosses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

from tossid.models.predictor import Predictor, Simulator
from tossid.models.shots import first_states, stretches
from tossid.motion import MeasurementModel, flight_states, frames_in_flight
from tossid.objects import JointType, ObjectModel, body_poses, center_positions, corner_heights
from tossid.physics import make_system
from tossid.physics.free import mass_norms
from tossid.physics.tree import make_work
from tossid.rotations import geodesic_angle
from tossid.settings.evaluation import EvaluateSettings
from tossid.types import Rollout, Toss, frame_time

Array = NDArray[np.float64]

AT_ONCE = 1 << 21
"""Values that a bootstrap draws together; bounds the memory, as its jackknife holds the square of the tosses."""


@dataclass(frozen=True)
class TossScores:
    """Scores of rollouts, one a toss (B,).

    Attributes:
        position_error_pct: Mean over frames of the distance of the geometric centres [% of the width].
        rotation_error_deg: Mean over frames of the geodesic angle.
        penetration_mm: Mean over frames of the depth of the deepest stated corner.
        recorded_penetration_mm: The same of the recorded poses themselves, the floor that noise and a wrong size set: a
            rollout that sinks no deeper sinks as far as the tracked object seems to.
        gravity_ms2: Mean downward acceleration of the model in the toss's free flight.
        joint_error_deg: Mean over frames and hinges, within half a turn; NaN without hinges.
        link_error_deg: (B, n_b) mean over frames of each body's geodesic angle.
        flight_miss_pct: How far the model's acceleration in free flight is from that of the stated object under
            9.81 m/s²: median over the flight's states, in % of it, both in the norm of the stated mass matrix.
        unsolved: Contact problems that were not solved to the tolerance.
        diverged: Rollouts in which a state became NaN or infinite.
    """

    position_error_pct: Array
    rotation_error_deg: Array
    penetration_mm: Array
    recorded_penetration_mm: Array
    gravity_ms2: Array
    joint_error_deg: Array
    link_error_deg: Array
    flight_miss_pct: Array
    unsolved: int
    diverged: int


def roll_out(
    predictor: Predictor,
    model: ObjectModel,
    tosses: Sequence[Toss],
    *,
    measurement: MeasurementModel | None = None,
    from_flight: bool = False,
    dt: float | None = None,
    n_threads: int = 1,
) -> tuple[Rollout, ...]:
    """Every toss from its first state to its last frame, open loop, as it would be recorded (q; v is the simulator's).

    Args:
        predictor: What is rolled out, in true lengths.
        model: The object as it is stated.
        tosses: As recorded.
        measurement: How recorded motion relates to true motion.
        from_flight: Start from the state estimated from the toss's first free flight.
        dt: Between frames [s]; None for the tosses' `frame_time`.
        n_threads: For rollouts.
    """
    if not tosses:
        return ()
    measurement = measurement or MeasurementModel()
    true = [measurement.true_toss(toss) for toss in tosses]
    q0, v0 = first_states(true, model, predictor, velocity_lag=measurement.velocity_lag)
    if from_flight:
        states = flight_states(true, model)
        q0, v0 = np.stack([s.q for s in states]), np.stack([s.v for s in states])
    dt = dt or frame_time(tosses)
    ticks = [toss.ticks(dt) for toss in tosses]
    run = predictor.rollout(q0, v0, n_steps=np.array([each[-1] for each in ticks]), dt=dt, n_threads=n_threads)
    q, lam_n = measurement.recorded_q(run.q), np.pad(run.lam_n, ((0, 0), (1, 0), (0, 0)))
    return tuple(
        Rollout(toss.t, q[i, at], run.v[i, at], lam_n[i, at], int(run.unsolved[i]), not run.finite[i])
        for i, (toss, at) in enumerate(zip(tosses, ticks, strict=True))
    )


def score_tosses(
    predictor: Predictor,
    model: ObjectModel,
    tosses: Sequence[Toss],
    *,
    measurement: MeasurementModel | None = None,
    from_flight: bool = False,
    dt: float | None = None,
    n_threads: int = 1,
) -> TossScores:
    """Scores of open-loop rollouts (`roll_out`) of every toss.

    Args:
        predictor: As of `roll_out`, as all others.
        model: The object as it is stated; its centre, width and corners are compared.
        tosses: As recorded.
        measurement: How recorded motion relates to true motion.
        from_flight: Start from the state estimated from the toss's first free flight.
        dt: Between frames [s]; None for the tosses' `frame_time`.
        n_threads: For rollouts.
    """
    measurement = measurement or MeasurementModel()
    runs = roll_out(
        predictor, model, tosses, measurement=measurement, from_flight=from_flight, dt=dt, n_threads=n_threads
    )
    if not runs:
        none = np.empty(0)
        return TossScores(none, none, none, none, none, none, np.empty((0, model.n_bodies)), none, 0, 0)
    each = _Stretches(np.array([len(toss) for toss in tosses]))
    q, at = np.concatenate([run.q for run in runs]), np.concatenate([toss.q for toss in tosses])
    distance = np.linalg.norm(center_positions(model, q) - center_positions(model, at), axis=1)
    angle = geodesic_angle(q[:, 3:7], at[:, 3:7])
    link = angle[:, None]
    if model.n_joints:
        link = geodesic_angle(body_poses(model, q)[1], body_poses(model, at)[1])
    hinge = 7 + np.flatnonzero(model.joint_type[1:] == JointType.HINGE)
    joint = np.abs(wrapped(q[:, hinge] - at[:, hinge])).mean(axis=1) if len(hinge) else np.full(len(q), np.nan)
    true = [measurement.true_toss(toss) for toss in tosses]
    gravity, flight = _of_flight(predictor, model, true, frames_in_flight(tosses, model))
    return TossScores(
        position_error_pct=100 * each.means(distance) / model.width,
        rotation_error_deg=np.rad2deg(each.means(angle)),
        penetration_mm=1e3 * each.means(_depths(model, q)),
        recorded_penetration_mm=1e3 * each.means(_depths(model, at)),
        gravity_ms2=gravity,
        joint_error_deg=np.rad2deg(each.means(joint)),
        link_error_deg=np.rad2deg(each.means(link)),
        flight_miss_pct=flight,
        unsolved=sum(run.unsolved for run in runs),
        diverged=sum(run.diverged for run in runs),
    )


@dataclass(frozen=True)
class _Stretches:
    """Stretches of rows that follow one another, each of at least one.

    Attributes:
        lengths: (B,) numbers of rows.
    """

    lengths: NDArray[np.int64]

    def means(self, values: Array) -> Array:
        """(B, *b) means of each stretch's values (N, *b)."""
        total = np.add.reduceat(values, np.cumsum(self.lengths) - self.lengths, axis=0)
        return total / self.lengths.reshape(-1, *[1] * (values.ndim - 1))

    def parts(self, values: Array) -> list[Array]:
        """Each stretch's values (N, *b)."""
        return np.split(values, np.cumsum(self.lengths)[:-1])


def _depths(model: ObjectModel, q: Array) -> Array:
    """(N,) depth of the deepest corner of configurations [m], 0 above the ground."""
    return np.maximum(-corner_heights(model, q).min(axis=1), 0)


def _of_flight(
    predictor: Predictor, model: ObjectModel, tosses: Sequence[Toss], frames: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Gravity (B,) [m/s²] and the miss of the acceleration (B,) [%] in tosses' free flights, NaN without one.

    Lengths of the tosses are true ones; `frames` (B,) is how many of each are flight.
    """
    gravity, flight = np.full((2, len(tosses)), np.nan)
    flying = np.flatnonzero(frames)
    if len(flying):
        each = _Stretches(frames[flying])
        q, v = (np.concatenate([getattr(tosses[i], name)[: frames[i]] for i in flying.tolist()]) for name in "qv")
        found = predictor.acceleration(q, v)
        gravity[flying] = -each.means(found[:, 2])
        flight[flying] = [np.median(part) for part in each.parts(_flight_errors(model, q, v, found))]
    return gravity, flight


def score_windows(
    predictor: Predictor,
    model: ObjectModel,
    tosses: Sequence[Toss],
    *,
    steps: int = EvaluateSettings.short_steps,
    measurement: MeasurementModel | None = None,
    dt: float | None = None,
    n_threads: int = 1,
) -> TossScores:
    """Scores of short rollouts, each from a recorded state: every toss is cut into stretches.

    Args:
        predictor: As of `roll_out`.
        model: The object as it is stated.
        tosses: As recorded.
        steps: Frames of a stretch.
        measurement: How recorded motion relates to true motion.
        dt: Between frames [s]; None for the tosses' `frame_time`.
        n_threads: For rollouts.

    Returns:
        A toss's score is the mean over its stretches; tosses shorter than one have NaN.
    """
    parts = stretches(tosses, steps)
    cut = [part for _, part in parts]
    dt = dt or frame_time(tosses)
    scores = score_tosses(predictor, model, cut, measurement=measurement, dt=dt, n_threads=n_threads)
    of = np.array([i for i, _ in parts])

    def by_toss(values: Array) -> Array:
        out = np.full((len(tosses), *values.shape[1:]), np.nan)
        for i in np.unique(of):
            own = values[of == i]
            known = np.isfinite(own).reshape(len(own), -1).all(axis=1)
            if known.any():
                out[i] = own[known].mean(axis=0)
        return out

    return TossScores(
        **{name: by_toss(value) for name, value in vars(scores).items() if isinstance(value, np.ndarray)},
        unsolved=scores.unsolved,
        diverged=scores.diverged,
    )


def joined(parts: Sequence[TossScores]) -> TossScores:
    """Scores of several batches of tosses as one.

    Args:
        parts: At least one.
    """
    names = [name for name, value in vars(parts[0]).items() if isinstance(value, np.ndarray)]
    return TossScores(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names},
        unsolved=sum(part.unsolved for part in parts),
        diverged=sum(part.diverged for part in parts),
    )


def wrapped(angle: Array) -> Array:
    """Angles within half a turn: a hinge that is off by whole turns is where it should be.

    Args:
        angle: [rad].
    """
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _flight_errors(model: ObjectModel, q: Array, v: Array, found: Array) -> Array:
    """(N,) |found - stated| / |stated| [%] of states' accelerations (N, nv), in the norm of M."""
    stated = Simulator(make_system(model))
    true, work, (off, size) = stated.acceleration(q, v), make_work(stated.system), np.empty((2, len(q)))
    mass_norms(stated.system, q, found - true, work, off)
    mass_norms(stated.system, q, true, work, size)
    return 100 * off / size


def summarize(values: Array, *, draws: int = EvaluateSettings.draws, seed: int = 0) -> dict[str, Any]:
    """Mean over tosses with its 95 % interval, by a BCa bootstrap over tosses (Efron 1987; SciPy's).

    Args:
        values: (B,), one a toss; missing ones (NaN) are left out.
        draws: Sets of tosses that are drawn.
        seed: Of the draws.

    Returns:
        {"mean", "ci95": [low, high], "n"}.
    """
    values = values[np.isfinite(values)]
    mean = float(values.mean()) if len(values) else float("nan")
    if len(values) < 2 or np.ptp(values) < 1e-12:
        return {"mean": mean, "ci95": [mean, mean], "n": len(values)}
    rng, batch = np.random.default_rng(seed), max(1, AT_ONCE // len(values))
    interval = bootstrap((values,), np.mean, n_resamples=draws, batch=batch, rng=rng).confidence_interval
    return {"mean": mean, "ci95": [float(interval.low), float(interval.high)], "n": len(values)}


def summarize_scores(
    scores: TossScores, model: ObjectModel, *, draws: int = EvaluateSettings.draws, seed: int = 0
) -> dict[str, Any]:
    """The four metrics, the recorded poses' own penetration and the error in flight, each with mean and interval.

    Joints and links are added where there are any.

    Args:
        scores: One a toss.
        model: The object, for its joints.
        draws: As of `summarize`.
        seed: As of `summarize`.
    """
    keys = ["position_error_pct", "rotation_error_deg", "penetration_mm", "recorded_penetration_mm", "gravity_ms2"]
    keys += ["flight_miss_pct"]
    found = {key: summarize(getattr(scores, key), draws=draws, seed=seed) for key in keys}
    if model.n_joints:
        found["joint_error_deg"] = summarize(scores.joint_error_deg, draws=draws, seed=seed)
        for b in range(1, model.n_bodies):
            key = f"rotation_error_deg_{model.body_names[b]}"
            found[key] = summarize(scores.link_error_deg[:, b], draws=draws, seed=seed)
    return found
