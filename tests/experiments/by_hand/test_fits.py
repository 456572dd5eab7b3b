"""A line bears outliers, and intervals are over recordings, not over what each of them shows."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.by_hand.fits import robust_line, with_interval


def test_outliers_do_not_move_a_line() -> None:
    rng, t = np.random.default_rng(0), np.linspace(0, 1, 100)
    y = 2.0 + 3.0 * t + rng.normal(0, 1e-3, 100)
    y[::10] += 1.0
    columns = np.column_stack([np.ones(100), t])
    assert robust_line(columns, y) == pytest.approx([2.0, 3.0], abs=2e-3)
    assert np.linalg.lstsq(columns, y, rcond=None)[0][0] > 2.05


def test_an_interval_is_over_recordings() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(5.0, 1.0, 25)
    once, often = ([[x] * times for x in values] for times in (1, 40))
    mean = lambda some: {"mean": float(np.mean(some))}  # noqa: E731
    found, repeated = with_interval(once, mean)["mean"], with_interval(often, mean)["mean"]
    assert found == pytest.approx(repeated)
    assert found[2] - found[1] == pytest.approx(4 * values.std() / 5, rel=0.15)
