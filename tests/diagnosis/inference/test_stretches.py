"""Effects that step at different tosses are fitted together, with intervals that hold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.stats import t

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.inference.designs import line_over, steps_at
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.inference.stretches import Change, fitted_together
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import Toss

N = 18
TILT = [0.03, -0.02]


def tosses_of(cube: ObjectModel, worlds: Sequence[World], frames: int = 60) -> list[Toss]:
    return [seen(world, cube, 1, seed=100 + k, frames=frames)[0] for k, world in enumerate(worlds)]


def stepping(name: str, at: int, values: list[list[float]]) -> Change:
    B = np.array(values)
    return Change(EFFECTS[name], (0, at, N), 0.001, 50.0, steps_at((0, at, N)), B, np.zeros((B.size, B.size)))


def test_steps_at_different_tosses_are_fitted_together(cube: ObjectModel, stated: Hypothesis) -> None:
    slippery = with_effect(cube, "friction", [0.26])
    both = EFFECTS["world_tilt"].at(slippery, np.array(TILT))
    tosses = tosses_of(cube, [World(cube)] * 6 + [slippery] * 6 + [both] * 6)
    sample = Sample(make_windows(tosses, cube), N)
    begun = [stepping("friction", 6, [[0.2], [0.24]]), stepping("world_tilt", 12, [[0.002, 0.0], [0.025, -0.016]])]
    friction, tilt = fitted_together(sample.evidence(stated), begun)
    assert [(s.first, s.stop) for s in friction.stretches] == [(0, 6), (6, N)]
    truth = [(friction, "mu", [0.18, 0.26]), (tilt, "x_rad", [0.0, TILT[0]]), (tilt, "y_rad", [0.0, TILT[1]])]
    for change, key, values in truth:
        for stretch, true in zip(change.stretches, values, strict=True):
            found = stretch.values[key]
            half = found.high - found.value
            # no interval of few tosses is sure to hold: five of its standard errors are
            assert abs(found.value - true) < 2 * half + 1e-4
            assert 0 < half < (0.02 if key == "mu" else 2e-3)
    np.testing.assert_allclose(tilt.values[:12], np.tile([0.0, 0.0], (12, 1)), atol=5e-4)
    np.testing.assert_allclose(tilt.values[12:], np.tile(TILT, (6, 1)), atol=5e-4)
    assert friction.values[5, 0] == pytest.approx(friction.stretches[0].values["mu"].value)


def test_means_over_the_order_and_what_all_tosses_have_beside() -> None:
    """Variances of linear combinations of coefficients, by Student's t of the tosses that determine them."""
    n, cov = 40, np.diag([0.01, 0.04]) ** 2
    steps = Change(EFFECTS["friction"], (0, 10, n), 0.001, 9.0, steps_at((0, 10, n)), np.array([[0.2], [0.3]]), cov)
    mean = steps.mean()["mu"]
    assert mean.value == pytest.approx(0.275)
    assert mean.high - mean.value == pytest.approx(t.ppf(0.975, 38) * np.hypot(0.25 * 0.01, 0.75 * 0.04))
    first, last = (stretch.values["mu"] for stretch in steps.stretches)
    assert first.high - first.value == pytest.approx(t.ppf(0.975, 9) * 0.01)
    assert last.high - last.value == pytest.approx(t.ppf(0.975, 29) * 0.04)
    assert steps.shifted(np.array([0.05])).values[[0, -1], 0].tolist() == pytest.approx([0.25, 0.35])
    n, cov = 21, np.diag([0.01, 0.002]) ** 2
    drift = Change(EFFECTS["friction"], None, 0.001, 9.0, line_over(n), np.array([[0.3], [0.01]]), cov)
    half = {key: x["mu"].high - x["mu"].value for key, x in (("mean", drift.mean()), ("rate", drift.rate))}
    assert half == pytest.approx({"mean": t.ppf(0.975, 19) * 0.01, "rate": t.ppf(0.975, 19) * 0.002})
    end = drift.stretches[-1].values["mu"]
    assert end.value == pytest.approx(0.4)
    assert end.high - end.value == pytest.approx(t.ppf(0.975, 19) * np.hypot(0.01, 10 * 0.002))
    assert drift.shifted(np.array([0.05])).values[[0, 10, 20], 0].tolist() == pytest.approx([0.25, 0.35, 0.45])
