"""The measurement model of recorded tosses: their unit of length, and the time that recorded velocities belong to.

Both are estimated from the tosses, without gravity, friction or inertia:

- Recorded lengths may be wrong by a factor (a tag's printed size, a calibration). An object at rest on a face shows it:
  its stated geometry must touch the ground, z = 0.
- Recorded velocities are often differences of neighbouring poses, so they belong to half a frame earlier. In flight
  they differ from the slope of the poses by acceleration times lag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from tossid.motion.flight import fit_polynomial, frames_in_flight
from tossid.motion.resting import touching
from tossid.objects import ObjectModel
from tossid.types import Toss, frame_time

Array = NDArray[np.float64]

FEWEST_TOSSES = 8
"""Tosses that must show a quantity."""
CONFIDENCE = 0.999
"""Level of the interval that must leave out no correction."""
SMALLEST_SCALE = 2e-3
"""Smaller relative corrections of length are not made."""
SMALLEST_LAG = 0.1
"""Smaller corrections of time are not made, in frames."""
SIZE_WARNING = 0.01
"""Larger relative differences from the stated size are said."""
REST_SPEED, REST_SPIN = 0.05, 0.3
"""Speed [m/s] and spin [rad/s] below which a toss's last frame is at rest."""


@dataclass(frozen=True)
class MeasurementModel:
    """The map from true to recorded motion.

    Attributes:
        length_scale: Recorded length over true length.
        velocity_lag: A frame's recorded velocity is that of so much earlier [s].
    """

    length_scale: float = 1.0
    velocity_lag: float = 0.0

    def true_toss(self, toss: Toss) -> Toss:
        """The toss with true lengths.

        Its velocities keep their lag: just after an impact, the velocity before it cannot be recovered.

        Args:
            toss: As recorded.
        """
        if self.length_scale == 1.0:
            return toss
        weight = np.where(np.arange(toss.v.shape[1]) < 3, 1 / self.length_scale, 1.0)
        weight_q = np.insert(weight, 3, 1.0)  # a quaternion has one number more than a rotation's error
        measured, measured_cov = toss.q_measured, toss.q_measured_cov
        return replace(
            toss,
            q=weight_q * toss.q,
            v=weight * toss.v,
            q_cov=weight[:, None] * toss.q_cov * weight,
            v_cov=weight[:, None] * toss.v_cov * weight,
            q_measured=None if measured is None else weight_q * measured,
            q_measured_cov=None if measured_cov is None else weight[:, None] * measured_cov * weight,
        )

    def recorded_q(self, q: Array) -> Array:
        """True configurations as they would be recorded, (*b, nq).

        Args:
            q: True configurations, (*b, nq).
        """
        out = q.copy()
        out[..., :3] *= self.length_scale
        return out


@dataclass(frozen=True)
class MeasurementEstimate:
    """Length scale and velocity lag of a set of tosses.

    Attributes:
        length_scale: Mean over tosses.
        length_scale_ci95: Student's interval over tosses; NaN where too few tosses show it.
        n_at_rest: Tosses that show it.
        velocity_lag: Mean over tosses [s].
        measurement: The model with those values that are significant; see `estimate_measurement`.
    """

    length_scale: float
    length_scale_ci95: tuple[float, float]
    n_at_rest: int
    velocity_lag: float
    measurement: MeasurementModel


def estimate_measurement(tosses: Sequence[Toss], model: ObjectModel) -> MeasurementEstimate:
    """Length scale and velocity lag of tosses, and the measurement model with those that are significant.

    A value is significant where enough tosses show it, its 99.9 % interval leaves out "exact", and it is large enough
    to matter. Objects with joints have no length scale: their stated geometry is seldom exact at every angle.

    Args:
        tosses: As recorded.
        model: The object; its stated geometry is the reference for length.
    """
    frames = frames_in_flight(tosses, model)
    scales = [scale for toss in tosses if (scale := _scale_at_rest(toss, model)) is not None]
    lags = [lag for toss, n in zip(tosses, frames, strict=True) if (lag := _lag_in_flight(toss, n)) is not None]
    scale, scale_ci, scale_sure = _mean(scales, exact=1.0)
    lag, _, lag_sure = _mean(lags, exact=0.0)
    significant = MeasurementModel(
        length_scale=scale if scale_sure and abs(scale - 1) > SMALLEST_SCALE else 1.0,
        velocity_lag=lag if lag_sure and abs(lag) > SMALLEST_LAG * frame_time(tosses) else 0.0,
    )
    return MeasurementEstimate(scale, scale_ci, len(scales), lag, significant)


def _mean(values: Sequence[float], *, exact: float) -> tuple[float, tuple[float, float], bool]:
    """Mean, its 95 % interval, and whether the 99.9 % interval leaves out `exact`."""
    n = len(values)
    if n < FEWEST_TOSSES:
        return exact, (float("nan"), float("nan")), False
    mean, error = float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(n))
    wide, narrow = (student.ppf(0.5 + 0.5 * level, n - 1) * error for level in (CONFIDENCE, 0.95))
    return mean, (mean - narrow, mean + narrow), bool(abs(mean - exact) > wide)


def _scale_at_rest(toss: Toss, model: ObjectModel) -> float | None:
    """Recorded height over the height that the stated geometry needs to stand on its lowest face."""
    speed, spin = np.linalg.norm(toss.v[-1, :3]), np.linalg.norm(toss.v[-1, 3:])
    if model.n_joints or model.roundness is not None or speed > REST_SPEED or spin > REST_SPIN:
        return None
    lowest = touching(model, toss.q[-1])[:, 2] - toss.q[-1, 2]
    if len(lowest) < 3 or not -lowest.mean() > 0:
        return None
    return float(-toss.q[-1, 2] / lowest.mean())


def _lag_in_flight(toss: Toss, n: int) -> float | None:
    """Lag of the recorded vertical velocity behind the slope of the recorded height, in the first n frames."""
    if n < 4:
        return None
    s = toss.t[:n] - toss.t[:n].mean()
    _, slope, acceleration = fit_polynomial(s, toss.q[:n, 2:3]).coefficients[:, 0]
    if acceleration >= 0:
        return None
    return float(-(toss.v[:n, 2] - slope - acceleration * s).mean() / acceleration)
