"""Open-loop rollouts against measured tosses: the metrics of CONTRACT.md, with intervals over tosses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

from tossid.models.predictor import Predictor
from tossid.models.shots import first_states
from tossid.motion import Measurement, flight_frames, flight_states
from tossid.objects import ObjectModel, center_positions, corner_positions
from tossid.physics import Simulation
from tossid.rotations import geodesic_angle
from tossid.types import Toss

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TossScores:
    """Scores of rollouts, one a toss (B,); see `score_tosses`. unsolved: contact problems that missed the tolerance."""

    position_error_pct: Array
    rotation_error_deg: Array
    penetration_mm: Array
    gravity_ms2: Array
    unsolved: int
    diverged: int


def roll_out(
    predictor: Predictor,
    model: ObjectModel,
    tosses: Sequence[Toss],
    *,
    measurement: Measurement | None = None,
    from_flight: bool = False,
    n_threads: int = 1,
) -> Simulation:
    """Every toss from its first state to its last frame, open loop, as it would be recorded (q; v is the simulator's).

    Args:
        predictor: what is judged, in true lengths. model: the nominal object.
        measurement: how the tosses were recorded.
        from_flight: start from the state estimated from the toss's first free flight.
    """
    measurement = measurement or Measurement()
    true = [measurement.true_toss(toss) for toss in tosses]
    q0, v0 = first_states(true, predictor, velocity_lag=measurement.velocity_lag)
    if from_flight:
        states = flight_states(true, model)
        q0, v0 = np.stack([s.q for s in states]), np.stack([s.v for s in states])
    steps = np.array([len(toss) - 1 for toss in tosses])
    dt = float(np.median(np.concatenate([np.diff(toss.t) for toss in tosses])))
    run = predictor.rollout(q0, v0, n_steps=steps, dt=dt, n_threads=n_threads)
    return run._replace(q=measurement.recorded_q(run.q))


def score_tosses(
    predictor: Predictor,
    model: ObjectModel,
    tosses: Sequence[Toss],
    *,
    measurement: Measurement | None = None,
    from_flight: bool = False,
    n_threads: int = 1,
) -> TossScores:
    """Roll every toss out (`roll_out`), and compare with what was recorded."""
    measurement = measurement or Measurement()
    run = roll_out(predictor, model, tosses, measurement=measurement, from_flight=from_flight, n_threads=n_threads)
    position, rotation, penetration, gravity = (np.empty(len(tosses)) for _ in range(4))
    for i, toss in enumerate(tosses):
        q = run.q[i, : len(toss)]
        distance = np.linalg.norm(center_positions(model, q) - center_positions(model, toss.q), axis=1)
        position[i] = 100 * distance.mean() / model.width
        rotation[i] = np.rad2deg(geodesic_angle(q[:, 3:7], toss.q[:, 3:7])).mean()
        penetration[i] = 1e3 * np.maximum(-corner_positions(model, q)[..., 2].min(axis=1), 0).mean()
        n = flight_frames(toss, model)
        true = measurement.true_toss(toss)
        gravity[i] = -predictor.acceleration(true.q[:n], true.v[:n])[:, 2].mean() if n else np.nan
    return TossScores(position, rotation, penetration, gravity, int(run.unsolved.sum()), int((~run.finite).sum()))


def summarize(values: Array, *, seed: int = 0) -> dict[str, Any]:
    """Mean over tosses with its 95 % interval (BCa bootstrap over tosses, SciPy). Missing values are left out."""
    values = values[np.isfinite(values)]
    mean = float(values.mean()) if len(values) else float("nan")
    if len(values) < 2 or np.ptp(values) < 1e-12:
        return {"mean": mean, "ci95": [mean, mean], "n": len(values)}
    interval = bootstrap((values,), np.mean, n_resamples=2000, rng=np.random.default_rng(seed)).confidence_interval
    return {"mean": mean, "ci95": [float(interval.low), float(interval.high)], "n": len(values)}


def summarize_scores(scores: TossScores) -> dict[str, Any]:
    """CONTRACT.md's four metrics, each with mean and interval."""
    keys = ("position_error_pct", "rotation_error_deg", "penetration_mm", "gravity_ms2")
    return {key: summarize(getattr(scores, key)) for key in keys}
