"""What changes over the order of recording is found with its form, its place and its size, and nothing else is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.stats import t

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.inference.designs import line_over, steps_at
from tossid.diagnosis.inference.fitting import Fit
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.order import over_order
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.inference.screening import Screening, screen
from tossid.diagnosis.inference.stretches import Change, fitted_together
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import Toss

LIBRARY = tuple(EFFECTS[name] for name in ("friction", "gravity", "inertia", "world_tilt"))


def tosses_of(cube: ObjectModel, worlds: Sequence[World], frames: int = 60) -> list[Toss]:
    return [seen(world, cube, 1, seed=100 + k, frames=frames)[0] for k, world in enumerate(worlds)]


def beside_nothing(cube: ObjectModel, tosses: list[Toss], stated: Hypothesis) -> tuple[Fit, Screening]:
    sample = Sample(make_windows(tosses, cube), len(tosses))
    first = sample.evidence(stated)
    screening = screen(first, LIBRARY, n=sample.n, rng=np.random.default_rng(0))
    return sample.evaluated(first), screening


def test_a_step_is_found_at_its_place_with_its_size(cube: ObjectModel, stated: Hypothesis) -> None:
    """24 tosses; before the eleventh the ground was cleaned."""
    cleaned = tosses_of(cube, [World(cube)] * 10 + [with_effect(cube, "friction", [0.26])] * 14)
    present, screening = beside_nothing(cube, cleaned, stated)
    found = over_order(present, screening)
    (change,) = fitted_together(present.evidence, found.changes)
    assert (change.effect.name, change.form) == ("friction", "steps")
    assert [stretch.first for stretch in change.stretches] == [0, 10]
    before, after = (stretch.values["mu"] for stretch in change.stretches)
    assert before.value == pytest.approx(0.18, abs=0.01)
    assert after.value == pytest.approx(0.26, abs=0.01)
    assert after.low - 0.003 < 0.26 < after.high + 0.003
    assert change.p_value <= 0.005
    assert change.values[:, 0].tolist() == pytest.approx([before.value] * 10 + [after.value] * 14)
    assert found.left is not None
    assert found.left > 0.005
    assert found.place is None


def test_an_effect_of_the_hypothesis_and_another_may_change(cube: ObjectModel, stated: Hypothesis) -> None:
    slippery = with_effect(cube, "friction", [0.26])
    tilted = EFFECTS["world_tilt"].at(slippery, np.array([0.03, -0.02]))
    tosses = tosses_of(cube, [World(cube)] * 12 + [tilted] * 12)
    sample = Sample(make_windows(tosses, cube), 24)
    same = stated.plus(EFFECTS["friction"], np.array([0.22]))
    present = sample.refitted(sample.evidence(same), same, iterations=3)
    screening = screen(present.evidence, LIBRARY, n=24, free=present.free, rng=np.random.default_rng(0))
    found = over_order(present, screening, boundaries=(12,))
    last = {change.effect.name: change.stretches[-1] for change in fitted_together(present.evidence, found.changes)}
    assert set(last) == {"friction", "world_tilt"}
    assert last["friction"].values["mu"].value == pytest.approx(0.26, abs=0.01)
    assert last["world_tilt"].values["x_rad"].value == pytest.approx(0.03, abs=5e-4)


def test_a_drift_has_its_rate(cube: ObjectModel, stated: Hypothesis) -> None:
    worlds = [with_effect(cube, "gravity", [9.81 - 0.04 * k]) for k in range(20)]
    found = over_order(*beside_nothing(cube, tosses_of(cube, worlds), stated))
    (change,) = found.changes
    assert (change.effect.name, change.form) == ("gravity", "drift")
    rate = change.rate["g_ms2"]
    assert rate.low - 0.003 < -0.04 < rate.high + 0.003
    assert rate.value == pytest.approx(-0.04, abs=0.004)
    first, last = (stretch.values["g_ms2"].value for stretch in change.stretches)
    assert (first, last) == pytest.approx((9.81, 9.05), abs=0.06)


def test_nothing_changes_where_an_effect_is_in_all_tosses(cube: ObjectModel, stated: Hypothesis) -> None:
    found = over_order(*beside_nothing(cube, tosses_of(cube, [with_effect(cube, "friction", [0.26])] * 16), stated))
    assert found.changes == ()
    assert found.left is not None
    assert found.left > 0.005


N = 18
TILT = [0.03, -0.02]


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
