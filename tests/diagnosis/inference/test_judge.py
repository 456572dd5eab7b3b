"""What judges a toss has not seen it, and predicts whole tosses better by what was found without them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.conftest import FRICTION
from tossid.diagnosis.inference.brings import drawn, felt_of_each, noise_limit, whole_tosses, worsen
from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.inference.found import Rival
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.judge import DRAWS, Fold, closed_share, cross_fit, frequencies, lost_without
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.inference.search import Search
from tossid.diagnosis.likelihood.windows import Windows
from tossid.diagnosis.localisation.noise import expected_deviance
from tossid.objects import ObjectModel
from tossid.types import Toss

Index = NDArray[np.int64]
LIBRARY = tuple(EFFECTS[name] for name in ("gravity", "friction", "restitution"))


def folds_of(sample: Sample, stated: Hypothesis) -> list[Fold]:
    def search_of(chosen: Index) -> Search:
        return Search(sample.of_tosses(chosen), LIBRARY, stated, judging=True)

    def windows_of(held: Index, others: Index) -> Windows:
        return sample.windows.of_tosses(held)

    return list(cross_fit(search_of, windows_of, n=sample.n, count=3))


def half_as_certain(evidence: Evidence) -> Evidence:
    rows = evidence.windows.inside.sum(1) * evidence.windows.channels
    whitening = replace(evidence.whitening, log_det=evidence.whitening.log_det - rows * np.log(2.0))
    return replace(evidence, residuals=0.5 * evidence.residuals, whitening=whitening)


@pytest.fixture(scope="module")
def folds(slippery: Sample, stated: Hypothesis) -> list[Fold]:
    return folds_of(slippery, stated)


def test_a_judged_toss_moves_neither_the_choice_nor_a_value_that_judges_it(
    slippery: Sample, stated: Hypothesis, folds: list[Fold]
) -> None:
    judged = int(folds[0].held[0])
    # the toss falls 3 cm lower and slides as if pulled
    y = slippery.windows.y.copy()
    y[slippery.windows.toss == judged, :, 0] += np.linspace(0.0, 0.03, y.shape[1])
    after = folds_of(replace(slippery, windows=replace(slippery.windows, y=y)), stated)
    assert judged in after[0].held
    assert after[0].found.hypothesis.names == folds[0].found.hypothesis.names
    assert np.array_equal(after[0].found.hypothesis.flat(), folds[0].found.hypothesis.flat())
    # it does move what the others are judged by, and its own likelihood
    assert not np.array_equal(after[1].found.hypothesis.flat(), folds[1].found.hypothesis.flat())
    assert after[0].before.deviances().sum() > folds[0].before.deviances().sum()


def test_folds_hold_each_toss_once_and_searches_that_name_nothing_are_counted(
    slippery: Sample, folds: list[Fold]
) -> None:
    assert sorted(np.concatenate([fold.held for fold in folds]).tolist()) == list(range(slippery.n))
    found = frequencies(folds)
    assert (found.names[0], len(found.drawn)) == ("friction", 3 * DRAWS)
    assert found.of_any(("friction",)) == 1.0
    assert found.of_any(("gravity",)) == found.of_any(()) == found.none == 0.0
    nothing = frequencies([replace(fold, found=replace(fold.found, needed={}, rivals={})) for fold in folds])
    assert nothing.drawn.shape == (3 * DRAWS, 0)
    assert (nothing.none, nothing.of_any(("friction",))) == (1.0, 0.0)


def test_the_share_that_is_closed_is_of_judged_tosses_and_nothing_is_closed_by_wider_predictions(
    folds: list[Fold],
) -> None:
    floor = np.full(6, expected_deviance(1.0))
    share = closed_share(folds, floor)
    assert 0.8 < share.low <= share.value <= 1.0
    assert lost_without(folds, "friction", floor).value == pytest.approx(share.value, abs=0.1)
    assert lost_without(folds, "gravity", floor).value == 0.0
    assert closed_share([replace(fold, after=fold.before) for fold in folds], floor).value == 0.0
    # half as certain predictions leave half as large residuals of the same motions
    wider = [replace(fold, after=half_as_certain(fold.before)) for fold in folds]
    assert closed_share(wider, floor).value < 0.5


@pytest.mark.parametrize(("ahead", "named"), [(0.5, "friction"), (50.0, "restitution")])
def test_a_draw_prefers_a_rival_only_where_that_is_clearly_likelier(
    folds: list[Fold], ahead: float, named: str
) -> None:
    gain = ahead + 5.0 * np.where(np.arange(folds[0].found.fit.n) % 2, 1.0, -1.0)
    rivalled = [
        replace(f, found=replace(f.found, rivals={"friction": (Rival(EFFECTS["restitution"], f.found.fit, gain),)}))
        for f in folds
    ]
    assert frequencies(rivalled).of_any((named,)) > 0.8


# ---------------------------------------------------------------- whole tosses


def test_found_friction_brings_whole_tosses_near_the_recorded_ones(
    cube: ObjectModel, stated: Hypothesis, slippery_tosses: list[Toss], slippery: Sample, folds: list[Fold]
) -> None:
    found = whole_tosses(folds, slippery_tosses, stated)
    (was, now), (was_mm, now_mm) = found.position_pct(), found.position_mm()
    assert now.low <= now.value <= now.high < 0.5 * was.value
    assert was_mm.value == pytest.approx(was.value * 0.01 * 1e3 * cube.width)
    assert now_mm.value < was_mm.value
    assert [toss.name for toss in slippery_tosses].index(found.worst.name) == found.before[:, 0].argmax()
    off = np.linalg.norm(found.worst.before[:, :3] - found.worst.measured[:, :3], axis=1).mean() / cube.width
    assert 100 * off == pytest.approx(found.before[:, 0].max())
    # what noise makes is less than what friction made, and what is left is no more
    limit = noise_limit(folds[0].found, slippery_tosses, slippery, folds=3, seed=0)
    assert not found.is_felt(limit)
    assert limit.position_pct < 0.5 * was.value


def test_whole_tosses_feel_each_effect_as_much_as_it_moves_them_and_what_worsens_them_is_seen(
    stated: Hypothesis, slippery_tosses: list[Toss], slippery: Sample, folds: list[Fold]
) -> None:
    right = stated.plus(EFFECTS["friction"], np.array([FRICTION]))
    felt = felt_of_each(right.plus(EFFECTS["gravity"], np.array([9.8101])), slippery_tosses, slippery)
    assert (felt["friction"].is_over(), felt["gravity"].is_over()) == (True, False)
    assert felt_of_each(stated, slippery_tosses, slippery) == {}
    wrong = right.plus(EFFECTS["gravity"], np.array([9.0]))
    fits = [replace(f.found.fit, evidence=replace(f.found.fit.evidence, hypothesis=wrong)) for f in folds]
    instead = [replace(f, found=replace(f.found, fit=fit)) for f, fit in zip(folds, fits, strict=True)]
    assert worsen(folds, slippery_tosses, ["friction", "gravity"]) == set()
    assert worsen(instead, slippery_tosses, ["friction", "gravity"]) == {"gravity"}


def test_drawn_parameters_scatter_as_their_intervals_say(folds: list[Fold]) -> None:
    rng, found = np.random.default_rng(0), folds[0].found
    values = np.array([drawn(found, rng).values_of("friction")[0] for _ in range(300)])
    interval = found.fit.intervals("friction")["mu"]
    assert 0.93 < np.mean((interval.low <= values) & (values <= interval.high)) <= 1.0
