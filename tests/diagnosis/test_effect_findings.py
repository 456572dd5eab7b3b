"""What size of an effect tosses would reveal, and what each effect closed when it joined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.effect_findings import closed_by_each, detectable_sizes, effect_findings
from tossid.diagnosis.findings import Consequence
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.gap import share_left
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.search_result import OtherCauses, SearchResult, joined_one_by_one
from tossid.objects import ObjectModel
from tossid.physics.effects import World


@pytest.fixture(scope="module")
def validator(cube: ObjectModel) -> CrossValidator:
    truth = EFFECTS["gravity"].at(World(cube.with_changes(friction=0.3)), np.array([9.0]))
    return CrossValidator.of(seen(truth, cube, 8, seed=3), cube, seed=0)


def test_more_tosses_reveal_less(cube: ObjectModel, validator: CrossValidator) -> None:
    present = validator.evaluate(Hypothesis(World(cube)))
    half = present.evidence.windows.toss < 4
    part = replace(present.fitted, evidence=present.evidence.rows(np.flatnonzero(half)))
    part = replace(part, residuals=present.fitted.residuals[half])
    (whole, seen_whole), (less, _) = (
        detectable_sizes(validator, each, EFFECTS["gravity"]) for each in (present, replace(present, fitted=part))
    )
    assert seen_whole
    assert less["g_ms2"] == pytest.approx(np.sqrt(2) * whole["g_ms2"], rel=0.4)
    assert 1e-3 < whole["g_ms2"] < 0.5


def test_a_size_that_tosses_reveal_is_four_standard_errors(cube: ObjectModel, validator: CrossValidator) -> None:
    truth = World(cube.with_changes(friction=0.3))
    with_gravity = Hypothesis(truth).plus(EFFECTS["gravity"], np.array([9.0]))
    present = validator.evaluate(with_gravity)
    fitted = validator.refit(present.evidence, with_gravity, 2)
    at = replace(present, fitted=fitted)
    sizes, _ = detectable_sizes(validator, at, EFFECTS["gravity"])
    error = float(np.sqrt(fitted.covariance()[0, 0]))
    assert 0.5 < sizes["g_ms2"] / (validator.settings.verdict.detectable * error) < 2.0


def test_an_effect_closes_what_it_closed_beyond_those_before_it(cube: ObjectModel, validator: CrossValidator) -> None:
    nothing = Hypothesis(World(cube))
    friction = nothing.plus(EFFECTS["friction"], np.array([0.3]))
    both = friction.plus(EFFECTS["gravity"], np.array([9.0]))
    history = tuple(validator.evaluate(each) for each in (nothing, friction, both))
    found = SearchResult(history[0], history[-1], history, {}, {}, {}, {})
    closed = closed_by_each(validator, found, noise_floor(validator.windows))
    assert list(closed) == ["friction", "gravity"]
    assert closed["friction"].value > 0.1
    assert closed["gravity"].value > 0.01
    assert 0.8 < closed["friction"].value + closed["gravity"].value < 1.1


def test_other_causes_have_their_values_and_what_they_would_replace(
    cube: ObjectModel, validator: CrossValidator
) -> None:
    nothing, friction = Hypothesis(World(cube)), np.array([0.3])
    gravity = nothing.plus(EFFECTS["gravity"], np.array([9.0])).plus(EFFECTS["friction"], friction)
    clock = nothing.plus(EFFECTS["time_base"], np.array([1.04])).plus(EFFECTS["friction"], friction)
    first, one, two = (
        replace(each, fitted=validator.refit(each.evidence, hypothesis, 2))
        for each, hypothesis in ((validator.evaluate(h), h) for h in (nothing, gravity, clock))
    )
    one, two = (replace(each, gain=validator.gain_over(each, first)) for each in (one, two))
    needed, classes = {"gravity": one, "friction": one}, {"gravity": (), "friction": ()}
    found = SearchResult(first, one, (first, one, one), {}, {}, needed, classes, n_flight=1)
    found = replace(found, other_causes=OtherCauses(two, {"time_base": two}))
    library = [EFFECTS[name] for name in ("gravity", "friction", "time_base", "inertia")]
    floor = noise_floor(validator.windows)
    closed = closed_by_each(validator, found, floor)
    named = ("gravity", "friction")
    moves = {"gravity": Consequence(3.0, 2.0, 0.5, True)}
    findings = effect_findings(library, validator, found, named, floor, None, closed, moves)
    assert [each.name for each in findings[:3]] == ["gravity", "time_base", "friction"]
    said = {each.name: each for each in findings}
    assert said["gravity"].confusable_with == ("time_base",)
    assert said["friction"].confusable_with == ()
    assert (said["time_base"].verdict, said["time_base"].confusable_with) == ("confusable", ("gravity",))
    assert said["time_base"].parameters["rate_rel"].value == two.fitted.hypothesis.values_of("time_base")[0]
    assert said["time_base"].evidence["gain"] == two.total
    assert said["time_base"].headline
    assert said["inertia"].verdict == "not_supported"


def test_effects_that_joined_at_once_share_what_they_close(cube: ObjectModel, validator: CrossValidator) -> None:
    nothing = Hypothesis(World(cube))
    both = nothing.plus(EFFECTS["friction"], np.array([0.3])).plus(EFFECTS["gravity"], np.array([9.0]))
    first, last = validator.evaluate(nothing), validator.evaluate(both)
    begun, one, same = joined_one_by_one(validator, (first, last))
    assert (begun, same) == (first, last)
    assert one.hypothesis.names == ("friction",)
    floor = noise_floor(validator.windows)
    closed = closed_by_each(validator, SearchResult(first, last, (first, one, last), {}, {}, {}, {}), floor)
    whole, _ = share_left(first, last, validator, floor)
    assert sum(each.value for each in closed.values()) == pytest.approx(whole.value)
    assert closed["gravity"].value < 0.9 * whole.value
