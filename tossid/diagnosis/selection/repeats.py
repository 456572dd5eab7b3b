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
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from threading import Event

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.contradictions import PredictiveCheck
from tossid.diagnosis.localisation.gap import share_left
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator, draw_folds
from tossid.diagnosis.selection.plausibility import plausible_names
from tossid.diagnosis.selection.refinement import pruned_by_wald_test
from tossid.diagnosis.selection.saturation import with_saturated_effects
from tossid.diagnosis.selection.screening import screen
from tossid.diagnosis.selection.search import search
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.diagnosis.selection.stability import Repeat, Stability
from tossid.diagnosis.under_way import UnderWay
from tossid.physics.effects import Effect
from tossid.settings.diagnosis.diagnose import DiagnoseSettings, StabilitySettings
from tossid.types import Toss

CheckOf = Callable[[Sequence[Toss]], PredictiveCheck]
"""The check of a hypothesis by drawn tosses."""


def repeated(
    tosses: Sequence[Toss],
    validator: CrossValidator,
    found: SearchResult,
    library: Sequence[Effect],
    *,
    seed: int,
    check_of: CheckOf | None = None,
) -> Iterator[Stability]:
    """The search repeated, as often as the settings say.

    Args:
        tosses: That were searched.
        validator: Of all their windows.
        found: What the search found.
        library: The effects that it chose from.
        seed: Of all draws; repeats of a smaller number are the first of them.
        check_of: Makes the check of a hypothesis by drawn tosses; None for no check.

    Yields:
        What all repeats so far have found.
    """
    settings = validator.settings
    least = settings.verdict.partly_closed
    if not settings.repeats:
        return
    some = shortlist(validator, found, library, settings.stability.shortlist)
    if not some:  # no effect gains by a step, so that no repeat has anything to choose from
        yield Stability((Repeat((), 0.0),) * settings.repeats, least)
        return
    if not (found.begun_as_measured or found.refuted):
        check_of = None  # the first search stands, and its repeats take as long as it did
    stopped = Event()

    def unless_stopped(what: str, share: float) -> None:
        if stopped.is_set():
            raise InterruptedError(f"a repeat of the search was stopped: {what}")

    one = partial(
        _repeat,
        tosses,
        validator,
        found.first.hypothesis,
        some,
        len(library),
        check_of,
        UnderWay(progress=unless_stopped),
    )
    draws = np.random.default_rng([seed, 7]).spawn(settings.repeats)
    made: tuple[Repeat, ...] = ()
    for each in validator.each(one, draws, stopped.set):
        made = (*made, each)
        yield Stability(made, least)


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
    if found.other_causes is not None:
        chosen |= {*found.other_causes.candidate.hypothesis.names}
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
    validator: CrossValidator,
    nothing: Hypothesis,
    library: Sequence[Effect],
    whole: int,
    check_of: CheckOf | None,
    under_way: UnderWay,
    rng: np.random.Generator,
) -> Repeat:
    """One repeat.

    Args:
        tosses: That were searched.
        validator: Of all their windows.
        nothing: The hypothesis without effects, with the contact law that the tosses follow.
        library: The effects that may be named.
        whole: How many effects the library has from which these were chosen.
        check_of: As of `repeated`.
        under_way: Told what is done; it may end the repeat.
        rng: Of this repeat.
    """
    settings = _of_repeat(validator.settings, len(library) / whole, rng)
    n, length = validator.n, settings.likelihood.windows.length
    draw, folds = resampled(n, settings.cross_validation.folds, rng)
    drawn = [tosses[i] for i in draw]
    windows = make_windows(drawn, nothing.base.object, settings=settings.likelihood, shift=int(rng.integers(length)))
    own = replace(validator, windows=windows, folds=folds, n_threads=1, settings=settings)
    # (a copy counts as a toss of its own there, as it does in the windows)
    check = None if check_of is None else check_of([replace(x, name=f"{x.name}, {i}") for i, x in enumerate(drawn)])
    found = search(own, library, own.evaluate(nothing), under_way, check, law_is_known=True)
    found = with_saturated_effects(own, found)
    found, spread = pruned_by_wald_test(own, found, np.zeros(len(found.present.hypothesis.flat())))
    found, _ = plausible_names(own, found, spread)
    named = [(each, x) for each, x in found.present.hypothesis.items() if each.name not in found.unnamed]
    names = tuple(effect.name for effect, _ in named)
    closed = share_left(found.first, found.present, own, noise_floor(windows))[0].value if names else 0.0
    special = frozenset().union(*(effect.contains for effect, _ in named))
    values = {effect.name: effect.named(x) for effect, x in named}
    nameless = tuple(name for name in found.present.hypothesis.names if name in found.unnamed)
    return Repeat(names, closed, special, values, nameless)


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
