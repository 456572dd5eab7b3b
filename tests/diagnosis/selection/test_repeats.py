"""Repeats of the search: which tosses and folds they have, and what they may name."""

from __future__ import annotations

import time
from collections.abc import Generator
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.selection import repeats
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.repeats import repeated, resampled, shortlist
from tossid.diagnosis.selection.search_result import OtherCauses, SearchResult
from tossid.diagnosis.selection.stability import Repeat, Stability
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import Toss

FEW = [EFFECTS[name] for name in ("gravity", "friction", "restitution")]
MORE = [
    EFFECTS[name] for name in ("vortex", "magnus", "wind", "geometry", "time_base", "ground_height", "rotation_delay")
]


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
    some = [effect.name for effect in shortlist(validator, wrong, [*FEW, *MORE], 3)]
    assert {"friction", "restitution"} <= set(some)
    assert len(some) < (len(FEW) + len(MORE)) / 2
    assert "vortex" not in some
    other = validator.evaluate(wrong.first.hypothesis.plus(EFFECTS["vortex"]))
    with_other = replace(wrong, other_causes=OtherCauses(other, {}))
    assert "vortex" in {effect.name for effect in shortlist(validator, with_other, [*FEW, *MORE], 3)}


def test_repeats_name_something_else_than_a_wrong_search(
    cube: ObjectModel, tosses: list[Toss], validator: CrossValidator, wrong: SearchResult
) -> None:
    before, found = repeated(tosses, validator, wrong, FEW, seed=0)
    assert before.repeats == found.repeats[:1]
    assert found.frequency(["friction"]) == 1.0
    assert found.frequency(["restitution"]) == 0.0
    assert found.probability_none == 0.0
    for each in found.repeats:
        assert each.as_json()["effects"]["friction"]["mu"] == pytest.approx(0.3, abs=0.01)


def test_without_repeats_nothing_is_said(
    cube: ObjectModel, tosses: list[Toss], validator: CrossValidator, wrong: SearchResult
) -> None:
    once = replace(validator, settings=replace(validator.settings, repeats=0))
    assert list(repeated(tosses, once, wrong, FEW, seed=0)) == []


def test_repeats_that_are_no_longer_wanted_end(
    cube: ObjectModel,
    tosses: list[Toss],
    validator: CrossValidator,
    wrong: SearchResult,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ended: list[int] = []

    def repeat(*given: Any) -> Repeat:
        *_, under_way, rng = given
        k = rng.bit_generator.seed_seq.spawn_key[-1]
        if k == 0:
            return Repeat(("friction",), 0.9)
        with pytest.raises(InterruptedError):
            while True:
                under_way("for ever", 0.5)
                time.sleep(0.001)
        ended.append(k)
        return Repeat((), 0.0)

    monkeypatch.setattr(repeats, "_repeat", repeat)
    many = replace(validator, n_threads=2, settings=replace(validator.settings, repeats=9))
    under_way = cast("Generator[Stability, None, None]", repeated(tosses, many, wrong, FEW, seed=0))
    assert next(under_way).frequency(["friction"]) == 1.0
    under_way.close()
    assert ended  # what had begun
    assert max(ended) < 8  # the last ones never did
