"""The gap of tosses that nothing has seen: no fit, no scale and no choice. They are judged in one pass at the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.likelihood.windows import Windows, make_windows
from tossid.diagnosis.localisation.gap import mean_square, share_left
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.motion.resting import rest_scatter
from tossid.objects import ObjectModel
from tossid.types import Toss


@dataclass(frozen=True)
class Unseen:
    """What was found, on tosses that took no part.

    Attributes:
        tosses: How many.
        gap: Root mean square of whitened residuals without effects.
        left: With all effects.
        closed: Share of the gap above the noise floor that all effects close.
    """

    tosses: int
    gap: Interval
    left: Interval
    closed: Interval

    def as_json(self) -> dict[str, Any]:
        """gap.json's "unseen"."""
        return {
            "n_tosses": self.tosses,
            "gap": self.gap.as_json(),
            "gap_left": self.left.as_json(),
            "gap_closed": self.closed.as_json(),
        }


def unseen_windows(
    unseen: Sequence[Toss], tosses: Sequence[Toss], model: ObjectModel, validator: CrossValidator
) -> Windows:
    """The windows of unseen tosses, with a tracker's slow errors as the others show them.

    Args:
        unseen: Tosses that took no part.
        tosses: Those that did.
        model: The object.
        validator: Of the tosses that did.
    """
    scatter = rest_scatter(tosses, model)
    return make_windows(unseen, model, settings=validator.settings.likelihood, scatter=scatter)


def judge_unseen(windows: Windows, first: Hypothesis, last: Hypothesis, validator: CrossValidator) -> Unseen:
    """The gap of unseen tosses without and with effects; only the windows' first states are fitted.

    Args:
        windows: Of `unseen_windows`.
        first: The hypothesis without effects.
        last: With effects, at the values fitted to the other tosses.
        validator: Of the other tosses.
    """
    n = int(windows.toss.max()) + 1
    there = replace(validator, windows=windows, n=n, folds=())
    before = there.evaluate(first)
    after = there.evaluate(last, before) if last.effects else before
    # at values that these tosses have not touched, what is fitted is what is judged
    after = replace(after, judged=after.fitted.residuals)
    closed, _ = share_left(before, after, there, noise_floor(windows))
    gap, left = (_root(mean_square(each, there)) for each in (before, after))
    return Unseen(len(np.unique(windows.toss)), gap, left, closed)


def _root(square: Interval) -> Interval:
    return Interval(*(float(np.sqrt(max(x, 0.0))) for x in (square.value, square.low, square.high)))
