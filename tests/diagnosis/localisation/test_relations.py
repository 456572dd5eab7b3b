"""A component depends on a state only if it does so more than the best of many pairs would by chance."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.diagnosis.localisation.relations import COMPONENTS, STATES, relate


def test_the_best_of_many_pairs_is_no_finding() -> None:
    claims = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        toss = np.repeat(np.arange(15), 3)
        common = rng.normal(size=(15, len(COMPONENTS)))[toss]
        value = common + rng.normal(size=(45, len(COMPONENTS)))
        states = rng.normal(size=(15, len(STATES)))[toss] + 0.3 * rng.normal(size=(45, len(STATES)))
        relation = relate("flight", value, np.ones_like(value), states, toss, rng)
        assert relation is not None
        claims += relation.clear
    assert claims <= 1


def test_few_windows_say_nothing() -> None:
    one = np.ones((4, len(COMPONENTS)))
    assert relate("flight", one, one, np.ones((4, len(STATES))), np.arange(4), np.random.default_rng(0)) is None


@pytest.mark.parametrize("slope", [-0.3, 0.2])
def test_a_linear_dependence_comes_back(slope: float) -> None:
    rng = np.random.default_rng(0)
    toss = np.arange(60) % 20
    states = rng.normal(size=(60, len(STATES)))
    value = 0.05 * rng.normal(size=(60, len(COMPONENTS)))
    k, s = COMPONENTS.index("force_along"), STATES.index("speed")
    value[:, k] += slope * states[:, s]
    relation = relate("flight", value, np.full_like(value, 0.05**2), states, toss, rng)
    assert relation is not None
    assert (relation.component, relation.state) == ("force_along", "speed")
    assert relation.state_clear
    x, fitted, low, high = relation.curve.T
    np.testing.assert_allclose(fitted, slope * x, atol=0.05)
    assert (low <= fitted).all()
    assert (fitted <= high).all()
