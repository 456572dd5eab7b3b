"""What is concluded from a search and its judge: the answer, and how sure it is.

The order of the stages is that of the method's page: the gap, the search, the judge, and what follows from these. The
verdicts follow from one table (`inference.verdict`).
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.effect_findings import Judgement, alternatives, changes, hidden
from tossid.diagnosis.findings import Felt, Gap
from tossid.diagnosis.inference.brings import (
    Runs,
    felt_of_each,
    noise_limit,
    runs_in_tossid,
    whole_tosses,
    worsen,
)
from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.inference.final_values import SHIFTS, FinalValues, final_values
from tossid.diagnosis.inference.found import Found
from tossid.diagnosis.inference.judge import (
    Fold,
    Frequencies,
    closed_share,
    cross_fit,
    frequencies,
    judged_by,
    with_each_left_out,
)
from tossid.diagnosis.inference.search import Search
from tossid.diagnosis.inference.verdict import verdict_of_gap
from tossid.diagnosis.likelihood.windows import Windows
from tossid.diagnosis.localisation.corners import place_of
from tossid.diagnosis.localisation.disagreement import SolverDisagreement, solver_disagreement
from tossid.diagnosis.localisation.gap import Rows, in_short, measure_gap, phases_left, rows_of
from tossid.diagnosis.localisation.noise import Floor, noise_floor
from tossid.diagnosis.localisation.rollouts import measured_again, rolled_out
from tossid.diagnosis.localisation.witnesses import witnesses
from tossid.diagnosis.over_order import Undone, changes_left, findings_over_order, without_changes
from tossid.diagnosis.plane import in_plane
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.result import Diagnosis, Unseen
from tossid.diagnosis.under_way import GAP, JUDGED, SEARCH
from tossid.types import Toss

Array = NDArray[np.float64]
Index = NDArray[np.int64]

WITNESS_DRAWS = 4
"""Tosses that the found simulator makes of each first state, each with other noise, to measure witnesses alike."""


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
    made = _Concluded.of(recorded, first, undone, engine).diagnosis()
    if plane is not None:
        not_shown = (e for e in problem.library if e.name in plane.effects)
        made = replace(made, plane=plane, findings=(*made.findings, *map(hidden, not_shown)))
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


COST = 12.0
"""The time of a search over that of the first evidence: 5 to 30 on made and on real tosses."""


def _rounded(seconds: float) -> str:
    """A time in words, to one digit."""
    if seconds < 90:
        return f"{max(1, round(seconds, -1 if seconds > 10 else 0)):.0f} s"
    return f"{seconds / 60:.0f} minutes"


@dataclass(frozen=True)
class _Concluded:
    """All that is known when a search has ended and has been judged.

    Attributes:
        recorded: The problem with the tosses as they were recorded.
        problem: The same without the changes of their recording.
        undone: These changes, and what the search has found.
        final: The same at the values that are reported.
        floor: What noise leaves.
        folds: Without which the search was repeated; one of all tosses where it was not judged.
        judged: Whether it was.
        frequency: How often effects are named; None where that is not known.
        before: Rows of the simulator as it is stated, of the tosses as recorded.
        between: The same without the changes of the recording.
        after: With what was found.
        engine: Where whole tosses are predicted.
    """

    recorded: Problem
    problem: Problem
    undone: Undone
    final: FinalValues
    floor: Floor
    folds: tuple[Fold, ...]
    judged: bool
    frequency: Frequencies | None
    before: Rows
    between: Rows
    after: Rows
    engine: Engine

    @staticmethod
    def of(recorded: Problem, first: Evidence, undone: Undone, engine: Engine) -> _Concluded:
        problem, count = undone.problem, recorded.settings.repeats
        floor = noise_floor(problem.sample.windows)
        final = final_values(undone.found, map(problem.shifted, SHIFTS))
        folds = _folds(problem, final.found, count)
        all_tosses = np.arange(len(problem.tosses))
        before = rows_of([(first, all_tosses)], noise_floor(recorded.sample.windows))
        between = rows_of([(fold.before, fold.held) for fold in folds], floor)
        after = rows_of([(fold.after, fold.held) for fold in folds], floor)
        frequency = frequencies(folds, seed=problem.seed) if count else None
        return _Concluded(
            recorded, problem, undone, final, floor, folds, count > 0, frequency, before, between, after, engine
        )

    @property
    def found(self) -> Found:
        return self.final.found

    def diagnosis(self) -> Diagnosis:
        problem, found, under_way = self.problem, self.found, self.problem.under_way
        under_way("whole tosses", JUDGED)
        tosses, h, threads = problem.tosses, found.hypothesis, problem.n_threads
        searched = self.undone.found.fit.evidence  # with the time steps of the stated simulator's evidence
        brings = whole_tosses(
            self.folds,
            tosses,
            problem.stated,
            engine=self.engine.name,
            runs=self.engine.runs,
            unseen=self.judged,
            n_threads=threads,
        )
        gap = measure_gap(self.recorded.tosses, self.before, self.floor)
        left = measure_gap(tosses, self.after, self.floor)
        closed = closed_share(self.folds, self.floor.deviance)
        solvers = None if h.law.engine.of_user else solver_disagreement(searched, seed=problem.seed)
        judgement = Judgement(
            found,
            self.folds,
            self.frequency,
            self.between,
            self.after,
            self.floor.deviance,
            felt_of_each(h, tosses, problem.sample),
            worsen(self.folds, tosses, h.names, threads),
            self.final.variance,
            beyond_solvers=solvers is None or self.under_its_law().rms > solvers.gap,
        )
        findings = judgement.findings(problem.library)
        under_way("what is left", 0.92)
        over = findings_over_order(self.undone, self.recorded.tosses)
        changing = {f.name for f in over}
        findings = (*over, *(f for f in findings if f.name not in changing))
        verdict = verdict_of_gap(
            found=any(f.matters for f in findings),
            sure=any(f.matters and f.verdict != "candidate" for f in findings),
            gap_over_floor=gap.total.value / gap.noise_floor,
            felt=brings.is_felt(self.noise_limit()),
            closed=closed,
            within_solvers=_within(solvers, left),
        )
        runs = rolled_out(tosses, h.world(), problem.sample.windows, n_threads=threads)
        made = measured_again(tosses, runs, draws=WITNESS_DRAWS, seed=problem.seed)
        return Diagnosis(
            verdict=verdict,
            gap=gap,
            left=left,
            findings=findings,
            change=changes(findings),
            brings=brings,
            gap_closed=closed,
            unexplained=phases_left(self.before, self.after),
            hypothesis=h,
            n_tosses=len(tosses),
            seconds=0.0,
            folds=len(self.folds) if self.judged else 0,
            draws=0 if self.frequency is None else len(self.frequency.drawn),
            probability_none=None if self.frequency is None else self.frequency.none,
            alternatives=alternatives(found),
            place=place_of(tosses, found.first, searched if h.effects else None, seed=problem.seed),
            witnesses=witnesses(tosses, problem.stated.world(), h.world(), made),
            disagreement=solvers,
            noise=self.floor.noise,
            unseen=self.unseen(),
            changes_left=changes_left(self.undone, self.recorded.tosses),
            tosses=tuple(toss.name for toss in self.recorded.tosses),
            places=np.array([toss.q[-1, :2] for toss in self.recorded.tosses]),
        )

    def under_its_law(self) -> Rows:
        """Rows of the stated simulator under the law of contact that was found, without effects."""
        problem, law = self.problem, self.found.hypothesis.law
        if law == problem.stated.law:
            return self.between
        evidence = problem.sample.evidence(replace(problem.stated, law=law))
        return rows_of([(evidence, np.arange(len(problem.tosses)))], self.floor)

    def noise_limit(self) -> Felt:
        """What noise alone makes of whole tosses, as what was found predicts them."""
        problem, count = self.problem, len(self.folds) if self.judged else 0
        if not self.found.hypothesis.effects:
            return Felt(0.0, 0.0)
        return noise_limit(self.found, problem.tosses, problem.sample, folds=count, seed=problem.seed)

    def unseen(self) -> Unseen | None:
        """What was found, on tosses that nothing has seen. They decide nothing."""
        problem, found = self.problem, self.found
        if not problem.unseen:
            return None
        held = np.arange(len(problem.unseen))
        windows = problem.windows_of(problem.unseen, problem.tosses)
        fold = judged_by(held, windows, problem.search(), found)
        brings = whole_tosses(
            [fold],
            problem.unseen,
            problem.stated,
            engine=self.engine.name,
            runs=self.engine.runs,
            n_threads=problem.n_threads,
        )
        return Unseen(len(held), closed_share([fold], self.floor.deviance), brings)


def _folds(problem: Problem, found: Found, count: int) -> tuple[Fold, ...]:
    """The folds that judge a search; all tosses as one that judges nothing, if there are none."""
    n, threads = len(problem.tosses), problem.n_threads
    if not count:
        return (with_each_left_out(judged_by(np.arange(n), problem.sample.windows, problem.search(), found)),)
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


def _within(solvers: SolverDisagreement | None, left: Gap) -> bool:
    """Whether a gap is no larger than that of another exact solver of the same body."""
    return solvers is not None and left.total.value <= solvers.gap
