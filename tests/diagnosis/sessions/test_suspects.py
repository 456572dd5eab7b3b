"""Effects that may be what changes: those whose values do, their likes, and what each gains from stretch to stretch."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS, hypothesis
from tests.diagnosis.sessions.test_looking import tilted_from
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.sessions.suspects import (
    fits_from_starts,
    gain_of_change,
    stepped,
    suspects_among,
    unfelt_in_part,
)
from tossid.diagnosis.sessions.values import toss_values
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effect_named

SHARES = (1.0, 0.3)


def test_what_does_the_same_as_a_changing_effect_is_a_suspect_too() -> None:
    library = [effect_named(name) for name in ("gravity", "time_base", "friction")]
    assert [each.name for each in suspects_among(library, {"gravity"})] == ["gravity", "time_base"]
    assert [each.name for each in suspects_among(library, {"friction", "residual"})] == ["friction"]
    assert suspects_among(library, {"residual"}) == []


def test_a_special_case_of_a_changing_effect_is_a_suspect_too() -> None:
    library = [effect_named(name) for name in ("velocity_friction", "friction", "gravity")]
    assert [each.name for each in suspects_among(library, {"velocity_friction"})] == ["velocity_friction", "friction"]
    assert [each.name for each in suspects_among(library, {"friction"})] == ["friction"]


def test_the_effect_that_changes_gains_where_it_changes(cube: ObjectModel) -> None:
    tosses = tilted_from(cube, 9, 20)
    problem = Problem(tosses, World(cube))
    validator = problem.validator(over_order=True)
    present = validator.evaluate(hypothesis(cube))
    gains = {}
    for name in ("world_tilt", "friction"):
        effect = EFFECTS[name]
        witness = (*toss_values(present, effect, validator.n), np.zeros((20, 2)))
        for edges in ((0, 9, 20), (0, 4, 20)):
            gains[name, edges[1]] = gain_of_change(present, effect, witness, edges, shares=SHARES, outlier=3.0)
        if name == "world_tilt":
            tilted = stepped(present.hypothesis, effect, witness, 9, 20)
    np.testing.assert_allclose(tilted.values_of("world_tilt"), [0.012, -0.006], rtol=0.25)
    assert gains["world_tilt", 9] > 2 * gains["world_tilt", 4] > 0
    assert gains["world_tilt", 9] > 10 * max(gains["friction", 9], 1.0)


def test_an_effect_that_is_the_same_in_all_tosses_gains_nothing_by_a_change(cube: ObjectModel) -> None:
    tosses = tilted_from(cube, 9, 20)[9:]
    validator = Problem(tosses, World(cube)).validator(over_order=True)
    present, effect = validator.evaluate(hypothesis(cube)), EFFECTS["world_tilt"]
    witness = (*toss_values(present, effect, validator.n), np.zeros((11, 2)))
    parts = gain_of_change(present, effect, witness, (0, 5, 11), shares=SHARES, outlier=3.0)
    whole = present.evidence.weighted_gain(
        present.evidence.log_likelihood_of(
            stepped(present.hypothesis, effect, witness, 0, 11).world(), present.fitted.scales
        ),
        present.log_likelihood,
    )
    assert whole > 100
    assert parts == pytest.approx(0.0, abs=0.1 * whole)


def test_a_ground_that_rises_out_of_reach_is_found_from_a_start(cube: ObjectModel) -> None:
    """Objects that rest 28 mm above the stated ground do not feel it."""
    level = seen(World(cube), cube, 11, seed=3, frames=110)
    raised = seen(with_effect(cube, "ground_height", [0.028]), cube, 10, seed=4, frames=150)
    library = [EFFECTS[name] for name in ("ground_height", "friction")]
    validator = Problem((*level, *raised), World(cube)).validator(over_order=True)
    present = validator.evaluate(hypothesis(cube))
    ((effect, fits),) = fits_from_starts(present, library, (0, 11, 21), validator, count=1)
    assert effect.name == "ground_height"
    np.testing.assert_allclose([one.hypothesis.values[-1][0] for one in fits], [0.0, 0.028], atol=2e-4)


def test_what_tosses_of_one_session_cannot_say_is_known() -> None:
    values, said = np.zeros((12, 1)), np.ones((12, 1, 1))
    assert unfelt_in_part(None, (0, 12))
    assert not unfelt_in_part((values, said, values), (0, 6, 12))
    said[7:] = 1e-4
    assert unfelt_in_part((values, said, values), (0, 6, 12))
    assert not unfelt_in_part((values, said, values), (0, 12))
