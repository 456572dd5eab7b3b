"""What judges took no part: a fold that is left out changes neither choice nor values, and each toss is judged once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.gap import share_left
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.localisation.unseen import judge_unseen, unseen_windows
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.nested import judged, judging_folds, supported
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import Toss

COUNT = 8


@pytest.fixture(scope="module")
def tosses(cube: ObjectModel) -> list[Toss]:
    return seen(World(cube.with_changes(friction=0.3)), cube, COUNT, seed=4)


@pytest.fixture(scope="module")
def validator(cube: ObjectModel, tosses: list[Toss]) -> CrossValidator:
    return CrossValidator.of(tosses, cube, seed=0)


@pytest.fixture(scope="module")
def found(cube: ObjectModel, validator: CrossValidator) -> SearchResult:
    first = validator.evaluate(Hypothesis(World(cube)))
    last = validator.cross_validate(first, EFFECTS["friction"], first.hypothesis.plus(EFFECTS["friction"]))
    return SearchResult(first, last, (first, last), {}, {}, {"friction": last}, {"friction": ()})


def _spoilt(candidate: Candidate, rows: np.ndarray) -> Candidate:
    """A candidate whose measured poses in some windows are off by 20 cm."""
    evidence = candidate.evidence
    y = evidence.windows.y.copy()
    y[rows, :, 2] += 0.2
    evidence = replace(evidence, windows=replace(evidence.windows, y=y), at=None, known={})
    return replace(candidate, fitted=replace(candidate.fitted, evidence=evidence))


def test_tosses_that_judge_change_nothing_that_they_judge(validator: CrossValidator, found: SearchResult) -> None:
    folds = judging_folds(validator, found)
    np.testing.assert_array_equal(np.sum([fold.held for fold in folds], axis=0), 1)
    spoilt = found.ending_in(_spoilt(found.present, folds[0].rows))
    again = judging_folds(validator, spoilt)
    np.testing.assert_array_equal(again[0].hypothesis.flat(), folds[0].hypothesis.flat())
    assert np.abs(again[0].residuals).max() > 10 * np.abs(folds[0].residuals).max()
    for fold in folds:
        assert fold.hypothesis.values_of("friction")[0] == pytest.approx(0.3, abs=0.02)


def test_an_effect_that_only_the_judges_support_is_not_chosen(validator: CrossValidator, found: SearchResult) -> None:
    held = judging_folds(validator, found)[0].held
    gains = np.where(held, 100.0, -1.0) * np.ones((3, 1))
    alone = replace(found, needed={"friction": replace(found.present, toss_gains=gains)})
    assert not supported(validator, alone, "friction", ~held)
    fold = judging_folds(validator, alone)[0]
    assert fold.hypothesis.names == ()


def test_what_was_judged_closes_the_gap(validator: CrossValidator, found: SearchResult) -> None:
    done = judged(validator, found, judging_folds(validator, found))
    closed, _ = share_left(done.first, done.present, validator, noise_floor(validator.windows))
    assert 0.8 < closed.value <= 1.0
    assert done.history[-1] is done.present


def test_unseen_tosses_are_judged_in_one_pass(
    cube: ObjectModel, tosses: list[Toss], validator: CrossValidator, found: SearchResult
) -> None:
    other = seen(World(cube.with_changes(friction=0.3)), cube, 6, seed=14)
    windows = unseen_windows(other, tosses, cube, validator)
    judgement = judge_unseen(windows, found.first.hypothesis, found.present.hypothesis, validator)
    assert judgement.tosses == 6
    assert judgement.closed.value > 0.8
    assert judgement.left.value < 0.5 * judgement.gap.value
    none = judge_unseen(windows, found.first.hypothesis, found.first.hypothesis, validator)
    assert none.closed.value == pytest.approx(0.0, abs=1e-9)
