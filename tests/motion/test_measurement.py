"""A recording's unit of length and lag of velocity: found where they are, and left alone where they are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.models.made import DT, tosses
from tossid.motion import MeasurementModel, estimate_measurement
from tossid.objects import ObjectModel
from tossid.types import Toss


def recorded(model: ObjectModel, *, scale: float, lag: float, count: int = 40) -> list[Toss]:
    """Tosses as a tracker with that scale and lag would record them, with 0.2 mm and 5 mm/s of noise."""
    rng = np.random.default_rng(5)
    out = []
    for toss in tosses(model, count, seed=2, frames=150):
        q, v = toss.q.copy(), toss.v.copy()
        v[1:, :3] -= lag * np.diff(toss.v[:, :3], axis=0) / DT
        v[0, 2] += lag * 9.81
        q[:, :3] = scale * q[:, :3] + 2e-4 * rng.normal(size=(len(q), 3))
        v[:, :3] = scale * v[:, :3] + 5e-3 * rng.normal(size=(len(v), 3))
        out.append(replace(toss, q=q, v=v))
    return out


@pytest.mark.parametrize("scale", [0.978, 1.03])
def test_scale_and_lag_are_found(cube: ObjectModel, scale: float) -> None:
    estimate = estimate_measurement(recorded(cube, scale=scale, lag=0.5 * DT), cube)
    assert estimate.n_at_rest > 20
    assert estimate.n_in_flight > 30
    assert estimate.length_scale == pytest.approx(scale, abs=1.5e-3)
    assert estimate.velocity_lag == pytest.approx(0.5 * DT, rel=0.1)
    assert estimate.measurement == MeasurementModel(estimate.length_scale, estimate.velocity_lag)
    assert estimate.length_scale_ci95[0] < estimate.length_scale < estimate.length_scale_ci95[1]


def test_exact_recordings_are_left_alone(cube: ObjectModel) -> None:
    assert estimate_measurement(recorded(cube, scale=1.0, lag=0.0), cube).measurement == MeasurementModel()


def test_few_tosses_do_not_change_scale_or_lag(cube: ObjectModel) -> None:
    estimate = estimate_measurement(recorded(cube, scale=0.9, lag=0.0, count=5), cube)
    assert estimate.measurement == MeasurementModel()
    assert np.isnan(estimate.length_scale_ci95).all()


def test_true_lengths_are_recorded_lengths_over_the_scale(cube: ObjectModel) -> None:
    toss = tosses(cube, 1, seed=0)[0]
    measurement = MeasurementModel(length_scale=0.8)
    true = measurement.true_toss(toss)
    np.testing.assert_allclose(measurement.recorded_q(true.q), toss.q, atol=1e-12)
    np.testing.assert_allclose(0.8 * true.v[:, :3], toss.v[:, :3], atol=1e-12)
    np.testing.assert_array_equal(true.v[:, 3:], toss.v[:, 3:])
