"""Which effects may be what changes over the order of recording: what each gains from stretch to stretch.

How sure it is that an effect's values change says little of how much the change explains. Where something changes far
beyond the noise, the values of nearly every effect do. So the suspects are compared by likelihood: each stretch of
tosses has values of its own, and what these gain over one value for all tosses counts.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.likelihood.fitting import Fitted, fit
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.screening import Screened, screen
from tossid.motion.sessions.change_points import Witness, robust_mean
from tossid.physics.effects import Effect

_UNFELT = 0.01
"""Share of the information of other tosses below which some say next to nothing of an effect."""


def suspects_among(library: Sequence[Effect], changing: Collection[str]) -> list[Effect]:
    """The effects whose values change, those that do the same as some of these together, and special cases of these.

    Args:
        library: The effects.
        changing: Names of those whose values change.
    """
    special = frozenset[str]().union(*(effect.contains for effect in library if effect.name in changing))
    return [
        effect
        for effect in library
        if effect.name in special | frozenset(changing) or (effect.made_of and effect.made_of <= frozenset(changing))
    ]


def unfelt_in_part(witness: Witness | None, edges: Sequence[int]) -> bool:
    """Whether the tosses of a stretch say next to nothing of an effect, against those of the stretch that says most.

    Objects that come to rest above the stated ground never touch it in the simulator, and say nothing of its height.
    What they lack is not found by small steps.

    Args:
        witness: What each toss says of the effect; None if none says anything.
        edges: First tosses of the stretches, and the number of tosses.
    """
    if witness is None:
        return True
    said = np.trace(witness[1], axis1=1, axis2=2)
    typical = [float(np.median(said[a:b])) for a, b in pairwise(edges)]
    return min(typical) < _UNFELT * max(typical)


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
        shares: Parts of a step that are tried, largest first, until a smaller one gains less.
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
            found = float(gains @ present.evidence.windows.weights[rows])
            if found <= best and best > 0:
                break
            best = max(best, found)
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


def fits_from_starts(
    present: Candidate, effects: Sequence[Effect], edges: Sequence[int], validator: CrossValidator, *, count: int
) -> list[tuple[Effect, tuple[Fitted, ...]]]:
    """Effects of which tosses say nothing near their nominal values, fitted to each stretch from declared starts.

    A raised ground under an object that floats above the stated one is such an effect: no small change is felt.

    Args:
        present: The hypothesis beside which they change.
        effects: Some that have starts.
        edges: First tosses of the stretches, and the number of tosses.
        validator: Of all windows.
        count: How many are fitted: those that gain most by one step.

    Returns:
        The effects with the fits of their stretches.
    """
    toss, parts = present.evidence.windows.toss, []
    for a, b in pairwise(edges):
        rows = np.flatnonzero((toss >= a) & (toss < b))
        own = replace(present.fitted, evidence=present.evidence.rows(rows), residuals=present.fitted.residuals[rows])
        parts.append(replace(present, fitted=own))
    held = frozenset(present.hypothesis.names)

    def screened(effect: Effect) -> list[Screened]:
        return [screen(validator, part, effect) for part in parts]

    found = validator.map(screened, [each for each in effects if each.starts and each.name not in held])
    found = sorted(found, key=lambda each: -sum(one.gain for one in each))[:count]

    def fitted(each: list[Screened]) -> tuple[Effect, tuple[Fitted, ...]]:
        fits = (
            fit(one.evidence(part), one.start, n_tosses=validator.n, held=held)
            for one, part in zip(each, parts, strict=True)
        )
        return each[0].effect, tuple(fits)

    return validator.map(fitted, found)


def _log_likelihood(present: Candidate, rows: NDArray[np.int64]) -> NDArray[np.float64]:
    fitted = present.fitted
    return present.evidence.log_likelihood(fitted.residuals[rows], fitted.scales, rows)
