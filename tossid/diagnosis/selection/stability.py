"""How sure a name is: the search, repeated over resampled tosses and other windows.

Significance says that an effect gains. It does not say that no other effect would have been named, had other tosses of
the same kind been recorded. So the search is repeated. Each repeat draws as many tosses with replacement, draws the
folds anew, and cuts the tosses into windows of another length that begin elsewhere, so that all first states and all
starts of fits are others. An effect's frequency is the share of the repeats that name it.

A repeat looks for the effects with which a step gains most, alone or beside what was found, and for those that the
search fitted. That is all that saves time: what it fits, prunes and compares is fitted to its own tosses and windows.

A toss that is drawn twice counts twice, but both copies are in one fold, so that no fit sees what judges it. Tests on
resampled data are more lenient than on the data (Janitza, Binder and Boulesteix, Biometrical Journal 2016). So
frequencies add to the search's own tests, and do not replace them.

Each repeat has its own values, too. Where they scatter more than the interval of the search says, the interval is as
wide as their scatter: what depends on the length of windows or on their first frames is not known better.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.gap import share_left
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator, draw_folds
from tossid.diagnosis.selection.plausibility import plausible_names
from tossid.diagnosis.selection.refinement import pruned_by_wald_test
from tossid.diagnosis.selection.saturation import with_saturated_effects
from tossid.diagnosis.selection.screening import screen
from tossid.diagnosis.selection.search import search
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.diagnosis.under_way import UnderWay
from tossid.objects import ObjectModel
from tossid.physics.effects import Effect, World
from tossid.settings.diagnosis.diagnose import DiagnoseSettings, StabilitySettings
from tossid.types import Toss

MeasuredOf = Callable[[Sequence[Toss], World], dict[str, float]]
"""What tosses say by themselves of the effects whose values in a world they contradict, by name."""


_NORMAL = 1.96
"""Standard deviations of a normal distribution either side of its mean that hold 95 % of it."""


def _nothing_measured(tosses: Sequence[Toss], at: World) -> dict[str, float]:
    return {}


@dataclass(frozen=True)
class Repeat:
    """What one repeat of the search found.

    Attributes:
        names: Of the effects that it named, in the order in which they joined.
        closed: Share of the gap that they close on its tosses.
        special: Names of special cases of these effects.
        parameters: Of each of these effects, as it was fitted to its tosses.
    """

    names: tuple[str, ...]
    closed: float
    special: frozenset[str] = frozenset()
    parameters: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """An entry of gap.json's "explanation.repeated"."""
        return {"effects": {name: dict(self.parameters.get(name, {})) for name in self.names}, "closed": self.closed}


@dataclass(frozen=True)
class Stability:
    """What all repeats found.

    Attributes:
        repeats: Each of them; none if none were asked for.
        least_closed: Share of the gap below which a repeat's names explain nothing.
    """

    repeats: tuple[Repeat, ...] = ()
    least_closed: float = 0.5

    def frequency(self, names: Collection[str]) -> float | None:
        """The share of repeats that name at least one of some effects; None without repeats.

        A repeat that names what contains an effect names that effect too. Resampled tosses favour the more general of
        two effects, as they are alike.

        Args:
            names: Of an effect, or of all of a confusable class.
        """
        if not self.repeats:
            return None
        named = [not set(names).isdisjoint({*each.names, *each.special}) for each in self.repeats]
        return sum(named) / len(named)

    def scatter(self, name: str, fewest: int) -> dict[str, float]:
        """1.96 standard deviations of an effect's values over the repeats, by parameter; none if too few name it.

        Args:
            name: Of the effect.
            fewest: How many repeats must name it.
        """
        values = [each.parameters[name] for each in self.repeats if name in each.parameters]
        if len(values) < fewest:
            return {}
        return {key: _NORMAL * float(np.std([each[key] for each in values], ddof=1)) for key in values[0]}

    def widened(self, effect: Effect, known: Mapping[str, Interval], fewest: int) -> dict[str, Interval]:
        """An effect's 95 % intervals, no narrower than its values scatter over the repeats.

        Args:
            effect: The effect.
            known: Its intervals, by parameter.
            fewest: How many repeats must name it.
        """
        out, scatter = dict(known), self.scatter(effect.name, fewest)
        for parameter in effect.parameters if scatter else ():
            own, half = known[parameter.name], scatter[parameter.name]
            low, high = np.clip([own.value - half, own.value + half], parameter.low, parameter.high)
            out[parameter.name] = Interval(own.value, min(own.low, float(low)), max(own.high, float(high)))
        return out

    @property
    def probability_none(self) -> float | None:
        """The share of repeats in which no effect of the library explains the gap; None without repeats.

        Either nothing is named, or what is named closes less than a share of it.
        """
        if not self.repeats:
            return None
        return sum(not each.names or each.closed < self.least_closed for each in self.repeats) / len(self.repeats)


def repeated(
    tosses: Sequence[Toss],
    model: ObjectModel,
    validator: CrossValidator,
    found: SearchResult,
    library: Sequence[Effect],
    *,
    seed: int,
    measured: MeasuredOf = _nothing_measured,
) -> Stability:
    """The search repeated, as often as the settings say.

    Args:
        tosses: That were searched.
        model: Their object.
        validator: Of all their windows.
        found: What the search found.
        library: The effects that it chose from.
        seed: Of all draws; repeats of a smaller number are the first of them.
        measured: What drawn tosses say by themselves.
    """
    settings = validator.settings
    least = settings.verdict.partly_closed
    if not settings.repeats:
        return Stability(least_closed=least)
    some = shortlist(validator, found, library, settings.stability.shortlist)
    if not some:  # no effect gains by a step, so that no repeat has anything to choose from
        return Stability((Repeat((), 0.0),) * settings.repeats, least)
    if not found.begun_as_measured:
        measured = _nothing_measured  # the first search stands, and its repeats take as long as it did
    one = partial(_repeat, tosses, model, validator, found.first.hypothesis, some, len(library), measured)
    draws = np.random.default_rng([seed, 7]).spawn(settings.repeats)
    return Stability(tuple(validator.map(one, draws)), least)


def shortlist(
    validator: CrossValidator, found: SearchResult, library: Sequence[Effect], count: int
) -> tuple[Effect, ...]:
    """The effects that a repeat may name: those that gain most by a step, and those that the search has fitted.

    Args:
        validator: Of all windows.
        found: What the search found.
        library: The effects that it chose from.
        count: How many gain most, without effects and beside those that were found.
    """
    chosen = {*found.first_round, *found.flight_round, *found.needed, *found.present.hypothesis.names}
    chosen |= {each.name for group in found.classes.values() for each in group}
    begin = {id(each): each for each in (found.first, found.present)}
    for present in begin.values():
        chosen |= set(_most_promising(validator, present, library, count))
    return tuple(effect for effect in library if effect.name in chosen)


def _most_promising(validator: CrossValidator, present: Candidate, library: Sequence[Effect], count: int) -> list[str]:
    """Names of the effects that gain most by one step from a hypothesis."""
    missing = [effect for effect in library if effect.name not in present.hypothesis.names]
    screened = validator.map(partial(screen, validator, present), missing)
    gaining = [each for each in screened if each.gain > validator.settings.selection.least_screening_gain]
    gaining.sort(key=lambda each: -each.gain)
    return [each.effect.name for each in gaining[:count]]


def _repeat(
    tosses: Sequence[Toss],
    model: ObjectModel,
    validator: CrossValidator,
    nothing: Hypothesis,
    library: Sequence[Effect],
    whole: int,
    measured: MeasuredOf,
    rng: np.random.Generator,
) -> Repeat:
    """One repeat.

    Args:
        tosses: That were searched.
        model: Their object.
        validator: Of all their windows.
        nothing: The hypothesis without effects, with the contact law that the tosses follow.
        library: The effects that may be named.
        whole: How many effects the library has from which these were chosen.
        measured: What drawn tosses say by themselves, as of `repeated`.
        rng: Of this repeat.
    """
    settings = _of_repeat(validator.settings, len(library) / whole, rng)
    n, length = validator.n, settings.likelihood.windows.length
    draw, folds = resampled(n, settings.cross_validation.folds, rng)
    drawn = [tosses[i] for i in draw]
    windows = make_windows(drawn, model, settings=settings.likelihood, shift=int(rng.integers(length)))
    own = replace(validator, windows=windows, folds=folds, n_threads=1, settings=settings)
    found = search(own, library, own.evaluate(nothing), UnderWay(), partial(measured, drawn), law_is_known=True)
    found = with_saturated_effects(own, found)
    found, spread = pruned_by_wald_test(own, found, np.zeros(len(found.present.hypothesis.flat())))
    found, _ = plausible_names(own, found, spread)
    named = [(each, x) for each, x in found.present.hypothesis.items() if each.name not in found.unnamed]
    names = tuple(effect.name for effect, _ in named)
    closed = share_left(found.first, found.present, own, noise_floor(windows))[0].value if names else 0.0
    special = frozenset().union(*(effect.contains for effect, _ in named))
    return Repeat(names, closed, special, {effect.name: effect.named(x) for effect, x in named})


def _of_repeat(settings: DiagnoseSettings, share: float, rng: np.random.Generator) -> DiagnoseSettings:
    """The settings of a repeat: windows of another length, fewer refits, and each test at the level of the search.

    Tests divide their level by the effects of a library. That of a repeat has fewer.
    """
    stability: StabilitySettings = settings.stability
    factor = float(rng.choice(stability.lengths))
    cut = settings.likelihood.windows
    return replace(
        settings,
        likelihood=replace(
            settings.likelihood,
            windows=replace(cut, length=max(2, round(factor * cut.length)), long=round(factor * cut.long)),
        ),
        selection=replace(
            settings.selection,
            level=share * settings.selection.level,
            most_joint_refits=min(stability.most_joint_refits, settings.selection.most_joint_refits),
            most_replacements=min(stability.most_replacements, settings.selection.most_replacements),
        ),
        cross_validation=replace(settings.cross_validation, refits=1),
    )


def resampled(n: int, folds: int, rng: np.random.Generator) -> tuple[NDArray[np.int64], tuple[NDArray[np.bool_], ...]]:
    """Tosses drawn with replacement, and folds that have all copies of a toss or none.

    Args:
        n: How many tosses.
        folds: How many folds, at most.
        rng: For the draws.

    Returns:
        (n,) the numbers of the drawn tosses, in order, and (n,) each fold that has any of them.
    """
    draw = np.sort(rng.integers(0, n, n))
    kinds, number = np.unique(draw, return_inverse=True)
    return draw, tuple(held[number] for held in draw_folds(len(kinds), rng, folds))
