"""Effects that take a step or drift are told apart, and where nothing changes nothing is found."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.sessions.changes import EffectOverOrder, changes_over_order, follows_line, values_differ
from tossid.diagnosis.sessions.moments import moments_of_steps
from tossid.diagnosis.sessions.values import RESIDUAL
from tossid.motion.sessions.change_points import Witness
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effect_named
from tossid.settings.diagnosis.order import OrderSettings

N = 40
SETTINGS = OrderSettings(permutations=1999)


def witness(true: np.ndarray, *, seed: int, sigma: float = 0.2) -> Witness:
    """What tosses say of parameters (n, d), with errors of their own, of which two are far off."""
    rng = np.random.default_rng(seed)
    n, d = true.shape
    values = true + sigma * rng.normal(size=true.shape)
    values[[3, n - 4]] += 4.0
    return values, np.tile(np.eye(d) / sigma**2, (n, 1, 1)), rng.normal(size=(n, 2))


def step(at: int, d: int = 2) -> np.ndarray:
    return np.repeat((np.arange(N) >= at).astype(float)[:, None], d, axis=1)


@pytest.mark.parametrize("at", [8, 20, 31])
def test_a_step_is_found_where_it_is_and_in_nothing_else(at: int) -> None:
    seen = {"tilt": witness(step(at), seed=at), "other": witness(0 * step(at), seed=90 + at)}
    (change,) = changes_over_order(seen, SETTINGS)
    assert abs(change.at - at) <= 3
    (moment,) = moments_of_steps(seen["tilt"], (change.at,), SETTINGS)
    assert abs(moment - at) <= 1
    assert set(change.p) == {"tilt"}


def in_parts(values: list[float], sigma: float) -> EffectOverOrder:
    """A clock that was fitted to five parts of 40 tosses."""
    stretches = tuple({"rate_rel": Interval(x, x - 2 * sigma, x + 2 * sigma)} for x in values)
    edges = tuple(range(0, N + 1, N // 5))
    return EffectOverOrder(
        effect_named("time_base"), "drift", edges, np.ones((N, 1)), 0.001, stretches[0], stretches, {}, ()
    )


@pytest.mark.parametrize(
    ("values", "at"),
    [([0, 0, 0, 1, 1], (24,)), ([0, 0, 0.2, 1, 1], (20,)), ([0, 1, 1, 1, 1], (9,)), ([0, 1, 1, 0.4, 0], (8, 27))],
)
def test_values_that_step_follow_no_line(values: list[float], at: tuple[int, ...]) -> None:
    assert not follows_line(in_parts(values, 0.02), at)


@pytest.mark.parametrize("at", [(7, 27), (20,), (16, 24)])
def test_values_that_drift_follow_a_line(at: tuple[int, ...]) -> None:
    assert follows_line(in_parts([0.01, 0.24, 0.51, 0.75, 0.99], 0.02), at)


@dataclass(frozen=True)
class AsFitted:
    """A fit of which only the values and their covariance are asked for."""

    hypothesis: Hypothesis
    cov: np.ndarray

    def covariance(self) -> np.ndarray:
        return self.cov


def test_values_differ_by_the_scatter_of_tosses(cube: ObjectModel) -> None:
    effect = effect_named("world_tilt")
    rng, cov = np.random.default_rng(0), np.array([[4.0, 1.0], [1.0, 2.0]]) * 1e-6
    root = np.linalg.cholesky(cov)

    def probability(step: list[float]) -> float:
        fits: list[Any] = [
            AsFitted(Hypothesis(World(cube)).plus(effect, root @ rng.normal(size=2) + k * np.array(step)), cov)
            for k in range(2)
        ]
        each = in_parts([0.0, 0.0], 1.0)
        return values_differ(replace(each, effect=effect, fitted=tuple(fits)))

    same = [probability([0.0, 0.0]) for _ in range(300)]
    assert np.mean(np.array(same) < 0.1) == pytest.approx(0.1, abs=0.05)
    assert max(probability([0.012, -0.006]) for _ in range(20)) < 1e-3


def test_what_depends_on_place_does_not_change() -> None:
    place = np.column_stack([step(20, 1)[:, 0], np.zeros(N)])
    values, info, _ = witness(step(20, 1), seed=1)
    assert changes_over_order({"height": (values, info, place + 1e-3)}, SETTINGS) == ()


def test_a_session_of_the_dataset_is_tested_where_it_begins() -> None:
    seen = {"tilt": witness(1.5 * step(16), seed=11, sigma=1.0)}
    seen |= {f"{k}": witness(0 * step(5), seed=200 + k) for k in range(30)}
    settings = OrderSettings()
    assert changes_over_order(seen, settings) == ()
    (change,) = changes_over_order(seen, settings, boundaries=(16,))
    assert change.at == 16
    assert "tilt" in change.p
    # too near to an end, or to a change that was found
    assert changes_over_order(seen, settings, boundaries=(3, 38)) == ()
    clear = {"tilt": witness(step(16), seed=11)}
    assert len(changes_over_order(clear, SETTINGS, boundaries=(17,))) == 1


def test_effects_are_tested_where_the_size_of_the_gap_changes() -> None:
    """What is too little to be found among many at all places is found where the gap says that something changes."""
    seen = {"tilt": witness(1.5 * step(16), seed=11, sigma=1.0)}
    seen |= {f"{k}": witness(0 * step(5), seed=200 + k) for k in range(30)}
    (change,) = changes_over_order({**seen, RESIDUAL: witness(step(16, 1), seed=3)}, OrderSettings())
    assert change.at == 16
    assert set(change.p) == {"tilt", RESIDUAL}


def test_nothing_is_found_in_nothing() -> None:
    found = [
        changes_over_order({f"{k}": witness(0 * step(5), seed=100 * seed + k) for k in range(8)}, SETTINGS)
        for seed in range(6)
    ]
    assert found == [()] * 6


def test_what_a_toss_does_not_say_does_not_count() -> None:
    values, info, place = witness(step(20), seed=6)
    blind = np.arange(0, N, 3)
    info[blind], values[blind] = 0.0, 1e6
    (change,) = changes_over_order({"tilt": (values, info, place), RESIDUAL: witness(0 * step(5), seed=7)}, SETTINGS)
    assert abs(change.at - 20) <= 2
