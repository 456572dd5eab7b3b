"""Which effect, how far, and what cannot be told: the search's result, said.

Found effects with intervals and classes, the gap before and after, what is left and where, and for every effect that
was not found the smallest size that these tosses would have shown.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.engines import Engine
from tossid.diagnosis.evidence import Hypothesis
from tossid.diagnosis.findings import Contact, Diagnosis, Finding, Gap, Interval, Share, Verdict
from tossid.diagnosis.fitting import derivatives, toss_sums
from tossid.diagnosis.gap import Floor, measure_gap, noise_floor, rollout_errors, share_left
from tossid.diagnosis.judging import Candidate, Judge
from tossid.diagnosis.place import located
from tossid.diagnosis.search import Found, Search
from tossid.diagnosis.settling import cut_elsewhere, intervals, walked, without_nothings
from tossid.diagnosis.windows import make_windows
from tossid.diagnosis.witnesses import witnesses
from tossid.physics.effects import LIBRARY, OTHER_LAWS, POWER, Effect, World
from tossid.types import Phase, Toss

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

FLOOR_REACHED = 1.03
"""Times the noise floor, at which nothing is left to explain."""
MOST_CLOSED, ALL_CLOSED = 0.5, 0.9
"""Shares of the gap that effects have to close, to explain it in part; in full, if no phase has clearly some left."""


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
    found = walked(judge, found)
    tell("cut elsewhere", 0.92)
    found, spread = cut_elsewhere(tosses, world.object, judge, found)
    found, spread = without_nothings(judge, found, spread)
    tell("what is left", 0.97)
    return _report(tosses, unseen, library, judge, found, spread, started, seed)


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
    if effect.name not in [other.name for other in hypothesis.effects]:
        hypothesis = hypothesis.plus(effect)
    place = hypothesis.place_of(effect.name)
    own = list(range(place.start, place.stop))
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
