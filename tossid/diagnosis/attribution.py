"""Which effect, how far, and what cannot be told: the search's result, said.

Found effects with intervals and classes, the gap before and after, what is left and where, and for every effect that
was not found the smallest size that these tosses would have shown.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2
from scipy.stats import t as student

from tossid.diagnosis.engines import Engine
from tossid.diagnosis.evidence import Hypothesis, gains
from tossid.diagnosis.findings import Contact, Diagnosis, Finding, Gap, Interval, Share, Verdict
from tossid.diagnosis.fitting import Fitted, derivatives, toss_sums
from tossid.diagnosis.gap import Floor, measure_gap, noise_floor, rollout_errors, share_left
from tossid.diagnosis.judging import Candidate, Judge
from tossid.diagnosis.place import located
from tossid.diagnosis.rounds import CLASS_LEVEL
from tossid.diagnosis.search import Found, Search
from tossid.diagnosis.windows import FLIGHT_WEIGHT, LENGTH, make_windows
from tossid.diagnosis.witnesses import witnesses
from tossid.objects import ObjectModel
from tossid.physics.effects import LIBRARY, NEVER_NOTHING, OTHER_LAWS, POWER, Effect, World
from tossid.types import Phase, Toss

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

FLOOR_REACHED = 1.03
"""Times the noise floor, at which nothing is left to explain."""
MOST_CLOSED, ALL_CLOSED = 0.5, 0.9
"""Shares of the gap that effects have to close, to explain it in part; in full, if no phase has clearly some left."""
WALK = (0.4, 0.04)
"""Largest and smallest share of an effect by which it is moved,"""
WORTH_A_STEP = 3.0
"""and the gain of log-likelihood that is worth it."""
CUTS = ((LENGTH // 4, 1.0), (LENGTH // 2, -1.0), (3 * LENGTH // 4, 1.0))
"""Frames by which tosses are cut elsewhere, and to which side fits begin."""
ASIDE = 0.1
"""By how much fits begin elsewhere, over what a parameter differs from its nominal value,"""
ASIDE_IN_FLIGHT = 2.0
"""and, of what acts in flight, over its standard error."""


def diagnose(
    tosses: Sequence[Toss],
    world: World,
    *,
    library: Sequence[Effect] = LIBRARY,
    engine: Engine | None = None,
    n_threads: int = 1,
    seed: int = 0,
    unseen: Sequence[Toss] = (),
    progress: Progress | None = None,
) -> Diagnosis:
    """Where the world's predictions miss the tosses, which effects of the library explain it, and how far.

    Args:
        tosses: recorded motions of one object; poses' covariances are what noise is.
        world: the simulator that is asked about.
        library: effects to choose from.
        engine: the other engine, whose differences are no evidence; near-rigid MuJoCo if None.
        seed: of the folds and of the simulated noise floor.
        unseen: other tosses, on which rollouts are shown and nothing else.
        progress: told what is under way, and which share is done.
    """
    started = time.perf_counter()
    tell = progress or (lambda text, share: None)
    judge = Judge.of(tosses, world.object, seed=seed, n_threads=n_threads, engine=engine)
    tell("the gap", 0.02)
    judge, world = judge.with_contact(world)
    found = Search(judge, library, tell).run(Hypothesis(world))
    tell("farther away", 0.9)
    found = _walked(judge, found)
    tell("cut elsewhere", 0.92)
    found, spread = _cut_elsewhere(tosses, world.object, judge, found)
    found, spread = _without_nothings(judge, found, spread)
    tell("what is left", 0.97)
    return _report(tosses, unseen, library, judge, found, spread, started, seed)


def _walked(judge: Judge, found: Found) -> Found:
    """The search's result with each effect that contact has shown by one number looked for farther away.

    Contact makes the likelihood rough: a fit ends near where it began, far from where all tosses together suit an
    effect best. So its number is moved away from nothing and towards it, by less and less of what it is, wherever
    first states that are sought anew make that better.
    """
    present = found.present
    for effect in present.hypothesis.effects[found.flown :]:
        reach = WALK[0] if len(effect.parameters) == 1 else 0.0
        while reach > WALK[1]:
            for share in (1.0 + reach, 1.0 - reach):
                nothing, values = effect.nominal(present.hypothesis.base), present.hypothesis.values_of(effect.name)
                asked = present.hypothesis.with_instead(effect.name, effect, nothing + share * (values - nothing))
                there = judge.start(asked.at(np.clip(asked.flat(), *asked.bounds)))
                if judge.contest(there, present).sum() > WORTH_A_STEP:
                    present = there
                    break
            else:
                reach *= 0.5
    if present is found.present:
        return found
    return found.ending(judge.judged(present, found.present.effect, present.hypothesis))


def _cut_elsewhere(
    tosses: Sequence[Toss], model: ObjectModel, judge: Judge, found: Found
) -> tuple[Found, Array | None]:
    """The search's result at values that do not depend on where tosses are cut: medians of fits to several sets of
    windows, and their standard deviations (P,).

    Contact makes the likelihood rough, and where on it a fit ends hangs on where it began: each begins somewhere else,
    to either side of what was found. What flight has shown is near where it belongs: moved far away, it would be held
    there by first states in contact that suit it.
    """
    if not found.present.hypothesis.effects:
        return found, None
    present = found.present
    if not np.diag(present.fitted.H.sum(0)).all():
        # the search ended with what flight had shown held, which has no slopes then: here all of it may move
        present = judge.judged(present, present.effect, present.hypothesis, 0)
    flat = present.hypothesis.flat()
    nothing = np.concatenate([effect.nominal(present.hypothesis.base) for effect in present.hypothesis.effects])
    flies = [Phase.FLIGHT in effect.phases for effect in present.hypothesis.effects for _ in effect.parameters]
    error = np.sqrt(np.maximum(np.diag(present.fitted.covariance()), 0.0))
    way = np.where(flies, ASIDE_IN_FLIGHT * error, ASIDE * (flat - nothing))
    way *= np.random.default_rng(len(flat)).choice([-1.0, 1.0], len(flat))

    def fitted(cut: tuple[int, float]) -> Array:
        skip, side = cut
        other = replace(judge, windows=make_windows(tosses, model, skip=skip))
        start = present.hypothesis.at(np.clip(flat + side * way, *present.hypothesis.bounds))
        there = other.polished(other.start(start).evidence, start, 2)
        back = there.evidence.renewed(present.hypothesis.world(), refine=4)
        ll = back.log_likelihood(back.residual(present.hypothesis.world()), there.scales)
        ended = there.evidence.log_likelihood(there.residual, there.scales)
        if gains(ended, ll) @ there.evidence.windows.weights < 0:
            # it has ended in a worse place than where it was to come back to
            there = other.polished(back, present.hypothesis, 2)
        return there.hypothesis.flat()

    values = np.array([flat, *judge.each(fitted, CUTS)])
    middle = present.hypothesis.at(np.median(values, axis=0))
    settled = judge.judged(present, present.effect, middle, 0)
    if judge.better(present, settled) < CLASS_LEVEL:
        # parameters that make up for each other have medians that do not
        settled = present
    return found.ending(settled), np.std(values, axis=0, ddof=1)


def _without_nothings(judge: Judge, found: Found, spread: Array | None) -> tuple[Found, Array | None]:
    """Without effects of contact whose values are not clearly other than nothing (Wald's test, 5 %), the least clear
    first: they gained something where tosses were cut first, and not elsewhere."""
    while spread is not None and (name := _nothing(judge, found, spread)):
        hypothesis = found.present.hypothesis
        own = _place(hypothesis, name)
        found = replace(
            found.ending(judge.judged(found.present, None, hypothesis.minus(name))),
            needed={other: each for other, each in found.needed.items() if other != name},
            classes={other: group for other, group in found.classes.items() if other != name},
        )
        spread = np.delete(spread, own)
    return found, spread


def _nothing(judge: Judge, found: Found, spread: Array) -> str | None:
    """The effect that contact has shown and that is least clearly other than nothing; None if each is."""
    hypothesis = found.present.hypothesis
    cov = _covariance(found.present.fitted, judge.n, spread, found.flown)
    least, name = CLASS_LEVEL, None
    for effect in hypothesis.effects[found.flown :]:
        own = _place(hypothesis, effect.name)
        size = np.sqrt(np.diag(cov)[own])
        away = (hypothesis.values_of(effect.name) - effect.nominal(hypothesis.base)) / size
        alike = cov[own, own] / np.outer(size, size)
        p_value = float(chi2.sf(away @ np.linalg.pinv(alike, hermitian=True) @ away, len(away)))
        if effect.name not in NEVER_NOTHING and p_value > least:
            least, name = p_value, effect.name
    return name


def _place(hypothesis: Hypothesis, name: str) -> slice:
    """Where an effect's values are among all."""
    names = [effect.name for effect in hypothesis.effects for _ in effect.parameters]
    return slice(names.index(name), names.index(name) + names.count(name))


def intervals(fitted: Fitted, n: int, spread: Array | None = None, flown: int = 0) -> dict[str, dict[str, Interval]]:
    """95 % intervals of every effect's parameters: sandwich over tosses, Student's quantile.

    What flight has shown is told as well as flight tells it: contact, which could tell it better, leaves it where it is
    as often as it moves it to where it belongs.

    Args:
        flown: how many of the effects, the first, flight has shown.
        spread: (P,) standard deviations over where tosses were cut, one more source of error.
    """
    out: dict[str, dict[str, Interval]] = {}
    if not fitted.hypothesis.effects:
        return out
    error = np.sqrt(np.diag(_covariance(fitted, n, spread, flown)))
    quantile = float(student.ppf(0.975, max(1, n - len(error))))
    low, high = fitted.hypothesis.bounds
    k = 0
    for effect, values in zip(fitted.hypothesis.effects, fitted.hypothesis.values, strict=True):
        named = {}
        for parameter, value in zip(effect.parameters, values, strict=True):
            value = float(np.clip(value, low[k], high[k]))
            named[parameter.name] = Interval(value, value - quantile * error[k], value + quantile * error[k])
            k += 1
        out[effect.name] = named
    return out


def _covariance(fitted: Fitted, n: int, spread: Array | None, flown: int) -> Array:
    """(P, P) of all parameters, by every source of error that `intervals` names."""
    cov = fitted.covariance()
    variance = np.maximum(np.diag(cov), 0.0)
    first = sum(len(effect.parameters) for effect in fitted.hypothesis.effects[:flown])
    if first:
        variance[:first] = np.maximum(variance[:first], _in_flight(fitted, flown, n))
    if spread is not None:
        variance = variance + spread**2
    return cov + np.diag(variance - np.diag(cov))


def _in_flight(fitted: Fitted, flown: int, n: int) -> Array:
    """(P,) variances of the parameters of so many effects, the first, by the windows of free flight alone."""
    effects = fitted.hypothesis.effects[:flown]
    free = np.flatnonzero(fitted.evidence.windows.free)
    chosen = list(range(sum(len(effect.parameters) for effect in effects)))
    e, residual = fitted.evidence.rows(free), fitted.residual[free]
    J = derivatives(e, fitted.hypothesis, residual, chosen)[..., chosen]
    H, g = (each / FLIGHT_WEIGHT for each in toss_sums(e, residual, J, fitted.scales, n))
    flight = Fitted(
        Hypothesis(fitted.hypothesis.base, effects, fitted.hypothesis.values[:flown]), e, residual, fitted.scales, H, g
    )
    return np.maximum(np.diag(flight.covariance()), 0.0)


def _report(
    tosses: Sequence[Toss],
    unseen: Sequence[Toss],
    library: Sequence[Effect],
    judge: Judge,
    found: Found,
    spread: Array | None,
    started: float,
    seed: int,
) -> Diagnosis:
    n, first, present = judge.n, found.first, found.present
    begin = make_windows(unseen, first.hypothesis.base.object) if unseen else None
    floor = noise_floor(present, judge, seed=seed)
    gap = measure_gap(tosses, first, judge, floor)
    left = measure_gap(tosses, present, judge, floor) if present.hypothesis.effects else gap
    inside = [e.name for e in present.hypothesis.effects if e.name not in found.unnamed]
    named = tuple(sorted(inside, key=lambda name: -found.needed[name].total))
    closed, unexplained = share_left(first, present, judge, floor)
    closes = _closed_by_each(judge, found, floor)
    if found.unnamed:
        shares = [closes[name] for name in found.unnamed]
        other = Interval(
            *(max(0.0, sum(part)) for part in zip(*((s.value, s.low, s.high) for s in shares), strict=True))
        )
        closed = Interval(closed.value - other.value, closed.low - other.value, closed.high - other.value)
        if other.value > 0:
            unexplained = (Share("flight", other), *(share for share in unexplained if share.name != "flight"))
    return Diagnosis(
        verdict=whole_verdict(gap, left, closed, found.unnamed, unexplained, any_named=bool(named)),
        gap=gap,
        left=left,
        findings=_findings(library, judge, found, named, floor, spread, closes),
        named=named,
        gap_closed=closed,
        unexplained=unexplained,
        steps=tuple(rollout_errors(tosses, unseen, each, judge, begin) for each in found.history),
        hypothesis=present.hypothesis,
        n_tosses=n,
        seconds=time.perf_counter() - started,
        alternatives=found.swapped,
        contact=_contact(judge, found),
        other_laws=_other_laws(found, n),
        unsteady=found.unsteady,
        place=located(tosses, first, present, gap, left, seed=seed),
        witnesses=witnesses(unseen or tosses, first.hypothesis.world(), present.hypothesis.world()),
    )


def whole_verdict(
    gap: Gap, left: Gap, closed: Interval, unnamed: Collection[str], unexplained: Sequence[Share], *, any_named: bool
) -> Verdict:
    """What the named effects make of a gap. Nearly at the floor is not enough where the gap was small: more than half
    of it has to be closed too."""
    if not any_named:
        nothing = gap.total.value < 1.15 * gap.noise_floor or gap.total.low < gap.noise_floor
        return "no_gap" if nothing and not unnamed else "unexplained"
    if closed.value <= MOST_CLOSED:
        return "unexplained"
    reached = left.total.value < FLOOR_REACHED * left.noise_floor
    if not unnamed and (reached or (closed.value > ALL_CLOSED and not unexplained)):
        return "explained"
    return "partly_explained"


def _other_laws(found: Found, n: int) -> tuple[tuple[str, Interval], ...]:
    """Effects whose force has another law, and by what further power of its state it grows."""
    return tuple(
        (name, intervals(each.fitted, n)[OTHER_LAWS[name].name][POWER]) for name, each in found.other_laws.items()
    )


def _contact(judge: Judge, found: Found) -> Contact:
    if judge.engine.model is not None:
        return "own"
    return "relaxed" if found.first.hypothesis.base.law.lifting > 0 else "coulomb"


def _findings(
    library: Sequence[Effect],
    judge: Judge,
    found: Found,
    named: Sequence[str],
    floor: Floor,
    spread: Array | None,
    joined: Mapping[str, Interval],
) -> tuple[Finding, ...]:
    n, present = judge.n, found.present
    known = intervals(present.fitted, n, spread, found.flown)
    stands_for = {each.name: (name, each) for name, group in found.classes.items() for each in group}
    out = []
    for effect in library:
        alone = found.tried.get(effect.name)
        shown = alone or found.in_flight.get(effect.name)
        closes = joined.get(effect.name, Interval(0.0, 0.0, 0.0))
        if alone is not None and effect.name not in joined:
            closes = share_left(found.first, alone, judge, floor)[0]
        group: tuple[str, ...] = ()
        parameters: dict[str, Interval] = {}
        sizes, seen = _detectable(judge, present, effect)
        if effect.name in named:
            shown, parameters = found.needed[effect.name], known[effect.name]
            group = tuple(each.name for each in found.classes[effect.name])
            verdict = "confusable" if group else "identified"
        elif effect.name in stands_for:
            name, each = stands_for[effect.name]
            shown, parameters = each, intervals(each.fitted, n)[effect.name]
            closes = joined[name]
            group = (name, *(o.name for o in found.classes[name] if o.name != effect.name))
            verdict = "confusable"
        else:
            verdict = "not_supported" if seen else "not_identifiable"
        evidence = {
            "gain": 0.0 if shown is None else shown.total,
            "p_value": 1.0 if shown is None else shown.p_value,
            "n_tosses": float(n),
        }
        phases = tuple(Phase(phase).name.lower() for phase in effect.phases)
        out.append(
            Finding(effect.name, verdict, effect.says, phases, parameters, evidence, closes, group, sizes)  # type: ignore[arg-type]
        )
    rank = {"identified": 0, "confusable": 0, "not_supported": 2, "not_identifiable": 3}
    order = {name: i for i, name in enumerate(named)}

    def place(finding: Finding) -> tuple[float, float, bool, float]:
        leader = stands_for[finding.name][0] if finding.name in stands_for else finding.name
        return rank[finding.verdict], order.get(leader, n), finding.name not in order, -finding.evidence["gain"]

    out.sort(key=place)
    return tuple(out)


def _closed_by_each(judge: Judge, found: Found, floor: Floor) -> dict[str, Interval]:
    """Shares of the gap that each effect of the last hypothesis closed when it joined, beyond those before it; of what
    has taken the place of another that flight has shown, as much as that."""
    shares = [share_left(found.first, each, judge, floor)[0] for each in found.history[1:]]
    company = [{effect.name for effect in each.hypothesis.effects} for each in found.history[1:]]
    out, nothing = {}, Interval(0.0, 0.0, 0.0)
    for i, effect in enumerate(found.present.hypothesis.effects):
        k = i if i < found.flown else next(k for k, names in enumerate(company) if effect.name in names)
        less = (shares[k - 1] if k else nothing).value
        out[effect.name] = Interval(shares[k].value - less, shares[k].low - less, shares[k].high - less)
    return out


def _detectable(judge: Judge, present: Candidate, effect: Effect) -> tuple[dict[str, float], bool]:
    """Smallest size of each parameter that would have shown, and whether any of it lies within the plausible range."""
    hypothesis = present.hypothesis
    names = [other.name for other in hypothesis.effects]
    if effect.name not in names:
        hypothesis = hypothesis.plus(effect)
        names.append(effect.name)
    start = sum(len(other.parameters) for other in hypothesis.effects[: names.index(effect.name)])
    own = list(range(start, start + len(effect.parameters)))
    residual = present.fitted.residual
    J = derivatives(present.evidence, hypothesis, residual, own)[..., own]
    H, _ = toss_sums(present.evidence, residual, J, present.fitted.scales, judge.n)
    total = H.sum(0)
    sizes, seen = {}, False
    for i, parameter in enumerate(effect.parameters):
        if total[i, i] > 0:
            size = 4.0 * parameter.step / float(np.sqrt(total[i, i]))
            sizes[parameter.name] = size
            seen = seen or size < 0.5 * (parameter.high - parameter.low)
    return sizes, seen
