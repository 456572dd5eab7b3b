"""A diagnosis of tosses in which effects change over the order of recording.

An error of the recording that changes is found first, stretch by stretch, and the tosses are corrected for it:
otherwise the search for effects that are the same in all tosses would have to explain it by some. What changes and
cannot be undone is looked for once more beside what the search has found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.explain import search_once
from tossid.diagnosis.findings import (
    ChangeLeft,
    Consequence,
    Finding,
    Gap,
    Interval,
    OverOrder,
    Share,
    Step,
    Stretch,
)
from tossid.diagnosis.likelihood.engine_discrepancy import Engine
from tossid.diagnosis.localisation.consequence import changed, matters, whole_motions
from tossid.diagnosis.localisation.gap import PHASES, bootstrap_ratio, by_toss, deviance, measure_gap
from tossid.diagnosis.localisation.noise import Floor
from tossid.diagnosis.localisation.rollouts import first_states, rollout_errors
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.result import Diagnosis
from tossid.diagnosis.selection.cross_validation import Candidate
from tossid.diagnosis.sessions.heights import ending_at_origin
from tossid.diagnosis.sessions.looking import Corrections, Looked, TossOrder, look, undo_changes
from tossid.diagnosis.sessions.stretches import EffectOverOrder
from tossid.diagnosis.under_way import UnderWay
from tossid.diagnosis.verdict import gap_verdict, verdict_by_rollouts
from tossid.motion.sessions.change_points import fewest_items
from tossid.physics.effects import Effect
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.types import Phase, Toss

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Explained:
    """A diagnosis, and the tosses that it is of.

    Attributes:
        diagnosis: Of the recorded tosses.
        tosses: Corrected for what changes in their recording.
        unseen: Others, likewise.
        repeats: Repeats the search, and makes the diagnosis anew after each, with how often they name each effect.
    """

    diagnosis: Diagnosis
    tosses: tuple[Toss, ...]
    unseen: tuple[Toss, ...]
    repeats: Callable[[], Iterator[Diagnosis]]

    def repeated(self, under_way: UnderWay | None = None) -> Explained:
        """With how often repeats of the search name each effect.

        Args:
            under_way: Told what is concluded from the search, and after each repeat.
        """
        under_way, made = under_way or UnderWay(), self.diagnosis
        under_way.answered(made)
        for made in self.repeats():
            under_way.answered(made)
        return replace(self, diagnosis=made)


def explain_over_order(problem: Problem) -> Explained:
    """As `explain`, where effects may change over the order of recording. The search is not repeated before asked for.

    Args:
        problem: The tosses, the simulator and the effects to choose from.
    """
    problem = problem.in_order()
    recorded, library, settings = tuple(problem.tosses), problem.library, problem.settings
    if len(recorded) < fewest_over_order(library, settings):
        found = search_once(problem)
        of_these = partial(_of_tosses, tosses=recorded)
        unseen = tuple(problem.unseen)
        return Explained(of_these(found.diagnosis), recorded, unseen, lambda: map(of_these, found.repeated()))
    first, _, corrections = undo_changes(problem)
    found = search_once(problem.of(corrections.tosses, corrections.unseen))
    looked = _beside(found.diagnosis, corrections, problem)
    if looked.correctable and len(corrections.undone) < settings.order.rounds:
        corrections = corrections.further(looked, TossOrder.of(problem))
        found = search_once(problem.of(corrections.tosses, corrections.unseen))
        looked = _beside(found.diagnosis, corrections, problem)
    now, undone = corrections.tosses, corrections.undone
    varies = None if looked.effect is None or looked.correctable else looked

    def over_all(made: Diagnosis) -> Diagnosis:
        made = replace(_of_tosses(made, recorded), changes_left=_left(looked, recorded))
        return _with(made, recorded, now, first, undone, varies, settings) if undone or varies is not None else made

    return Explained(over_all(found.diagnosis), now, corrections.unseen, lambda: map(over_all, found.repeated()))


def fewest_over_order(library: Sequence[Effect], settings: DiagnoseSettings) -> int:
    """How many tosses it takes for a change of an effect, or of the size of the gap, to be seen at all.

    Args:
        library: The effects.
        settings: Of the diagnosis.
    """
    return fewest_items(len(library) + 1, settings.order.changes)


def _beside(found: Diagnosis, corrections: Corrections, problem: Problem) -> Looked:
    """What changes over the order beside what the search has found."""
    # (a force that depends on place needs the tosses where they were)
    own_heights = problem.own_heights and not any(effect.of_place for effect in found.hypothesis.effects)
    problem = replace(problem.of(corrections.tosses), world=found.hypothesis.base, own_heights=own_heights)
    validator = problem.validator(over_order=True)
    if found.contact != "own":
        validator = replace(validator, engine=Engine())
    present = validator.evaluate(found.hypothesis)
    return look(validator, present, problem, order=TossOrder.of(problem), undone=corrections.effects_undone)


def _of_tosses(found: Diagnosis, tosses: Sequence[Toss]) -> Diagnosis:
    """With the names of the tosses, and where they end."""
    names, places = tuple(toss.name for toss in tosses), np.array([toss.q[-1, :2] for toss in tosses])
    return replace(found, tosses=names, places=places)


def _left(looked: Looked, tosses: Sequence[Toss]) -> tuple[ChangeLeft, ...]:
    return tuple(ChangeLeft(tosses[change.at].name, dict(change.p)) for change in looked.changes)


# ---------------------------------------------------------------- what is said of it


def _with(
    found: Diagnosis,
    recorded: Sequence[Toss],
    now: Sequence[Toss],
    first: Looked,
    undone: Sequence[tuple[EffectOverOrder, Looked]],
    varies: Looked | None,
    settings: DiagnoseSettings,
) -> Diagnosis:
    """A diagnosis of corrected tosses as one of the recorded ones, with the effects that change over their order."""
    n = len(recorded)
    gap = found.gap
    if undone:
        # (tosses of a session are no odd ones)
        gap = replace(measure_gap(recorded, first.present, first.validator, first.floor), odd=found.gap.odd)
    whole = excess_of_tosses(gap, n)
    sums = [excess_of_tosses_of(each.present, each.floor, n) for _, each in undone]
    sums.append(excess_of_tosses(found.gap, n))
    left, further = found.left, np.zeros(n)
    if varies is not None:
        left, further = _left_with(varies, now, found, n)
    share = partial(bootstrap_ratio, below=whole, resamples=settings.localisation.resamples)
    closes = {
        each.effect.name: share(before - after)
        for (each, _), before, after in zip(undone, sums[:-1], sums[1:], strict=True)
    }
    findings = [_finding(each, at, closes, recorded, found, settings) for each, at in undone]
    ratio = float(sums[-1].sum() / whole.sum()) if whole.sum() > 0 else 1.0
    others = [replace(f, gap_closed=_scaled(f.gap_closed, ratio)) for f in found.findings]
    if varies is not None and varies.effect is not None:
        closes[varies.effect.effect.name] = share(further)
        findings.append(_finding(varies.effect, varies, closes, now, found, settings))
    new = {finding.name for finding in findings}
    named = (*(f.name for f in findings if f.headline), *(name for name in found.named if name not in new))
    candidates = tuple(name for name in found.candidates if name not in new)
    closed = (
        share(whole - (excess_of_tosses(found.left, n) - further)) if named or candidates else Interval(0.0, 0.0, 0.0)
    )
    closed = Interval(*(min(1.0, x) for x in (closed.value, closed.low, closed.high)))
    unexplained = _phases_left(left, whole, settings)
    nameless = [*(name for name, _ in found.other_laws), *found.unsteady]
    nameless += [name for name, why in found.implausible if why != "no_change"]
    verdict = gap_verdict(
        gap, left, closed, nameless, unexplained, any_named=bool(named or candidates), settings=settings.verdict
    )
    if verdict == "unexplained" and found.verdict == "partly_explained" and found.named:
        verdict = found.verdict  # forces that flight makes sure, however much contact leaves
    verdict = verdict_by_rollouts(verdict, found.rollouts, (*named, *candidates))
    return replace(
        found,
        verdict=verdict,
        gap=gap,
        left=left,
        findings=(*findings, *(f for f in others if f.name not in new)),
        named=named,
        candidates=candidates,
        minor=(*(f.name for f in findings if not f.headline), *(name for name in found.minor if name not in new)),
        gap_closed=closed,
        unexplained=unexplained,
        steps=_steps(found, recorded, first, undone),
    )


def excess_of_tosses(gap: Gap, n: int) -> Array:
    """(n,) deviance of each toss above the noise floor, mean over channels, summed over rows.

    Args:
        gap: Of n tosses.
        n: How many.
    """
    return np.bincount(gap.frames[:, 0].astype(int), weights=gap.frames[:, 3], minlength=n).astype(float)


def excess_of_tosses_of(state: Candidate, floor: Floor, n: int) -> Array:
    """As `excess_of_tosses`, of a hypothesis as it was fitted.

    Args:
        state: The hypothesis.
        floor: The noise floor.
        n: How many tosses.
    """
    return by_toss(state.evidence, (deviance(state.evidence, state.fitted.residuals) - floor.deviance).mean(-1), n)


def _left_with(varies: Looked, now: Sequence[Toss], found: Diagnosis, n: int) -> tuple[Gap, Array]:
    """The gap that is left with an effect at its value in each stretch, and by how much less that is in each toss."""
    assert varies.effect is not None
    residuals, toss = varies.present.fitted.residuals.copy(), varies.present.evidence.windows.toss
    for k, one in enumerate(varies.effect.fitted):
        residuals[(toss >= varies.effect.edges[k]) & (toss < varies.effect.edges[k + 1])] = one.residuals
    with_it = replace(varies.present, judged=residuals)
    left = measure_gap(now, with_it, varies.validator, varies.floor)
    before = excess_of_tosses_of(varies.present, varies.floor, n)
    return replace(left, by_length=found.left.by_length), before - excess_of_tosses(left, n)


def _phases_left(left: Gap, whole: Array, settings: DiagnoseSettings) -> tuple[Share, ...]:
    """Phases in which clearly some of the first gap is left."""
    out = []
    for phase in PHASES:
        rows = left.frames[left.frames[:, 2] == phase]
        there = np.bincount(rows[:, 0].astype(int), weights=rows[:, 3], minlength=len(whole)).astype(float)
        share = bootstrap_ratio(there, whole, resamples=settings.localisation.resamples)
        if share.low > 0 and share.value > settings.localisation.least_left:
            out.append(Share(Phase(phase).name.lower(), share))
    return tuple(out)


def _scaled(interval: Interval, by: float) -> Interval:
    return Interval(by * interval.value, by * interval.low, by * interval.high)


def _finding(
    each: EffectOverOrder,
    looked: Looked,
    closes: dict[str, Interval],
    tosses: Sequence[Toss],
    found: Diagnosis,
    settings: DiagnoseSettings,
) -> Finding:
    """What the tosses say of an effect that changes over their order."""
    name, closed = each.effect.name, closes[each.effect.name]
    alone = next((f for f in found.findings if f.name == name), None)
    position, rotation = _moved(each, looked, tosses)
    consequence = Consequence(position, rotation, closed.value, matters(position, rotation, closed, settings.verdict))
    gain = sum(
        one.evidence.weighted_gain(
            one.evidence.log_likelihood(one.residuals, looked.present.fitted.scales),
            looked.present.log_likelihood[np.isin(looked.present.evidence.windows.toss, np.arange(a, b))],
        )
        for one, a, b in zip(each.fitted, each.edges[:-1], each.edges[1:], strict=True)
    )
    evidence = {"gain": float(gain), "p_value": each.p_value, "n_tosses": float(len(tosses))}
    return Finding(
        name,
        "identified",
        each.effect.says,
        tuple(Phase(phase).name.lower() for phase in each.effect.phases),
        each.parameters,
        evidence,
        closed,
        (),
        {} if alone is None else alone.detectable,
        consequence,
        over_order=over_order(each, tosses),
    )


def over_order(each: EffectOverOrder, tosses: Sequence[Toss]) -> OverOrder:
    """How an effect goes over the order, in the words of a report.

    Args:
        each: The effect.
        tosses: In their order.
    """
    n = len(tosses)
    ranges = ((0, 1), (n - 1, n)) if each.form == "drift" else tuple(pairwise(each.edges))
    stretches = tuple(
        Stretch(tosses[a].name, tosses[b - 1].name, b - a, parameters)
        for (a, b), parameters in zip(ranges, each.stretches, strict=True)
    )
    return OverOrder(each.form, stretches, each.rate, each.p_value, each.correctable)


def _moved(each: EffectOverOrder, looked: Looked, tosses: Sequence[Toss]) -> tuple[float, float]:
    """By how much the change of an effect moves whole tosses: against its mean, in every stretch."""
    base, validator = looked.present.hypothesis, looked.validator
    mean = np.array([each.parameters[p.name].value for p in each.effect.parameters])
    base = base.minus(each.effect.name)
    same = base.plus(each.effect, mean).world()
    ones, others = [], []
    for one, a, b in zip(each.fitted, each.edges[:-1], each.edges[1:], strict=True):
        own, world = tosses[a:b], one.hypothesis.world()
        if looked.own_heights:
            own = ending_at_origin(own, base.base.object)
        q, v = first_states(own, world, n_threads=validator.n_threads)
        ones.append(whole_motions(world, own, q, v, validator))
        others.append(whole_motions(same, own, q, v, validator))
    longest = max(run.shape[1] for run in ones)

    def padded(runs: list[Array]) -> Array:
        return np.concatenate([np.pad(r, ((0, 0), (0, longest - r.shape[1]), (0, 0)), mode="edge") for r in runs])

    return changed(padded(ones), padded(others), tosses, base.base.object.width)


def _steps(
    found: Diagnosis,
    recorded: Sequence[Toss],
    first: Looked,
    undone: Sequence[tuple[EffectOverOrder, Looked]],
) -> tuple[Step, ...]:
    """Rollout errors of the recorded tosses, and with what was undone in front of each later hypothesis."""
    if not undone:
        return found.steps
    names = tuple(each.effect.name for each, _ in undone)
    begin = rollout_errors(recorded, (), first.present, first.validator)
    return (begin, *(replace(step, effects=(*names, *step.effects)) for step in found.steps))
