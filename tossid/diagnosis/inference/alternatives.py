"""Which of several hypotheses that explain tosses as well stands, and what else may be there in its place."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.inference.fitting import Fit, fit
from tossid.diagnosis.inference.found import Fitted, Found, Rival
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import Sample, margin
from tossid.diagnosis.inference.screening import Candidate
from tossid.physics.effects import Effect

Array = NDArray[np.float64]

SMALL = 0.01
"""Share of a gain that is as good as nothing."""
ALIKE, MOST_RIVALS = 0.8, 3
"""Share of an effect's gain from which another may be the cause in its place, and how many such are looked at."""


def stands(one: Hypothesis, other: Hypothesis, gain: Array, library: Sequence[Effect]) -> bool:
    """Whether a hypothesis stands in the place of another: it is likelier, or as likely and simpler.

    Args:
        one: The hypothesis.
        other: The other one.
        gain: (n,) of each toss, of the one over the other.
        library: All effects; of as many parameters, those that come first are the simpler ones.
    """
    simpler = _complexity(one.effects, library) < _complexity(other.effects, library)
    return bool(gain.sum() > (-1 if simpler else 1) * margin(gain))


def _complexity(effects: Sequence[Effect], library: Sequence[Effect]) -> tuple[int, list[int]]:
    """How many parameters, then the places of effects in the library, in which a recording's errors come last.

    A clock that runs wrong does what another gravity does to a rigid body: its equations have no unit of time. No
    likelihood tells the two apart, so an order that does not depend on noise has to.
    """
    place = {effect.name: k for k, effect in enumerate(library)}
    places = sorted(place.get(effect.name, len(place)) for effect in effects)
    return sum(len(effect.parameters) for effect in effects), places


def simplest_first(candidates: Iterable[Candidate], library: Sequence[Effect]) -> list[Candidate]:
    """Candidates that are as likely, as `stands` prefers them.

    Args:
        candidates: Effects.
        library: As of `stands`.
    """
    return sorted(candidates, key=lambda c: _complexity(() if c.effect is None else (c.effect,), library))


def likeliest(tried: Sequence[Evidence], sample: Sample, library: Sequence[Effect]) -> int:
    """Number of the likeliest of some hypotheses: the simplest of those that are as likely.

    Args:
        tried: Evidence of each.
        sample: Of the tosses.
        library: As of `stands`.
    """
    best = 0
    for k, each in enumerate(tried[1:], 1):
        if stands(each.hypothesis, tried[best].hypothesis, sample.ratio(each, tried[best]), library):
            best = k
    return best


def simplest(fits: Sequence[Fitted]) -> Fitted | None:
    """Of candidates that gain as much as the best, the first with the fewest parameters.

    Args:
        fits: By decreasing gain.
    """
    chosen = fits[0] if fits else None
    for each in fits[1:]:
        assert chosen is not None
        behind = fits[0].gain - each.gain
        fewer = len(each.fit.hypothesis.flat()) < len(chosen.fit.hypothesis.flat())
        if fewer and behind.sum() < max(margin(behind), SMALL * fits[0].gain.sum()):
            chosen = each
    return chosen


def not_containing(name: str, candidates: Iterable[Candidate]) -> list[Candidate]:
    """Candidates that are effects, without those that contain an effect: they always fit as well.

    Args:
        name: Of the effect.
        candidates: Any.
    """
    return [c for c in candidates if c.effect is not None and name not in c.effect.contains]


def with_special_cases(candidates: Sequence[Candidate], most: int) -> list[Candidate]:
    """The first candidates, and those of the others that are special cases of one of them.

    Args:
        candidates: In their order.
        most: How many first ones.
    """
    special = {name for c in candidates[:most] if c.effect is not None for name in c.effect.contains}
    return [*candidates[:most], *(c for c in candidates[most:] if c.name in special)]


def replacements(found: Found, name: str) -> list[Candidate]:
    """What may do alone what an effect of a found hypothesis does, in closed form, by the columns of the last round.

    Args:
        found: With the effect.
        name: Of the effect.
    """
    shares = found.rounds[-1].screening.replacements(found.fit.columns_of(name), found.fit.from_nominal(name))
    return not_containing(name, [c for share, c in shares if share > ALIKE])[:MOST_RIVALS]


def rival_of(sample: Sample, found: Found, name: str, candidate: Candidate) -> Rival:
    """An effect in the place of another of a found hypothesis, all fitted again.

    Args:
        sample: Of the tosses.
        found: With the effect.
        name: Of the effect.
        candidate: What takes its place.
    """
    assert candidate.effect is not None
    start = found.hypothesis.with_replaced(name, candidate.effect, candidate.start.values_of(candidate.name))
    fitted = fit(found.fit.evidence, start, n=sample.n, iterations=3, held=found.flown, follow=3)
    return Rival(candidate.effect, fitted, sample.gains(fitted, found.fit))


@dataclass(frozen=True)
class FlightHypothesis:
    """A hypothesis of flight, and which effect it has in the place of which; neither in that of the rounds."""

    fit: Fit
    instead_of: str
    name: str


def rivals_in_flight(
    flights: Sequence[FlightHypothesis], ratios: Sequence[Array], best: int
) -> dict[str, tuple[Rival, ...]]:
    """What could take the place of an effect of flight: explanations of it, by how likely contact makes them.

    Args:
        flights: All explanations, that of the rounds first.
        ratios: (n,) of each, how much likelier tosses are under it than under the chosen one.
        best: Number of the chosen one.
    """
    rivals, chosen = dict[str, tuple[Rival, ...]](), flights[best]
    for k, each in enumerate(flights):
        if k == best or (chosen.name and k and each.instead_of != chosen.instead_of):
            continue
        name, other = (chosen.name, each.name or chosen.instead_of) if chosen.name else (each.instead_of, each.name)
        rival = Rival(each.fit.hypothesis.effect(other), each.fit, ratios[k])
        rivals[name] = (*rivals.get(name, ()), rival)
    return rivals
