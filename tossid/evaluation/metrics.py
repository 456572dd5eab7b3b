"""Open-loop rollouts against measured tosses: the metrics of CONTRACT.md, with intervals over tosses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

from tossid.models.predictor import Predictor, Simulator
from tossid.models.shots import first_states, stretches
from tossid.motion import MeasurementModel, flight_states, frames_in_flight
from tossid.objects import JointType, ObjectModel, body_poses, center_positions, corner_heights
from tossid.physics import make_system
from tossid.physics.batch import mass_norms
from tossid.rotations import geodesic_angle
from tossid.types import Rollout, Toss, frame_time

Array = NDArray[np.float64]

SHORT_STEPS = 16
"""Steps of the short rollouts into which tosses are cut; the metrics' key "sixteen_steps" names it."""
DRAWS = 2000
"""Sets of tosses that the bootstrap of a mean draws."""
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
    """Scores of open-loop rollouts of every toss, by the stated object's centre, width and corners.

    Arguments are those of `roll_out`.
    """
    measurement = measurement or MeasurementModel()
    runs = roll_out(
        predictor, model, tosses, measurement=measurement, from_flight=from_flight, dt=dt, n_threads=n_threads
    )
    if not runs:
        none = np.empty(0)
        return TossScores(none, none, none, none, none, none, np.empty((0, model.n_bodies)), none, 0, 0)
    lengths = np.array([len(toss) for toss in tosses])
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
        position_error_pct=100 * _means(distance, lengths) / model.width,
        rotation_error_deg=np.rad2deg(_means(angle, lengths)),
        penetration_mm=1e3 * _means(depths(model, q), lengths),
        recorded_penetration_mm=1e3 * _means(depths(model, at), lengths),
        gravity_ms2=gravity,
        joint_error_deg=np.rad2deg(_means(joint, lengths)),
        link_error_deg=np.rad2deg(_means(link, lengths)),
        flight_miss_pct=flight,
        unsolved=sum(run.unsolved for run in runs),
        diverged=sum(run.diverged for run in runs),
    )


def _means(values: Array, lengths: NDArray[np.int64]) -> Array:
    """(B, *b) means of values (N, *b) over stretches of so many rows (B,) each, at least one, one after the other."""
    total = np.add.reduceat(values, np.cumsum(lengths) - lengths, axis=0)
    return total / lengths.reshape(-1, *[1] * (values.ndim - 1))


def depths(model: ObjectModel, q: Array) -> Array:
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
        q, v = (np.concatenate([getattr(tosses[i], name)[: frames[i]] for i in flying.tolist()]) for name in "qv")
        found = predictor.acceleration(q, v)
        gravity[flying] = -_means(found[:, 2], frames[flying])
        errors = np.split(_flight_errors(model, q, v, found), np.cumsum(frames[flying])[:-1])
        flight[flying] = [np.median(part) for part in errors]
    return gravity, flight


def score_windows(
    predictor: Predictor,
    model: ObjectModel,
    tosses: Sequence[Toss],
    *,
    steps: int = SHORT_STEPS,
    measurement: MeasurementModel | None = None,
    dt: float | None = None,
    n_threads: int = 1,
) -> TossScores:
    """Scores of short rollouts, each from a recorded state: every toss is cut into stretches of so many `steps`.

    Other arguments are those of `roll_out`. A toss's score is the mean over its stretches; tosses shorter than one have
    NaN.
    """
    parts = stretches(tosses, steps)
    cut = [part for _, part in parts]
    dt = dt or frame_time(tosses)
    scores = score_tosses(predictor, model, cut, measurement=measurement, dt=dt, n_threads=n_threads)
    toss_of = np.array([i for i, _ in parts])

    def by_toss(values: Array) -> Array:
        out = np.full((len(tosses), *values.shape[1:]), np.nan)
        for i in np.unique(toss_of):
            own = values[toss_of == i]
            known = np.isfinite(own).reshape(len(own), -1).all(axis=1)
            if known.any():
                out[i] = own[known].mean(axis=0)
        return out

    changes: dict[str, Any] = {name: by_toss(value) for name, value in _arrays(scores).items()}
    return replace(scores, **changes)


def joined(parts: Sequence[TossScores]) -> TossScores:
    """Scores of several batches of tosses, at least one, as one."""
    return TossScores(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in _arrays(parts[0])},
        unsolved=sum(part.unsolved for part in parts),
        diverged=sum(part.diverged for part in parts),
    )


def _arrays(scores: TossScores) -> dict[str, Array]:
    """The scores that have a value a toss."""
    return {name: value for name, value in vars(scores).items() if isinstance(value, np.ndarray)}


def wrapped(angle: Array) -> Array:
    """Angles [rad] within half a turn: a hinge that is off by whole turns is where it should be."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _flight_errors(model: ObjectModel, q: Array, v: Array, found: Array) -> Array:
    """(N,) |found - stated| / |stated| [%] of states' accelerations (N, nv), in the norm of M."""
    stated = Simulator(make_system(model))
    true = stated.acceleration(q, v)
    return 100 * mass_norms(stated.system, q, found - true) / mass_norms(stated.system, q, true)


def summarize(values: Array) -> dict[str, Any]:
    """Mean over tosses with its 95 % interval, by a BCa bootstrap over tosses (Efron 1987; SciPy's).

    Args:
        values: (B,), one a toss; missing ones (NaN) are left out.

    Returns:
        {"mean", "ci95": [low, high], "n"}.
    """
    values = values[np.isfinite(values)]
    mean = float(values.mean()) if len(values) else float("nan")
    if len(values) < 2 or np.ptp(values) < 1e-12:
        return {"mean": mean, "ci95": [mean, mean], "n": len(values)}
    batch = max(1, AT_ONCE // len(values))
    found = bootstrap((values,), np.mean, n_resamples=DRAWS, batch=batch, rng=np.random.default_rng(0))
    low, high = found.confidence_interval
    return {"mean": mean, "ci95": [float(low), float(high)], "n": len(values)}


def summarize_scores(scores: TossScores, model: ObjectModel) -> dict[str, Any]:
    """The four metrics, the recorded poses' own penetration and the error in flight, each with mean and interval.

    Joints and links are added where the object has any.
    """
    keys = ["position_error_pct", "rotation_error_deg", "penetration_mm", "recorded_penetration_mm", "gravity_ms2"]
    keys += ["flight_miss_pct", *(["joint_error_deg"] if model.n_joints else [])]
    found = {key: summarize(getattr(scores, key)) for key in keys}
    for b in range(1, model.n_bodies):
        found[f"rotation_error_deg_{model.body_names[b]}"] = summarize(scores.link_error_deg[:, b])
    return found
