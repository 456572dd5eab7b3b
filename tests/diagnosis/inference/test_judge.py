"""What judges a toss has not seen it: neither a choice nor a value changes with the toss."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.diagnosis.by_hand import EFFECTS
from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.inference.found import Rival
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.judge import DRAWS, Fold, closed_share, cross_fit, frequencies, lost_without
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.inference.search import Search
from tossid.diagnosis.likelihood.windows import Windows
from tossid.diagnosis.localisation.noise import expected_deviance

Index = NDArray[np.int64]
LIBRARY = tuple(EFFECTS[name] for name in ("gravity", "friction", "restitution"))


def folds_of(sample: Sample, stated: Hypothesis) -> list[Fold]:
    def search_of(chosen: Index) -> Search:
        return Search(sample.of_tosses(chosen), LIBRARY, stated, judging=True)

    def windows_of(held: Index, others: Index) -> Windows:
        return sample.windows.of_tosses(held)

    return list(cross_fit(search_of, windows_of, n=sample.n, count=3))


def test_a_judged_toss_moves_neither_the_choice_nor_a_value_that_judges_it(
    slippery: Sample, stated: Hypothesis
) -> None:
    before = folds_of(slippery, stated)
    judged = int(before[0].held[0])
    # the toss falls 3 cm lower and slides as if pulled
    y = slippery.windows.y.copy()
    mine = slippery.windows.toss == judged
    y[mine, :, 0] += np.linspace(0.0, 0.03, y.shape[1])
    after = folds_of(replace(slippery, windows=replace(slippery.windows, y=y)), stated)
    assert judged in after[0].held
    assert after[0].found.hypothesis.names == before[0].found.hypothesis.names
    assert np.array_equal(after[0].found.hypothesis.flat(), before[0].found.hypothesis.flat())
    # it does move what the others are judged by, and its own likelihood
    assert not np.array_equal(after[1].found.hypothesis.flat(), before[1].found.hypothesis.flat())
    assert after[0].before.deviances().sum() > before[0].before.deviances().sum()


def test_folds_hold_each_toss_once_and_name_what_is_there(slippery: Sample, stated: Hypothesis) -> None:
    folds = folds_of(slippery, stated)
    assert sorted(np.concatenate([fold.held for fold in folds]).tolist()) == list(range(slippery.n))
    found = frequencies(folds)
    assert found.names[0] == "friction"
    assert len(found.drawn) == 3 * DRAWS
    assert found.of_any(("friction",)) == 1.0
    assert found.of_any(("gravity",)) == found.of_any(()) == found.none == 0.0
    closed = [fold.after.deviances().sum() / fold.before.deviances().sum() for fold in folds]
    assert max(closed) < 0.8


def test_searches_that_name_nothing_are_counted(slippery: Sample, stated: Hypothesis) -> None:
    folds = [replace(fold, found=replace(fold.found, needed={}, rivals={})) for fold in folds_of(slippery, stated)]
    found = frequencies(folds)
    assert found.drawn.shape == (3 * DRAWS, 0)
    assert found.none == 1.0
    assert found.of_any(("friction",)) == 0.0


def test_the_share_that_is_closed_is_of_judged_tosses_and_nothing_is_closed_by_wider_predictions(
    slippery: Sample, stated: Hypothesis
) -> None:
    folds = folds_of(slippery, stated)
    floor = np.full(6, expected_deviance(1.0))
    share = closed_share(folds, floor)
    assert share.low > 0.8
    assert share.value <= 1.0
    lost = lost_without(folds, "friction", floor)
    assert lost.value == pytest.approx(share.value, abs=0.1)
    assert lost_without(folds, "gravity", floor).value == 0.0
    same = [replace(fold, after=fold.before) for fold in folds]
    assert closed_share(same, floor).value == 0.0
    # half as certain predictions leave half as large residuals of the same motions
    wider = [replace(fold, after=half_as_certain(fold.before)) for fold in folds]
    assert closed_share(wider, floor).value < 0.5


def half_as_certain(evidence: Evidence) -> Evidence:
    rows = evidence.windows.inside.sum(1) * evidence.windows.channels
    whitening = replace(evidence.whitening, log_det=evidence.whitening.log_det - rows * np.log(2.0))
    return replace(evidence, residuals=0.5 * evidence.residuals, whitening=whitening)


@pytest.mark.parametrize(("ahead", "named"), [(0.5, "friction"), (50.0, "restitution")])
def test_a_draw_prefers_a_rival_only_where_that_is_clearly_likelier(
    slippery: Sample, stated: Hypothesis, ahead: float, named: str
) -> None:
    folds = []
    for fold in folds_of(slippery, stated):
        found = fold.found
        gain = ahead + 5.0 * np.where(np.arange(found.fit.n) % 2, 1.0, -1.0)
        rival = Rival(EFFECTS["restitution"], found.fit, gain)
        folds.append(replace(fold, found=replace(found, rivals={"friction": (rival,)})))
    assert frequencies(folds).of_any((named,)) > 0.8
