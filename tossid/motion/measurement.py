"""How recorded motion relates to true motion: the unit of length, and the time that recorded velocities belong to.

Both show in the tosses themselves, and neither needs gravity, friction or inertia to be known:

- Recorded lengths may be short or long by a constant (a tag's printed size, a calibration). An object at rest on a
  face shows it: its stated geometry must touch the ground, z = 0.
- Recorded velocities are often differences of neighbouring poses, so those of half a frame ago. In flight that
  is a constant difference, acceleration times lag, from the slope of the poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from tossid.motion.flight import flight_frames
from tossid.objects import ObjectModel, corner_positions
from tossid.types import Toss

Array = NDArray[np.float64]

FEWEST_TOSSES = 8
"""Tosses that must show a quantity before it is believed."""
CONFIDENCE = 0.999
"""Of the interval that must leave out "exact" before a correction is made."""
SMALLEST_SCALE = 2e-3
"""Corrections of length smaller than this are not made."""
SMALLEST_LAG = 0.1
"""Nor of time smaller than this share of a frame."""
REST_SPEED, REST_SPIN = 0.05, 0.3
"""[m/s], [rad/s] below which a toss's last frame is at rest."""
FLAT = 0.05
"""Share of the width within which a corner counts as one of the lowest."""


@dataclass(frozen=True)
class Measurement:
    """The map from true to recorded motion.

    length_scale: recorded length per true length. velocity_lag [s]: a frame's recorded velocity is that of so
    much earlier.
    """

    length_scale: float = 1.0
    velocity_lag: float = 0.0

    def true_toss(self, toss: Toss) -> Toss:
        """The toss with true lengths. Its velocities keep their lag: what came before an impact is not known after."""
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
        """True configurations (*b, nq) as they would be recorded."""
        out = q.copy()
        out[..., :3] *= self.length_scale
        return out


@dataclass(frozen=True)
class Calibration:
    """What tosses show of their measurement: each value with its interval over tosses, and from how many tosses.

    ci95 are Student's over tosses; nan where too few tosses show the quantity.
    """

    length_scale: float
    length_scale_ci95: tuple[float, float]
    n_at_rest: int
    velocity_lag: float
    velocity_lag_ci95: tuple[float, float]
    n_in_flight: int
    measurement: Measurement
    """What of it is believed: see `calibrate`."""


def calibrate(tosses: Sequence[Toss], model: ObjectModel) -> Calibration:
    """Estimate a dataset's measurement from its tosses.

    A value is believed (and corrected for) where at least `FEWEST_TOSSES` tosses show it, its 99.9 % interval leaves
    out "exact", and it matters (`SMALLEST_SCALE`, `SMALLEST_LAG`). Objects with joints: no length scale (their
    stated geometry is seldom that exact at every angle).

    Args:
        model: the object as it is stated; its geometry is the reference for length.
    """
    scales = np.array([s for s in (_scale_at_rest(toss, model) for toss in tosses) if s is not None])
    lags = np.array([lag for lag in (_lag_in_flight(toss, model) for toss in tosses) if lag is not None])
    dt = float(np.median(np.concatenate([np.diff(toss.t) for toss in tosses])))
    scale, scale_ci, scale_sure = _mean(scales, exact=1.0)
    lag, lag_ci, lag_sure = _mean(lags, exact=0.0)
    believed = Measurement(
        length_scale=scale if scale_sure and abs(scale - 1) > SMALLEST_SCALE else 1.0,
        velocity_lag=lag if lag_sure and abs(lag) > SMALLEST_LAG * dt else 0.0,
    )
    return Calibration(scale, scale_ci, len(scales), lag, lag_ci, len(lags), believed)


def _mean(values: Array, *, exact: float) -> tuple[float, tuple[float, float], bool]:
    """Mean, its 95 % interval, and whether the 99.9 % interval leaves out `exact`."""
    n = len(values)
    if n < FEWEST_TOSSES:
        return exact, (float("nan"), float("nan")), False
    mean, error = float(values.mean()), float(values.std(ddof=1) / np.sqrt(n))
    wide, narrow = (student.ppf(0.5 + 0.5 * level, n - 1) * error for level in (CONFIDENCE, 0.95))
    return mean, (mean - narrow, mean + narrow), bool(abs(mean - exact) > wide)


def _scale_at_rest(toss: Toss, model: ObjectModel) -> float | None:
    """Recorded height over the height that the stated geometry needs to stand on its lowest face."""
    if model.n_joints or np.linalg.norm(toss.v[-1, :3]) > REST_SPEED or np.linalg.norm(toss.v[-1, 3:]) > REST_SPIN:
        return None
    above = np.sort(corner_positions(model, toss.q[-1:])[0, :, 2] - toss.q[-1, 2])
    lowest = above[above < above[0] + FLAT * model.width]
    if len(lowest) < 3 or not -lowest.mean() > 0:
        return None
    return float(-toss.q[-1, 2] / lowest.mean())


def _lag_in_flight(toss: Toss, model: ObjectModel) -> float | None:
    """Lag of the recorded vertical velocity behind the slope of the recorded height."""
    n = flight_frames(toss, model)
    if n < 4:
        return None
    t, z, vz = toss.t[:n], toss.q[:n, 2], toss.v[:n, 2]
    fall = np.polyfit(t - t.mean(), z, 2)
    slope = np.polyval(np.polyder(fall), t - t.mean())
    acceleration = 2 * fall[0]
    return float(-(vz - slope).mean() / acceleration) if acceleration < 0 else None
