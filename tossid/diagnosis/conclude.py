"""What is concluded from a search and its judge: the answer, and how sure it is.

The order of the stages is that of the method's page: the gap, the search, the judge, and what follows from these. The
verdicts follow from one table (`inference.verdict`).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.effect_findings import Judgement, alternatives, changes
from tossid.diagnosis.findings import NOTHING, Felt, Finding
from tossid.diagnosis.inference.brings import (
    Runs,
    brings_of,
    felt_of_each,
    noise_limit,
    runs_in_tossid,
    whole_tosses,
    worsen,
)
from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.inference.final_values import SHIFTS, final_values
from tossid.diagnosis.inference.found import Found
from tossid.diagnosis.inference.judge import Fold, closed_share, cross_fit, frequencies, judged_by, with_each_left_out
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.inference.search import Search
from tossid.diagnosis.inference.verdict import verdict_of_gap
from tossid.diagnosis.likelihood.windows import Windows
from tossid.diagnosis.localisation.corners import place_of
from tossid.diagnosis.localisation.disagreement import solver_disagreement
from tossid.diagnosis.localisation.gap import Rows, in_short, measure_gap, phases_left, rows_of
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.localisation.rollouts import measured_again
from tossid.diagnosis.localisation.witnesses import witnesses
from tossid.diagnosis.over_order import Undone, changes_left, findings_over_order, without_changes
from tossid.diagnosis.plane import in_plane
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.result import Diagnosis, Interruption, Unseen
from tossid.diagnosis.under_way import GAP, JUDGED, SEARCH, UnderWay
from tossid.types import Toss

Array = NDArray[np.float64]
Index = NDArray[np.int64]

WITNESS_DRAWS = 4
"""Tosses that the found simulator makes of each first state, each with other noise, to measure witnesses alike."""
COST = 12.0
"""The time of a search over that of the first evidence: 5 to 30 on made and on real tosses."""
MOST_SUSPECTS = 5
"""Suspects of a diagnosis that is interrupted."""


@dataclass(frozen=True)
class Engine:
    """Where whole tosses are predicted before and after the changes.

    Attributes:
        name: Of the user's own simulator wherever it can be run.
        runs: Of whole tosses under a hypothesis.
    """

    name: Literal["mujoco", "python", "tossid"] = "tossid"
    runs: Runs = runs_in_tossid


def explain(problem: Problem, engine: Engine = Engine()) -> tuple[Diagnosis, Undone]:
    """Where a simulator's predictions differ from tosses, which effects explain it, and how far.

    Args:
        problem: The tosses, the simulator and the effects to choose from.
        engine: Where whole tosses are predicted.

    Returns:
        The diagnosis, and the tosses without what changes in their recording.
    """
    started, recorded = time.perf_counter(), problem.in_order()
    library, plane = in_plane(
        recorded.tosses, problem.stated.base, problem.library, settings=problem.settings, n_threads=problem.n_threads
    )
    recorded = replace(recorded, library=library)
    first = report_gap(recorded)
    recorded.under_way("the search", GAP)
    undone = without_changes(recorded, first)
    names = ", ".join(undone.found.hypothesis.names) or "no effect"
    recorded.under_way.say(
        f"the search finds {names}" + ("; its repeats judge that" if recorded.settings.repeats else "")
    )
    made = _concluded(recorded, first, undone, engine)
    if plane is not None:
        world, nothing = problem.stated.world(), {"gain": 0.0, "p_value": 1.0}
        undetermined = (e for e in problem.library if e.name in plane.effects)
        hidden = (Finding.of(e, "not_identifiable", world, nothing) for e in undetermined)
        made = replace(made, plane=plane, findings=(*made.findings, *hidden))
    return replace(made, seconds=time.perf_counter() - started), undone


def report_gap(problem: Problem, *, of_all: int | None = None) -> Evidence:
    """Evidence of the simulator as it is stated, whose gap is reported.

    Args:
        problem: The tosses and the simulator.
        of_all: How many tosses there are, if these are the first of them only.
    """
    problem.under_way("the gap", 0.0)
    began, sample = time.perf_counter(), problem.sample
    first = sample.evidence(problem.stated)
    seconds = time.perf_counter() - began
    line = in_short(rows_of([(first, np.arange(sample.n))], noise_floor(sample.windows)))
    if of_all is not None:
        problem.under_way.known(problem.tosses, first, f"{line} (of the first {sample.n} of {of_all} tosses)")
        return first
    problem.under_way.known(problem.tosses, first, line)
    folds = problem.settings.repeats
    repeats = f" and its {folds} repeats" if folds else ""
    searches = 1.0 + folds / max(1, min(problem.n_threads, folds))  # repeats run beside each other
    problem.under_way.say(
        f"the search{repeats} over {sample.n} tosses takes about {_rounded(COST * searches * seconds)}"
    )
    return first


def _rounded(seconds: float) -> str:
    """A time in words, to one digit."""
    if seconds < 90:
        return f"{max(1, round(seconds, -1 if seconds > 10 else 0)):.0f} s"
    return f"{seconds / 60:.0f} minutes"


def _concluded(recorded: Problem, first: Evidence, undone: Undone, engine: Engine) -> Diagnosis:
    """What follows from a search: of the tosses as recorded, and without the changes of their recording."""
    problem, under_way, repeats = undone.problem, undone.problem.under_way, recorded.settings.repeats
    tosses, sample, threads, seed = problem.tosses, problem.sample, problem.n_threads, problem.seed
    final = final_values(undone.found, [sample, *map(problem.shifted, SHIFTS)])
    found, h, numbers = final.found, final.found.hypothesis, np.arange(len(tosses))
    floor, searched = noise_floor(sample.windows), undone.found.fit.evidence  # with the time steps of `first`
    folds = _folds(problem, found, repeats)
    frequency = frequencies(folds, seed=seed) if repeats else None
    under_way("whole tosses", JUDGED)
    whole = partial(whole_tosses, stated=problem.stated, engine=engine.name, runs=engine.runs, n_threads=threads)
    brings = whole(folds, tosses, unseen=repeats > 0)
    before = rows_of([(first, numbers)], noise_floor(recorded.sample.windows))
    between = rows_of([(fold.before, fold.held) for fold in folds], floor)
    after = rows_of([(fold.after, fold.held) for fold in folds], floor)
    gap, left = (measure_gap(*each, floor) for each in ((recorded.tosses, before), (tosses, after)))
    closed = closed_share(folds, floor.deviance)
    solvers = None if h.law.engine.of_user else solver_disagreement(searched, seed=seed)

    def under_its_law() -> Rows:
        """Of the stated simulator under the law of contact that was found, without effects."""
        if h.law == problem.stated.law:
            return between
        return rows_of([(sample.evidence(replace(problem.stated, law=h.law)), numbers)], floor)

    judgement = Judgement(
        found,
        folds,
        frequency,
        between,
        after,
        floor.deviance,
        felt_of_each(h, tosses, sample),
        worsen(folds, tosses, h.names, threads),
        final.variance,
        beyond_solvers=solvers is None or under_its_law().rms > solvers.gap,
    )
    constant = judgement.findings(problem.library)
    under_way("what is left", 0.92)
    over = findings_over_order(undone, recorded.tosses)
    changing = {f.name for f in over}
    findings = (*over, *(f for f in constant if f.name not in changing))
    noise = (
        noise_limit(found, tosses, sample, folds=len(folds) if repeats else 0, seed=seed)
        if h.effects
        else Felt(0.0, 0.0)
    )
    verdict = verdict_of_gap(
        found=any(f.matters for f in findings),
        sure=any(f.matters and f.verdict != "candidate" for f in findings),
        gap_over_floor=gap.total.value / gap.noise_floor,
        felt=brings.is_felt(noise),
        closed=closed,
        within_solvers=solvers is not None and left.total.value <= solvers.gap,
    )
    unseen = None
    if problem.unseen:  # which decide nothing
        held = np.arange(len(problem.unseen))
        others = Sample(problem.windows_of(problem.unseen, tosses), len(held), threads)
        fold = judged_by(held, others, problem.stated, found)
        unseen = Unseen(len(held), closed_share([fold], floor.deviance), whole([fold], problem.unseen))
    made = measured_again(tosses, runs_in_tossid(h, tosses, sample), draws=WITNESS_DRAWS, seed=seed)
    return Diagnosis(
        verdict=verdict,
        gap=gap,
        left=left,
        findings=findings,
        change=changes(findings),
        brings=brings,
        gap_closed=closed,
        unexplained=phases_left(before, after),
        hypothesis=h,
        n_tosses=len(tosses),
        seconds=0.0,
        folds=len(folds) if repeats else 0,
        draws=0 if frequency is None else len(frequency.drawn),
        probability_none=None if frequency is None else frequency.none,
        alternatives=alternatives(found),
        place=place_of(tosses, found.first, searched if h.effects else None, seed=seed),
        witnesses=witnesses(tosses, problem.stated.world(), h.world(), made),
        disagreement=solvers,
        noise=floor.noise,
        unseen=unseen,
        changes_left=changes_left(undone, recorded.tosses),
        **_of_tosses(recorded.tosses),
    )


def _of_tosses(tosses: Sequence[Toss]) -> dict[str, Any]:
    """A diagnosis's names of tosses, and where each ends."""
    places = np.array([toss.q[-1, :2] for toss in tosses])
    return {"tosses": tuple(toss.name for toss in tosses), "places": places}


def _folds(problem: Problem, found: Found, count: int) -> tuple[Fold, ...]:
    """The folds that judge a search; all tosses as one that judges nothing, if there are none."""
    n, threads = len(problem.tosses), problem.n_threads
    if not count:
        return (with_each_left_out(judged_by(np.arange(n), problem.sample, problem.stated, found)),)
    inside = max(1, threads // count)

    def tosses(numbers: Index) -> list[Toss]:
        return [problem.tosses[i] for i in numbers.tolist()]

    def search_of(chosen: Index) -> Search:
        part = replace(problem.of(tosses(chosen)), n_threads=inside)
        return replace(part.search(), judging=True, watch=lambda present, screening: None)

    def windows_of(held: Index, others: Index) -> Windows:
        return problem.windows_of(tosses(held), tosses(others))

    folds = []
    problem.under_way("the search repeated without parts of the tosses", SEARCH)
    for fold in cross_fit(search_of, windows_of, n=n, count=count, seed=problem.seed, n_threads=threads):
        folds.append(fold)
        done = SEARCH + (JUDGED - SEARCH) * len(folds) / min(count, n)
        problem.under_way(f"the search repeated without {len(folds)} of {min(count, n)} parts of the tosses", done)
    return tuple(folds)


def known_so_far(under_way: UnderWay) -> Diagnosis:
    """What is known when a diagnosis is interrupted, as one that says that it is not complete.

    Effects that joined are candidates. Values were fitted to the tosses that they predict, which the report says.

    Args:
        under_way: What is known: the gap at least.
    """
    tosses, first, present = under_way.tosses, under_way.first, under_way.present
    assert first is not None
    h, stated = first.hypothesis if present is None else present.hypothesis, first.hypothesis
    whole = present is not None and len(present.evidence.windows.toss) == len(first.windows.toss)
    last = present.evidence if present is not None and whole else first  # a round of flight has flight alone
    floor, sample = noise_floor(first.windows), Sample(first.windows, len(tosses), first.n_threads)
    gap, left = (measure_gap(tosses, rows_of([(each, np.arange(len(tosses)))], floor), floor) for each in (first, last))
    felt, n = felt_of_each(h, tosses, sample), {"n_tosses": float(len(tosses))}
    findings = []
    for effect in h.effects:
        known = present is not None and present.columns_of(effect.name)
        values = present.intervals(effect.name) if present is not None and known else {}
        one = Finding.of(effect, "candidate", stated.world(), n, parameters=values, felt=felt[effect.name])
        findings.append(one)
    was = runs_in_tossid(stated, tosses, sample)
    now = runs_in_tossid(h, tosses, sample) if h.effects else was
    return Diagnosis(
        verdict="incomplete",
        gap=gap,
        left=left,
        findings=tuple(findings),
        change=changes(findings),
        brings=brings_of(tosses, was, now, width=h.base.object.width, unseen=False),
        gap_closed=NOTHING,
        unexplained={},
        hypothesis=h,
        n_tosses=len(tosses),
        seconds=time.perf_counter() - under_way.since,
        noise=floor.noise,
        interruption=Interruption(under_way.stage, under_way.suspects[:MOST_SUSPECTS]),
        **_of_tosses(tosses),
    )
