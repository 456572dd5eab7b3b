"""Which effects may be what changes over the order of recording: what each gains from stretch to stretch.

How sure it is that an effect's values change says little of how much the change explains. Where something changes far
beyond the noise, the values of nearly every effect do. So the suspects are compared by likelihood: each stretch of
tosses has values of its own, and what these gain over one value for all tosses counts.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.selection.cross_validation import Candidate
from tossid.motion.sessions.change_points import Witness, robust_mean
from tossid.physics.effects import Effect


def suspects_among(library: Sequence[Effect], changing: Collection[str]) -> list[Effect]:
    """The effects whose values change, and those that do the same as some of these together.

    Args:
        library: The effects.
        changing: Names of those whose values change.
    """
    return [
        effect
        for effect in library
        if effect.name in changing or (effect.made_of and effect.made_of <= frozenset(changing))
    ]


def gain_of_change(
    present: Candidate,
    effect: Effect,
    witness: Witness,
    edges: Sequence[int],
    *,
    shares: Sequence[float],
    outlier: float,
) -> float:
    """What an effect gains by a step of its own in each stretch, over one step for all tosses.

    Args:
        present: The hypothesis beside which it changes.
        effect: The effect.
        witness: What each toss says of it.
        edges: First tosses of the stretches, and the number of tosses.
        shares: Parts of a step that are tried; the best counts.
        outlier: As of `robust_mean`.
    """
    toss = present.evidence.windows.toss

    def gain(first: int, stop: int) -> float:
        rows = np.flatnonzero((toss >= first) & (toss < stop))
        best = 0.0
        for share in shares:
            moved = stepped(present.hypothesis, effect, witness, first, stop, share=share, outlier=outlier)
            after = present.evidence.log_likelihood_of(moved.world(), present.fitted.scales, rows)
            gains = present.evidence.gains(after, _log_likelihood(present, rows))
            best = max(best, float(gains @ present.evidence.windows.weights[rows]))
        return best

    return sum(gain(a, b) for a, b in pairwise(edges)) - gain(edges[0], edges[-1])


def stepped(
    hypothesis: Hypothesis,
    effect: Effect,
    witness: Witness,
    first: int,
    stop: int,
    *,
    share: float = 1.0,
    outlier: float = 3.0,
) -> Hypothesis:
    """The hypothesis with an effect where some tosses together say that it is.

    Args:
        hypothesis: With or without the effect.
        effect: The effect.
        witness: What each toss says of it, in steps from where it is.
        first: First of the tosses.
        stop: The first after them.
        share: Part of the way.
        outlier: As of `robust_mean`.
    """
    if effect.name not in hypothesis.names:
        hypothesis = hypothesis.plus(effect)
    place, (values, info, _) = hypothesis.place_of(effect.name), witness
    step = np.nan_to_num(robust_mean(values[first:stop], info[first:stop], outlier=outlier).value)
    flat = hypothesis.flat()
    flat[place] += share * step * hypothesis.steps[place]
    return hypothesis.clipped(flat)


def _log_likelihood(present: Candidate, rows: NDArray[np.int64]) -> NDArray[np.float64]:
    fitted = present.fitted
    return present.evidence.log_likelihood(fitted.residuals[rows], fitted.scales, rows)
