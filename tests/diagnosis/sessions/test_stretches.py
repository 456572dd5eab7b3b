"""Values of stretches of tosses, with their errors, and whether they differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.sessions.stretches import values_differ, with_steps
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effect_named

COV = np.array([[4.0, 1.0], [1.0, 2.0]]) * 1e-6


@dataclass(frozen=True)
class AsFitted:
    """A fit of which only the values and their covariance are asked for."""

    hypothesis: Hypothesis

    def covariance(self) -> np.ndarray:
        return COV


def test_values_differ_by_the_scatter_of_tosses() -> None:
    rng, root = np.random.default_rng(0), np.linalg.cholesky(COV)

    def probability(step: list[float]) -> float:
        return values_differ([root @ rng.normal(size=2) + k * np.array(step) for k in range(2)], [COV] * 2)

    same = [probability([0.0, 0.0]) for _ in range(300)]
    assert np.mean(np.array(same) < 0.1) == pytest.approx(0.1, abs=0.05)
    assert max(probability([0.012, -0.006]) for _ in range(20)) < 1e-3


def test_steps_have_the_values_of_their_stretches(cube: ObjectModel) -> None:
    effect = effect_named("world_tilt")
    fits: Any = tuple(
        AsFitted(Hypothesis(World(cube)).plus(effect, np.array(y))) for y in ([0.0, 0.001], [0.01, 0.001])
    )
    found = with_steps(effect, (0, 10, 40), fits, 0.001)
    assert found.numbers == 2
    assert found.parameters["x_rad"].value == pytest.approx(0.0075)
    np.testing.assert_array_equal(found.values[[0, 9, 10, 39], 0], [0.0, 0.0, 0.01, 0.01])
    # Student's t with 28 degrees of freedom
    assert found.stretches[1]["x_rad"].high - 0.01 == pytest.approx(2.0484 * 2e-3, rel=1e-4)
    assert found.differ < 0.01
