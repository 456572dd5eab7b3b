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

from tossid.motion.flight import frames_in_flight
from tossid.objects import ObjectModel, corner_positions
from tossid.settings.motion import MeasurementSettings
from tossid.types import Toss, frame_time

Array = NDArray[np.float64]

DEFAULT = MeasurementSettings()


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
        s = self.length_scale
        if s == 1.0:
            return toss
        weight_q, weight_v = (np.ones(toss.q_cov.shape[-1]) for _ in range(2))
        weight_q[:3] = weight_v[:3] = 1 / s

        def shrunk(values: Array) -> Array:
            out = values.copy()
            out[:, :3] /= s
            return out

        true = replace(
            toss,
            q=shrunk(toss.q),
            v=shrunk(toss.v),
            q_cov=weight_q[:, None] * toss.q_cov * weight_q,
            v_cov=weight_v[:, None] * toss.v_cov * weight_v,
        )
        if toss.q_measured is None or toss.q_measured_cov is None:
            return true
        cov = weight_q[:, None] * toss.q_measured_cov * weight_q
        return replace(true, q_measured=shrunk(toss.q_measured), q_measured_cov=cov)

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
    """Length scale and velocity lag of a set of tosses, each with its interval.

    Attributes:
        length_scale: Mean over tosses.
        length_scale_ci95: Student's interval over tosses; NaN where too few tosses show it.
        n_at_rest: Tosses that show it.
        velocity_lag: Mean over tosses [s].
        velocity_lag_ci95: Likewise [s].
        n_in_flight: Tosses that show it.
        measurement: The model with those values that are significant; see `estimate_measurement`.
    """

    length_scale: float
    length_scale_ci95: tuple[float, float]
    n_at_rest: int
    velocity_lag: float
    velocity_lag_ci95: tuple[float, float]
    n_in_flight: int
    measurement: MeasurementModel


def estimate_measurement(
    tosses: Sequence[Toss], model: ObjectModel, *, settings: MeasurementSettings = DEFAULT
) -> MeasurementEstimate:
    """Length scale and velocity lag of tosses, and the measurement model with those that are significant.

    A value is significant where enough tosses show it, its 99.9 % interval leaves out "exact", and it is large enough
    to matter. Objects with joints have no length scale: their stated geometry is seldom exact at every angle.

    Args:
        tosses: As recorded.
        model: The object; its stated geometry is the reference for length.
        settings: What is significant.
    """
    scales = np.array([s for s in (_scale_at_rest(toss, model, settings) for toss in tosses) if s is not None])
    in_flight = zip(tosses, frames_in_flight(tosses, model), strict=True)
    lags = np.array([lag for lag in (_lag_in_flight(toss, n) for toss, n in in_flight) if lag is not None])
    dt = frame_time(tosses)
    scale, scale_ci, scale_sure = _mean(scales, settings, exact=1.0)
    lag, lag_ci, lag_sure = _mean(lags, settings, exact=0.0)
    significant = MeasurementModel(
        length_scale=scale if scale_sure and abs(scale - 1) > settings.smallest_scale else 1.0,
        velocity_lag=lag if lag_sure and abs(lag) > settings.smallest_lag * dt else 0.0,
    )
    return MeasurementEstimate(scale, scale_ci, len(scales), lag, lag_ci, len(lags), significant)


def _mean(values: Array, settings: MeasurementSettings, *, exact: float) -> tuple[float, tuple[float, float], bool]:
    """Mean, its 95 % interval, and whether the 99.9 % interval leaves out `exact`."""
    n = len(values)
    if n < settings.fewest_tosses:
        return exact, (float("nan"), float("nan")), False
    mean, error = float(values.mean()), float(values.std(ddof=1) / np.sqrt(n))
    wide, narrow = (student.ppf(0.5 + 0.5 * level, n - 1) * error for level in (settings.confidence, 0.95))
    return mean, (mean - narrow, mean + narrow), bool(abs(mean - exact) > wide)


def _scale_at_rest(toss: Toss, model: ObjectModel, settings: MeasurementSettings) -> float | None:
    """Recorded height over the height that the stated geometry needs to stand on its lowest face."""
    speed, spin = np.linalg.norm(toss.v[-1, :3]), np.linalg.norm(toss.v[-1, 3:])
    if model.n_joints or model.roundness is not None or speed > settings.rest_speed or spin > settings.rest_spin:
        return None
    above = np.sort(corner_positions(model, toss.q[-1:])[0, :, 2] - toss.q[-1, 2])
    lowest = above[above < above[0] + settings.flat * model.width]
    if len(lowest) < 3 or not -lowest.mean() > 0:
        return None
    return float(-toss.q[-1, 2] / lowest.mean())


def _lag_in_flight(toss: Toss, n: int) -> float | None:
    """Lag of the recorded vertical velocity behind the slope of the recorded height, in the first n frames."""
    if n < 4:
        return None
    t, z, vz = toss.t[:n], toss.q[:n, 2], toss.v[:n, 2]
    fall = np.polyfit(t - t.mean(), z, 2)
    slope = np.polyval(np.polyder(fall), t - t.mean())
    acceleration = 2 * fall[0]
    return float(-(vz - slope).mean() / acceleration) if acceleration < 0 else None
