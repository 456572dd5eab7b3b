"""Judging folds: hypotheses that are chosen and fitted without the tosses that judge them.

The search sees all tosses. So what it reports of itself is measured once more. Each judging fold is left out: the
effects that the other tosses alone support are kept, their values are fitted to these, and the fold is predicted.

This approximates a search that is repeated without each fold, which costs as many searches as there are folds
(`pipelines.tools.experiments.nested` compares both). What it leaves out is an effect that only the other tosses would
have found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.likelihood.fitting import fit
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.diagnosis.selection.significance import part_p_value

Array = NDArray[np.float64]
Chosen = NDArray[np.bool_]


@dataclass(frozen=True)
class JudgingFold:
    """Tosses that judge, and what was chosen and fitted without them.

    Attributes:
        held: (n,) the tosses that judge.
        hypothesis: The effects that the others support, at values fitted to the others.
        residuals: (w, L, K) whitened residuals of the windows of the tosses that judge, in the order of all windows.
        rows: (w,) the numbers of these windows.
    """

    held: Chosen
    hypothesis: Hypothesis
    residuals: Array
    rows: NDArray[np.int64]


def judging_folds(validator: CrossValidator, found: SearchResult) -> tuple[JudgingFold, ...]:
    """The last hypothesis of a search, chosen and fitted anew without each fold.

    Args:
        validator: Of all windows.
        found: What the search found.
    """
    if not found.present.hypothesis.effects:
        return ()
    count = max(2, min(validator.settings.cross_validation.judging_folds, len(validator.folds)))
    groups = [np.any(validator.folds[k::count], axis=0) for k in range(count)]
    return tuple(validator.map(lambda held: _judged(validator, found, held), groups))


def _judged(validator: CrossValidator, found: SearchResult, held: Chosen) -> JudgingFold:
    present = found.present
    hypothesis = present.hypothesis
    for name in hypothesis.names:
        if not supported(validator, found, name, ~held):
            hypothesis = hypothesis.minus(name)
    evidence, own = present.evidence, np.flatnonzero(held[validator.windows.toss])
    training = evidence.of_tosses(~held)
    if hypothesis is not present.hypothesis:
        training = training.relinearised(hypothesis.world(), refine=2)
    hypothesis = fit(training, hypothesis, n_tosses=validator.n).hypothesis
    there = evidence.rows(own).relinearised(hypothesis.world(), refine=2)
    return JudgingFold(held, hypothesis, there.residuals(hypothesis.world()), own)


def supported(validator: CrossValidator, found: SearchResult, name: str, chosen: Chosen) -> bool:
    """Whether some tosses alone support an effect of the last hypothesis, beside its others.

    With few tosses no p-value reaches the level of the search. Then the best but one that they can have is enough.

    Args:
        validator: Of all windows.
        found: What the search found.
        name: Of the effect.
        chosen: (n,) which tosses.
    """
    needed = found.needed.get(name)
    if needed is None:
        return True
    gains = needed.toss_gains[:, chosen]
    library = max(len(found.first_round), len(found.flight_round), 1)
    level = validator.settings.selection.level / library
    least = 2 * len(gains) * 2.0 ** -int(chosen.sum())
    return bool(gains[0].sum() > 0 and part_p_value(gains) <= max(level, least))


def judged(validator: CrossValidator, found: SearchResult, folds: tuple[JudgingFold, ...]) -> SearchResult:
    """The search's result, whose last hypothesis has the residuals of every toss as they are without that toss.

    Args:
        validator: Of all windows.
        found: What the search found.
        folds: Of `judging_folds`; none if nothing was found.
    """
    if not folds:
        return found
    residuals = np.empty_like(found.present.fitted.residuals)
    for fold in folds:
        residuals[fold.rows] = fold.residuals
    assert sum(len(fold.rows) for fold in folds) == len(validator.windows.toss)
    return found.ending_in(replace(found.present, judged=residuals))
