"""Repeats of the search: which tosses and folds they have, what they may name, and what is concluded from them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.diagnosis.selection.stability import Repeat, Stability, repeated, resampled, shortlist
from tossid.objects import ObjectModel
from tossid.physics.effects import LIBRARY, World
from tossid.types import Toss

FEW = [EFFECTS[name] for name in ("gravity", "friction", "restitution")]


def test_copies_of_a_toss_are_in_one_fold() -> None:
    for seed in range(20):
        draw, folds = resampled(12, 8, np.random.default_rng(seed))
        assert len(draw) == 12
        np.testing.assert_array_equal(np.sum(folds, axis=0), 1)
        for held in folds:
            assert held.any()
            assert set(draw[held]).isdisjoint(draw[~held])


def test_a_draw_has_two_thirds_of_the_tosses() -> None:
    kinds = [len(set(resampled(40, 8, np.random.default_rng(seed))[0])) / 40 for seed in range(200)]
    assert np.mean(kinds) == pytest.approx(1 - np.exp(-1), abs=0.02)


def test_frequencies_count_repeats() -> None:
    names = (("friction",), 0.9), (("cohesion",), 0.8), ((), 0.0), (("friction", "wind"), 0.3)
    found = Stability(tuple(Repeat(*each) for each in names), 0.5)
    assert found.frequency(["friction"]) == 0.5
    assert found.frequency(["friction", "cohesion"]) == 0.75
    assert found.frequency(["gravity"]) == 0.0
    general = Stability((Repeat(("velocity_friction",), 0.9, frozenset({"friction"})),))
    assert general.frequency(["friction"]) == 1.0
    # one names nothing, and another closes too little
    assert found.probability_none == 0.5
    assert Stability().frequency(["friction"]) is None
    assert Stability().probability_none is None


@pytest.fixture(scope="module")
def tosses(cube: ObjectModel) -> list[Toss]:
    return seen(World(cube.with_changes(friction=0.3)), cube, 12, seed=4, frames=60)


@pytest.fixture(scope="module")
def validator(cube: ObjectModel, tosses: list[Toss]) -> CrossValidator:
    made = CrossValidator.of(tosses, cube, seed=0)
    return replace(made, settings=replace(made.settings, repeats=2))


@pytest.fixture(scope="module")
def wrong(cube: ObjectModel, validator: CrossValidator) -> SearchResult:
    """As if a search had found a bounce, where friction is other than stated."""
    first = validator.evaluate(Hypothesis(World(cube)))
    bounce = EFFECTS["restitution"]
    last = validator.cross_validate(first, bounce, first.hypothesis.plus(bounce, np.array([0.1])))
    return SearchResult(first, last, (first, last), {}, {}, {"restitution": last}, {"restitution": ()})


def test_a_shortlist_has_what_gains_and_what_was_found(validator: CrossValidator, wrong: SearchResult) -> None:
    some = [effect.name for effect in shortlist(validator, wrong, LIBRARY, 3)]
    assert {"friction", "restitution"} <= set(some)
    assert len(some) < len(LIBRARY) / 2


def test_repeats_name_something_else_than_a_wrong_search(
    cube: ObjectModel, tosses: list[Toss], validator: CrossValidator, wrong: SearchResult
) -> None:
    found = repeated(tosses, cube, validator, wrong, FEW, seed=0)
    assert found.frequency(["friction"]) == 1.0
    assert found.frequency(["restitution"]) == 0.0
    assert found.probability_none == 0.0
    for each in found.repeats:
        assert each.as_json()["effects"]["friction"]["mu"] == pytest.approx(0.3, abs=0.01)


def test_without_repeats_nothing_is_said(
    cube: ObjectModel, tosses: list[Toss], validator: CrossValidator, wrong: SearchResult
) -> None:
    once = replace(validator, settings=replace(validator.settings, repeats=0))
    assert repeated(tosses, cube, once, wrong, FEW, seed=0).repeats == ()


def test_intervals_are_no_narrower_than_the_scatter_of_repeats() -> None:
    friction, known = EFFECTS["friction"], {"mu": Interval(0.30, 0.29, 0.31)}
    near, far = (
        Stability(tuple(Repeat(("friction",), 0.9, parameters={"friction": {"mu": x}}) for x in values))
        for values in ((0.299, 0.3, 0.301, 0.3, 0.3), (0.2, 0.3, 0.4, 0.3, 0.3))
    )
    assert near.widened(friction, known, 5) == known
    scatter = 1.96 * np.std([0.2, 0.3, 0.4, 0.3, 0.3], ddof=1)
    wide = far.widened(friction, known, 5)["mu"]
    assert (wide.value, wide.low, wide.high) == pytest.approx((0.3, 0.3 - scatter, 0.3 + scatter))
    assert far.widened(friction, known, 6) == known
    assert far.widened(EFFECTS["restitution"], {"e": Interval(0.1, 0.0, 0.2)}, 5) == {"e": Interval(0.1, 0.0, 0.2)}
    off = Stability(tuple(Repeat(("friction",), 0.9, parameters={"friction": {"mu": x}}) for x in (0.0, 1.0, 0.0, 1.0)))
    assert off.widened(friction, known, 4)["mu"].low == friction.parameters[0].low
