"""Which effects explain the gap between a simulator and tosses: the search, and all that is concluded from it."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.effect_findings import NOTHING, closed_by_each, effect_findings
from tossid.diagnosis.findings import FOUND, Finding, Interval, Share
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.consequence import consequences
from tossid.diagnosis.localisation.contradictions import (
    CheckByTosses,
    ask_tosses,
    contradicted_names,
    decided_by_witnesses,
)
from tossid.diagnosis.localisation.corners import locate
from tossid.diagnosis.localisation.disagreement import solver_disagreement
from tossid.diagnosis.localisation.gap import measure_gap, share_left
from tossid.diagnosis.localisation.misspecification import misspecification
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.localisation.refusal import check_rollouts
from tossid.diagnosis.localisation.rollouts import rollout_errors
from tossid.diagnosis.localisation.unseen import judge_unseen, unseen_windows
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.result import Contact, Diagnosis, Verdict
from tossid.diagnosis.selection.contact_law import under_other_impacts, with_contact_law
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.flight_search import power_law_of
from tossid.diagnosis.selection.nested import judged, judging_folds
from tossid.diagnosis.selection.plane import Plane, in_plane
from tossid.diagnosis.selection.plausibility import Implausible, implausible, plausible_names
from tossid.diagnosis.selection.refinement import (
    intervals,
    line_searched,
    pruned_by_wald_test,
    refitted_on_shifted_windows,
)
from tossid.diagnosis.selection.repeats import repeated
from tossid.diagnosis.selection.saturation import with_saturated_effects
from tossid.diagnosis.selection.screening import predicted_gain
from tossid.diagnosis.selection.search import search
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.diagnosis.selection.significance import TossesNeeded
from tossid.diagnosis.selection.stability import Stability
from tossid.diagnosis.verdict import gap_verdict, is_at_floor, names_that_stand, verdict_by_rollouts
from tossid.physics.effects import OTHER_POWER, Effect
from tossid.settings.diagnosis.diagnose import StabilitySettings, VerdictSettings
from tossid.types import Phase, Toss

Array = NDArray[np.float64]


def explain(problem: Problem) -> Diagnosis:
    """Where the world's predictions differ from the tosses, which effects of the library explain it, and how far.

    Args:
        problem: The tosses, the simulator and the effects to choose from.
    """
    started, searched = time.perf_counter(), search_once(problem)
    *_, made = searched.diagnosis, *searched.repeated()
    return replace(made, seconds=time.perf_counter() - started)


def begin(problem: Problem) -> tuple[CrossValidator, Candidate]:
    """The validator with the contact law that tosses follow most, and the gap without effects.

    Args:
        problem: The tosses, the simulator and the effects, of which the one that gains most to first order is the first
            suspect.
    """
    under_way = problem.under_way
    under_way("the gap", 0.02)
    validator, world = with_contact_law(problem.validator(), problem.world)
    first = validator.evaluate(Hypothesis(world))
    under_way.begun(problem.tosses, validator, first)
    gains = validator.map(partial(predicted_gain, validator, first), problem.library)
    under_way.suspected(list(zip(problem.library, gains, strict=True)))
    return validator, first


@dataclass(frozen=True)
class Searched:
    """What one search has found. How sure its names are is not known before it is repeated.

    Attributes:
        tosses: That were searched.
        library: The effects that their motions can show.
        validator: Of all windows.
        found: What was found.
        diagnosis: What is concluded from it.
        seed: Of all draws.
    """

    tosses: tuple[Toss, ...]
    library: tuple[Effect, ...]
    validator: CrossValidator
    found: SearchResult
    diagnosis: Diagnosis
    seed: int

    def repeated(self) -> Iterator[Diagnosis]:
        """The diagnosis with how often repeats of the search name each effect, after each of them."""
        world, settings = self.found.first.hypothesis.world(), self.validator.settings
        for stability in repeated(
            self.tosses,
            self.validator,
            self.found,
            self.library,
            check_of=lambda tosses: CheckByTosses(tosses, world, self.validator),
            seed=self.seed,
        ):
            yield with_repeats(self.diagnosis, stability, settings.stability, settings.verdict)


def search_once(problem: Problem) -> Searched:
    """The effects that explain a gap, by one search, and all that is concluded from them.

    Args:
        problem: The tosses, the simulator and the effects to choose from.
    """
    started, tosses, under_way = time.perf_counter(), problem.tosses, problem.under_way
    validator, first = begin(problem)
    world = first.hypothesis.base
    shown, plane = in_plane(tosses, world, problem.library, settings=problem.settings, n_threads=problem.n_threads)
    check = CheckByTosses(tosses, world, validator)
    searched = partial(search, validator, shown, under_way=under_way, check=check)
    found = searched(first)
    other = under_other_impacts(validator, found.present)
    if other is not None:
        found = searched(validator.evaluate(Hypothesis(other.hypothesis.base)), law_is_known=True)
    found = decided_by_witnesses(found, validator, check.witnesses)
    under_way("line search", 0.85)
    found = with_saturated_effects(validator, line_searched(validator, found))
    under_way("shifted windows", 0.87)
    found, spread = refitted_on_shifted_windows(tosses, world.object, validator, found)
    found, spread = pruned_by_wald_test(validator, found, spread)
    found, why = plausible_names(validator, found, spread)
    under_way("what is left", 0.9)
    made = _concluded(tosses, problem.unseen, shown, validator, found, spread, why, started, problem.seed)
    made = made if plane is None else _with_plane(made, plane, problem.library)
    return Searched(tuple(tosses), tuple(shown), validator, found, made, problem.seed)


def with_repeats(
    made: Diagnosis,
    stability: Stability,
    settings: StabilitySettings = StabilitySettings(),
    limits: VerdictSettings = VerdictSettings(),
) -> Diagnosis:
    """A diagnosis whose effects are candidates where repeats of the search name them too rarely.

    Intervals are no narrower than the values of repeats scatter. What they may then be no change of is a candidate too.

    Args:
        made: Of one search.
        stability: What repeats name.
        settings: How often is often enough.
        limits: Of verdicts.
    """
    if not stability.repeats:
        return replace(made, stability=stability)
    base = made.hypothesis.base

    effects = {effect.name: effect for effect in made.hypothesis.effects}
    confusable = {each.name: each.confusable_with for each in made.findings}
    widened = {
        each.name: stability.widened(effects[each.name], each.parameters, [*effects], settings.fewest_values)
        for each in made.findings
        if each.name in effects and each.parameters and not each.saturated
    }

    def is_sure(name: str) -> bool:
        frequency = stability.frequency([name, *confusable.get(name, ())])
        frequent = frequency is None or frequency >= settings.least_frequency
        return frequent and (name not in widened or implausible(effects[name], widened[name], base) is None)

    unsure = {name for name in (*made.named, *made.candidates, *made.minor) if not is_sure(name)}
    unsure |= {each for name in unsure for each in confusable.get(name, ()) if each not in made.named}
    named = tuple(name for name in made.named if name not in unsure)
    findings = tuple(
        replace(
            each,
            frequency=stability.frequency([each.name]),
            parameters=widened.get(each.name, each.parameters),
            verdict="candidate" if each.name in unsure and each.verdict in FOUND else each.verdict,
        )
        for each in made.findings
    )
    return replace(
        made,
        verdict=_without_names(made, stability, limits) if not named else made.verdict,
        findings=findings,
        named=named,
        candidates=(*made.candidates, *(name for name in made.named if name in unsure)),
        stability=stability,
    )


def _without_names(made: Diagnosis, stability: Stability, limits: VerdictSettings) -> Verdict:
    """A diagnosis's verdict where repeats leave no name.

    Candidates explain a part if they close much of a gap. Where there is hardly any gap, chance may have named them.
    """
    if made.verdict not in ("explained", "partly_explained"):
        return made.verdict
    if is_at_floor(made.gap, limits) and {*made.hypothesis.names} <= {*made.named, *made.candidates, *made.minor}:
        return "no_gap"
    return "partly_explained" if made.gap_closed.value > stability.least_closed else "unexplained"


def _concluded(
    tosses: Sequence[Toss],
    unseen: Sequence[Toss],
    library: Sequence[Effect],
    validator: CrossValidator,
    found: SearchResult,
    spread: Array | None,
    why: Mapping[str, Implausible],
    started: float,
    seed: int,
) -> Diagnosis:
    """Everything that is said of what the search found."""
    folds = judging_folds(validator, found)
    found = judged(validator, found, folds)
    n, first, present, settings = validator.n, found.first, found.present, validator.settings
    theirs = unseen_windows(unseen, tosses, first.hypothesis.base.object, validator) if unseen else None
    on_unseen = None if theirs is None else judge_unseen(theirs, first.hypothesis, present.hypothesis, validator)
    floor = noise_floor(validator.windows)
    gap = measure_gap(tosses, first, validator, floor)
    left = measure_gap(tosses, present, validator, floor) if present.hypothesis.effects else gap
    closed, unexplained = share_left(first, present, validator, floor)
    closes = closed_by_each(validator, found, floor)
    consequence = consequences(tosses, validator, found, closes)
    inside = [name for name in present.hypothesis.names if name not in found.unnamed]
    inside.sort(key=lambda name: -found.needed[name].total)
    mattering = [name for name in inside if consequence[name].matters]
    if found.unnamed:
        unnamed = [(each, closes[each.name]) for each in present.hypothesis.effects if each.name in found.unnamed]
        closed, unexplained = _without_unnamed(closed, unexplained, unnamed)
    # what may be no change at all is no sign of something without a name
    nameless = [name for name in found.unnamed if why.get(name) != "no_change"]
    verdict = gap_verdict(
        gap, left, closed, nameless, unexplained, any_named=bool(mattering), settings=settings.verdict
    )
    # a user's simulator is its own solver
    disagreement, misspecified = validator.together(
        lambda: None if validator.engine.of_user else solver_disagreement(present, validator, seed=seed),
        lambda: misspecification(present, validator, floor, seed=seed),
    )
    small = disagreement is not None and left.total.value <= disagreement.gap
    within = disagreement is not None and left.total.low <= disagreement.gap and closed.low > 0
    # solvers agree in flight, so they do not explain an effect that was found there without a name
    if verdict == "unexplained" and small and not (mattering or nameless):
        verdict = "within_solver_disagreement"
    verdict, standing = names_that_stand(verdict, mattering, found, validator, floor, within_disagreement=within)
    sure = [name for name in mattering if name in standing]
    rollouts = check_rollouts(tosses, unseen, validator, first.hypothesis, present.hypothesis, inside, folds, theirs)
    refused = frozenset() if rollouts is None else frozenset(rollouts.refused)
    verdict = verdict_by_rollouts(verdict, rollouts, sure)
    said = ask_tosses(unseen or tosses, first.hypothesis.world(), present.hypothesis.world(), validator, theirs)
    contradicted = frozenset() if verdict == "explained" else contradicted_names(said, inside)
    if verdict == "partly_explained" and not set(sure) - contradicted:
        verdict = "unexplained"
    candidates = {*inside} - standing | refused | contradicted
    place, steps = validator.together(
        lambda: locate(tosses, first, present, gap, left, seed=seed, settings=settings),
        lambda: [
            rollout_errors(tosses, unseen, each, validator, theirs, folds if each is present else ())
            for each in found.history
        ],
    )
    return Diagnosis(
        verdict=verdict,
        gap=gap,
        left=left,
        findings=effect_findings(library, validator, found, inside, floor, spread, closes, consequence, candidates),
        named=tuple(name for name in mattering if name not in candidates),
        candidates=tuple(name for name in mattering if name in candidates),
        minor=tuple(name for name in inside if name not in mattering),
        stability=Stability(least_closed=settings.verdict.partly_closed),
        implausible=tuple(why.items()),
        disagreement=disagreement,
        gap_closed=closed,
        unexplained=unexplained,
        steps=tuple(steps),
        unseen=on_unseen,
        rollouts=rollouts,
        refuted=found.refuted,
        hypothesis=present.hypothesis,
        n_tosses=n,
        seconds=time.perf_counter() - started,
        alternatives=found.alternatives,
        exchanged=found.exchanged,
        contact=_contact(validator, found),
        other_laws=tuple(
            (name, intervals(each.fitted, n)[power_law_of(each, name).name][OTHER_POWER])
            for name, each in found.other_laws.items()
        ),
        unsteady=found.unsteady,
        needed=_needed(library, validator),
        noise=floor.noise,
        misspecification=misspecified,
        place=place,
        witnesses=said,
    )


def _with_plane(made: Diagnosis, plane: Plane, library: Sequence[Effect]) -> Diagnosis:
    """With the effects that the plane of the motion cannot show, which were not fitted."""
    evidence = {"gain": 0.0, "p_value": 1.0, "n_tosses": float(made.n_tosses)}
    hidden = tuple(
        Finding(
            effect.name,
            "not_identifiable",
            effect.says,
            tuple(Phase(phase).name.lower() for phase in effect.phases),
            {},
            evidence,
            NOTHING,
        )
        for effect in library
        if effect.name in plane.effects
    )
    return replace(made, plane=plane, findings=(*made.findings, *hidden))


def _needed(library: Sequence[Effect], validator: CrossValidator) -> TossesNeeded:
    """How many tosses a name needs, and how many there are."""
    windows = validator.windows
    flights, level = len(np.unique(windows.toss[windows.free])), validator.settings.selection.level
    return TossesNeeded.of(library, level, tosses=validator.n, flights=flights)


def _without_unnamed(
    closed: Interval, unexplained: tuple[Share, ...], unnamed: Sequence[tuple[Effect, Interval]]
) -> tuple[Interval, tuple[Share, ...]]:
    """What named effects close, and phases with some left, given the shares that effects without a name close."""

    def total(shares: Sequence[Interval]) -> Interval:
        ends = zip(*((s.value, s.low, s.high) for s in shares), strict=True)
        return Interval(*(max(0.0, sum(part)) for part in ends))

    whole = total([share for _, share in unnamed]).value
    closed = Interval(closed.value - whole, closed.low - whole, closed.high - whole)
    flying = [share for effect, share in unnamed if Phase.FLIGHT in effect.phases]
    if flying and (there := total(flying)).value > 0:
        others = (share for share in unexplained if share.name != "flight")
        unexplained = (Share("flight", there), *others)
    return closed, unexplained


def _contact(validator: CrossValidator, found: SearchResult) -> Contact:
    """The contact law that the tosses follow most."""
    if validator.engine.of_user:
        return "own"
    law = found.first.hypothesis.base.law
    return "relaxed" if law.lifting > 0 else "routh" if law.impulse_parts > 1 else "coulomb"
