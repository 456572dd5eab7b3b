"""What the changes bring: whole tosses that took no part, predicted before and after them.

A short window starts from what its own frames say. A person runs a simulator from the release to the end. So each toss
is rolled out open loop from the first state that its flight determines, by what was chosen and fitted without it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.judge import Fold
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.inference.verdict import Felt
from tossid.diagnosis.localisation.gap import bootstrap_ratio
from tossid.diagnosis.localisation.rollouts import toss_errors
from tossid.types import Toss

Array = NDArray[np.float64]
Errors = Callable[[Hypothesis, Sequence[Toss], Sample], Array]
"""(m, 2) mean position error [% of the width] and rotation error [deg] of whole tosses; NaN where one diverged."""


@dataclass(frozen=True)
class Brings:
    """Errors of whole tosses, each predicted by what was found without it.

    Attributes:
        before: (n, 2) mean position error [% of the width] and rotation error [deg] of the simulator as stated.
        after: (n, 2) the same with what was found.
        width: Of the object [m].
    """

    before: Array
    after: Array
    width: float

    def position_pct(self) -> tuple[Interval, Interval]:
        """Position errors before and after [% of the width], with intervals over tosses."""
        return _mean(self.before[:, 0]), _mean(self.after[:, 0])

    def position_mm(self) -> tuple[Interval, Interval]:
        """The same [mm]."""
        return _scaled(self.position_pct(), 10 * self.width)

    def rotation_deg(self) -> tuple[Interval, Interval]:
        """Rotation errors before and after [deg]."""
        return _mean(self.before[:, 1]), _mean(self.after[:, 1])

    def improves(self) -> bool:
        """Whether tosses are predicted no worse with what was found, but for what a person would not notice."""
        worse = np.nan_to_num(self.after - self.before, nan=np.inf)
        felt = Felt(float(np.median(worse[:, 0])), float(np.median(worse[:, 1])))
        return not felt.is_over(Felt(0.0, 0.0))


def whole_tosses(
    folds: Sequence[Fold],
    tosses: Sequence[Toss],
    sample: Sample,
    stated: Hypothesis,
    *,
    errors: Errors | None = None,
) -> Brings:
    """What was found without each toss brings for it.

    Args:
        folds: Of `judge.cross_fit`.
        tosses: All of them.
        sample: Their windows.
        stated: The simulator as it is stated.
        errors: Of whole tosses under a hypothesis, in a user's own engine; in tossid's simulator if None.
    """
    errors = errors or errors_in_tossid
    before, after = np.full((len(tosses), 2), np.nan), np.full((len(tosses), 2), np.nan)
    for fold in folds:
        held = [tosses[i] for i in fold.held.tolist()]
        part = sample.of_tosses(fold.held)
        before[fold.held] = errors(stated, held, part)
        unchanged = fold.found.hypothesis.world() is stated.world()
        after[fold.held] = before[fold.held] if unchanged else errors(fold.found.hypothesis, held, part)
    return Brings(before, after, stated.base.object.width)


def errors_in_tossid(hypothesis: Hypothesis, tosses: Sequence[Toss], sample: Sample) -> Array:
    """`Errors` in tossid's own simulator, or in a user's that is called from Python.

    Args:
        hypothesis: What predicts.
        tosses: m of them.
        sample: Their windows.
    """
    return toss_errors(tosses, hypothesis.world(), sample.windows, n_threads=sample.n_threads)


def _mean(values: Array) -> Interval:
    """The mean over tosses whose rollouts did not diverge, with its percentile interval."""
    good = values[np.isfinite(values)]
    return bootstrap_ratio(good, np.ones(len(good)))


def _scaled(pair: tuple[Interval, Interval], by: float) -> tuple[Interval, Interval]:
    one, other = (Interval(by * x.value, by * x.low, by * x.high) for x in pair)
    return one, other
