"""Sizes become parameters within their ranges."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.physics.effects import BUILT_IN, Effect, Strength
from tossid.physics.effects.strength import between, directed, plain, scaled, signed

DRAWS = np.linspace(-0.9, 0.7, 8)


IN_AUDITS = [effect for effect in BUILT_IN if effect.name != "rotation_delay"]


def test_one_effect_is_in_no_audit() -> None:
    """It moves no position, and an audit measures strengths by how far positions move."""
    assert [effect.name for effect in BUILT_IN if not isinstance(effect.strength, Strength)] == ["rotation_delay"]


@pytest.mark.parametrize("effect", IN_AUDITS, ids=lambda effect: effect.name)
def test_an_effect_s_strengths_are_within_the_ranges_of_its_parameters(effect: Effect) -> None:
    assert isinstance(effect.strength, Strength)
    known = {p.name: p for p in effect.parameters}
    rng = np.random.default_rng(0)
    for size in (effect.strength.low, effect.strength.high):
        for _ in range(5):
            for key, value in effect.strength.values(size, rng.uniform(-1, 1, 8)).items():
                assert known[key].low <= value <= known[key].high, (key, value)


def test_a_direction_has_the_length_of_its_size() -> None:
    values = directed("x_m", "y_m", "z_m")(0.02, DRAWS)
    assert np.linalg.norm(list(values.values())) == pytest.approx(0.02)


def test_other_sizes() -> None:
    assert plain("c")(0.3, DRAWS) == {"c": 0.3}
    assert signed("c", 9.81)(0.3, DRAWS) == {"c": pytest.approx(9.51)}
    assert signed("c", 9.81)(0.3, -DRAWS) == {"c": pytest.approx(10.11)}
    assert scaled("c")(0.0, DRAWS) == {"c": 1.0}
    assert scaled("c")(np.log(2), DRAWS) == {"c": pytest.approx(0.5)}
    assert between(1, 4, -1.0) == 1
    assert between(1, 4, 0.0) == pytest.approx(2)
