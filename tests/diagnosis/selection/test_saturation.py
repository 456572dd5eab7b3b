"""Where more of an effect changes nothing, its interval is open to that side, and Wald's test does not drop it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.plausibility import plausible_names
from tossid.diagnosis.selection.refinement import pruned_by_wald_test, stated_intervals
from tossid.diagnosis.selection.saturation import with_saturated_effects
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def _fitted(cube: ObjectModel, truth: World, name: str, start: float) -> tuple[CrossValidator, SearchResult]:
    """What a search has that ends with one effect, whose fit begins at a value."""
    tosses = seen(truth, cube, 8, seed=3, frames=70)
    validator = CrossValidator.of(tosses, cube, seed=0)
    first = validator.evaluate(Hypothesis(World(cube)))
    effect = EFFECTS[name]
    begin = validator.evaluate(first.hypothesis.plus(effect, np.array([start])))
    last = validator.cross_validate(first, effect, begin.hypothesis, near=begin.evidence)
    return validator, SearchResult(first, last, (first, last), {}, {}, {name: last}, {name: ()})


@pytest.mark.parametrize(
    ("name", "field", "true", "start"),
    [("torsional_friction", "torsional", 0.06, 0.04), ("cohesion", "cohesion", 1.2, 1.0)],
)
def test_what_does_no_more_is_bounded_on_one_side(
    cube: ObjectModel, name: str, field: str, true: float, start: float
) -> None:
    world = World(cube)
    if field == "torsional":
        truth = replace(world, law=world.law._replace(torsional=true))
    else:
        truth = World(cube.with_changes(cohesion=true))
    validator, found = _fitted(cube, truth, name, start)
    found = with_saturated_effects(validator, found)
    parameter = EFFECTS[name].parameters[0]
    (stated,) = stated_intervals(found, validator.n, None)[name].values()
    assert stated.low <= true <= stated.high == parameter.high
    assert stated.low > 0.02 * parameter.high
    # a fit on the plateau has no curvature, by which it would look like no change
    spread = np.array([2.0 * stated.value])
    kept, _ = pruned_by_wald_test(validator, found, spread)
    assert kept.present.hypothesis.names == (name,)
    assert plausible_names(validator, found, None)[1] == {}
    dropped, _ = pruned_by_wald_test(validator, replace(found, saturated={}), spread)
    assert dropped.present.hypothesis.names == ()


def test_a_size_that_tosses_determine_is_not_saturated(cube: ObjectModel) -> None:
    validator, found = _fitted(cube, World(cube.with_changes(friction=0.3)), "friction", 0.28)
    assert with_saturated_effects(validator, found).saturated == {}
