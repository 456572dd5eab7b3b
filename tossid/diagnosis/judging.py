"""One hypothesis fitted to the tosses, and judged by what it predicts of tosses that took no part (eight folds)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wilcoxon

from tossid.diagnosis.engines import LIFTING, Engine
from tossid.diagnosis.evidence import Evidence, Hypothesis, gains
from tossid.diagnosis.fitting import CURVATURE, Fitted, fit, nudged
from tossid.diagnosis.whitening import linearise
from tossid.diagnosis.windows import FLIGHT_WEIGHT, Windows, make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import Effect, World
from tossid.physics.solvers.batches import whole_batches
from tossid.types import Phase, Toss

Array = NDArray[np.float64]
Item = TypeVar("Item")
Made = TypeVar("Made")

FOLDS = 8
POLISH = 2
"""Fits to a last hypothesis, each from where the last was nudged to."""
POLISHED = 1.0
"""Gain of log-likelihood below which no other follows."""
RESTARTS = 1
"""Of windows that fit badly, at the start and whenever an effect has joined."""


@dataclass(frozen=True)
class Candidate:
    """A hypothesis fitted and judged. effect: the one that joined last, None for none.

    log_likelihood (W,): of every window, at values fitted to the other folds. gain (W,): of every window, over the
    hypothesis before.
    shown (G, n): of every toss, weighted, but for what a fit to nothing would lose: in all windows, in those with an
    impact, and in the others, each if any.
    """

    effect: Effect | None
    fitted: Fitted
    log_likelihood: Array
    gain: Array
    shown: Array

    @property
    def evidence(self) -> Evidence:
        return self.fitted.evidence

    @property
    def hypothesis(self) -> Hypothesis:
        return self.fitted.hypothesis

    @property
    def total(self) -> float:
        """Log-likelihood gained; of what acts in flight, contact counts as little for it as in the fit."""
        share = FLIGHT_WEIGHT if self.effect is not None and Phase.FLIGHT in self.effect.phases else 1.0
        return float(self.gain @ self.evidence.windows.weights) / share

    @property
    def p_value(self) -> float:
        """One-sided, that the tosses show nothing of the effect."""
        return anywhere(self.shown)

    @property
    def name(self) -> str:
        return "" if self.effect is None else self.effect.name


def one_sided(values: Array) -> float:
    """p-value of values that tend to be positive (Wilcoxon's signed ranks: few tosses miss by far more than others,
    and a mean would be theirs); 1 for fewer than three values."""
    if len(values) < 3 or not np.any(values):
        return 1.0
    return float(wilcoxon(values, alternative="greater", method="auto").pvalue)


def anywhere(values: Array) -> float:
    """p-value (Bonferroni's) that values (G, n) tend to be positive nowhere: impacts are rough, and what acts in
    sliding would be lost in their noise."""
    return min(1.0, len(values) * min(one_sided(each) for each in values))


def folds(n: int, rng: np.random.Generator) -> tuple[NDArray[np.bool_], ...]:
    """Parts of the tosses (n,), drawn, of which each in turn takes no part."""
    place = rng.permutation(n)
    return tuple(place % FOLDS == k for k in range(min(FOLDS, n)))


@dataclass(frozen=True)
class Judge:
    """The tosses' windows, and the fits and judgements made with them.

    n: tosses. folds: parts of them (n,), of which each in turn takes no part. engine: the other engine.
    held: names of effects whose values are not fitted again with each hypothesis.
    """

    windows: Windows
    n: int
    folds: tuple[NDArray[np.bool_], ...]
    n_threads: int = 1
    engine: Engine = field(default_factory=Engine)
    held: frozenset[str] = frozenset()

    @staticmethod
    def of(
        tosses: Sequence[Toss], model: ObjectModel, *, seed: int, n_threads: int = 1, engine: Engine | None = None
    ) -> Judge:
        """Of all windows of tosses, with folds drawn by a seed and, if no other is given, near-rigid MuJoCo."""
        n = len(tosses)
        parts = folds(n, np.random.default_rng(seed))
        return Judge(make_windows(tosses, model), n, parts, n_threads, engine or Engine())

    def each(self, judged: Callable[[Item], Made], items: Iterable[Item]) -> list[Made]:
        """judged(item) of all items, in order, several at once."""
        if self.n_threads == 1:
            return [judged(item) for item in items]

        def one(item: Item) -> Made:
            with whole_batches():
                return judged(item)

        with ThreadPoolExecutor(self.n_threads) as pool:
            return list(pool.map(one, items))

    def with_contact(self, world: World) -> tuple[Judge, World]:
        """The world with the contact that the tosses follow most: Coulomb's law, its relaxation, or, where a MuJoCo
        model is asked about, that model's own; the last only together with the engine."""
        relaxed = replace(world, law=world.law._replace(lifting=LIFTING))
        tried = [(replace(self, engine=Engine()), each) for each in (world, relaxed)]
        if self.engine.model is not None:
            tried.append((self, relaxed))

        def fits(one: tuple[Judge, World]) -> float:
            judge, each = one
            kept, whitening = linearise(judge.windows, each, refine=4, n_threads=judge.n_threads)
            evidence = judge.with_engine(Evidence(kept, whitening, judge.n_threads), Hypothesis(each), restarts=0)
            residual = evidence.residual(each)
            return float(evidence.log_likelihood(residual, evidence.scales(residual)).sum())

        fit_of = self.each(fits, tried)
        return tried[int(np.argmax(fit_of))]

    def start(self, hypothesis: Hypothesis, near: Candidate | None = None) -> Candidate:
        """A hypothesis as it stands, fitted to nothing but the windows' first states.

        Args:
            near: one from whose first states those of this one are not far.
        """
        world = hypothesis.world()
        if near is None:
            kept, whitening = linearise(self.windows, world, refine=6, restarts=RESTARTS, n_threads=self.n_threads)
            evidence = self.with_engine(Evidence(kept, whitening, self.n_threads), hypothesis, restarts=0)
        else:
            evidence = near.evidence.renewed(world, refine=4)
        evidence = self.with_engine(evidence, hypothesis, restarts=1)
        residual = evidence.residual(world)
        scales = evidence.scales(residual)
        size = len(hypothesis.flat())
        empty = np.zeros((self.n, size, size)), np.zeros((self.n, size))
        ll = evidence.log_likelihood(residual, scales)
        fitted = Fitted(hypothesis, evidence, residual, scales, *empty)
        return Candidate(None, fitted, ll, np.zeros(len(ll)), np.zeros((1, self.n)))

    def with_engine(self, evidence: Evidence, hypothesis: Hypothesis, restarts: int = RESTARTS) -> Evidence:
        """Evidence that knows what another engine makes of its windows, from first states that know it too."""
        world = hypothesis.world()
        other = self.engine.difference(evidence.windows, world, evidence.engines, n_threads=self.n_threads)
        evidence = replace(evidence, engines=other)
        return evidence.renewed(world, refine=2, restarts=restarts)

    def judged(
        self,
        present: Candidate,
        effect: Effect | None,
        start: Hypothesis,
        iterations: int = 8,
        near: Evidence | None = None,
    ) -> Candidate:
        """A hypothesis fitted to all tosses, and judged across the folds.

        Args:
            present: what it is judged against.
            effect: what it has more, if anything.
            near: evidence around `start`, if that is far from the present hypothesis.
        """
        begin = present.evidence if near is None else near
        fitted = self._settled(fit(begin, start, n_tosses=self.n, iterations=iterations, held=self.held))
        ll = self.held_out(fitted)
        made = Candidate(effect, fitted, ll, np.zeros(len(ll)), np.zeros((1, self.n)))
        gain = self.contest(self._at_best(made, present.evidence), self._at_best(present, made.evidence))
        nothing = np.zeros(0) if effect is None else effect.nominal(present.hypothesis.world())
        return replace(made, gain=gain, shown=self._shown(effect, fitted, nothing, self.parts(gain)))

    def polished(self, evidence: Evidence, hypothesis: Hypothesis, rounds: int = POLISH) -> Fitted:
        """All parameters of a hypothesis fitted, windows that fit badly begun anew, and the fit nudged, as long as that
        brings anything."""
        fitted = fit(self.with_engine(evidence, hypothesis), hypothesis, n_tosses=self.n)
        for _ in range(rounds - 1):
            if not len(hypothesis.flat()):
                break
            near, moved = nudged(fitted)
            again = fit(self.with_engine(near, moved), moved, n_tosses=self.n)
            before, after = (each.evidence.log_likelihood(each.residual, fitted.scales) for each in (fitted, again))
            gain = float(gains(after, before) @ evidence.windows.weights)
            if gain > 0:
                fitted = again
            if gain < POLISHED:
                break
        return fitted

    def _settled(self, fitted: Fitted) -> Fitted:
        """With windows that fit badly under this hypothesis begun anew."""
        evidence = self.with_engine(fitted.evidence, fitted.hypothesis, restarts=1)
        residual = evidence.residual(fitted.hypothesis.world())
        return replace(fitted, evidence=evidence, residual=residual, scales=evidence.scales(residual))

    def _at_best(self, one: Candidate, evidence: Evidence) -> Candidate:
        """A hypothesis with (W,) log-likelihoods at its own first states or at those of another, whichever suit it:
        contact is rough, and what was found on the way to the other must not count for the other."""
        world = one.hypothesis.world()
        there = evidence.renewed(world, refine=2)
        return replace(one, log_likelihood=np.maximum(one.log_likelihood, self.held_out(one.fitted, there)))

    def held_out(self, fitted: Fitted, evidence: Evidence | None = None) -> Array:
        """(W,) log-likelihood of each window at values fitted to the other folds.

        Args:
            evidence: around which first states; the hypothesis's own if None.
        """
        evidence = fitted.evidence if evidence is None else evidence
        out = np.zeros(len(evidence.windows.toss))
        for held in self.folds:
            if not held[evidence.windows.toss].any():
                continue
            judge = evidence.of_tosses(held)
            residual = judge.residual(fitted.of_part(~held).world())
            out[held[evidence.windows.toss]] = judge.log_likelihood(residual, fitted.scales)
        return out

    def contest(self, one: Candidate, other: Candidate) -> Array:
        """(W,) by how much log-likelihoods of windows are better under one hypothesis than under another.

        Each is judged at its own first states, for which it has tried as hard as the other: states and their
        uncertainty as they are for a rigid contact would not do for one that yields. Flight has no say on what does not
        act in it: its windows count so much that how well their states were found would decide.
        """
        gain = gains(one.log_likelihood, other.log_likelihood)
        flying = [{e.name for e in each.hypothesis.effects if Phase.FLIGHT in e.phases} for each in (one, other)]
        if flying[0] == flying[1]:
            gain = np.where(one.evidence.windows.free, 0.0, gain)
        return gain

    def of_tosses(self, gain: Array) -> Array:
        """(n,) weighted sums over each toss's windows."""
        weights = gain * self.windows.weights
        return np.bincount(self.windows.toss, weights=weights, minlength=self.n).astype(float)

    def parts(self, gain: Array) -> Array:
        """(G, n) the same: of all windows, of those with an impact, and of others with contact, if there are both."""
        w = self.windows
        impact = (w.inside & (w.phase == Phase.IMPACT)).any(axis=1) & ~w.free
        other = ~impact & ~w.free
        some = (impact, other) if impact.any() and other.any() else ()
        return np.stack([self.of_tosses(gain), *(self.of_tosses(np.where(part, gain, 0.0)) for part in some)])

    def better(self, one: Candidate, other: Candidate) -> float:
        """p-value that one predicts the tosses no better than another; 1 if on the whole it does not."""
        gain = self.parts(self.contest(one, other))
        return anywhere(gain) if gain[0].sum() > 0 else 1.0

    def _shown(self, effect: Effect | None, fitted: Fitted, nothing: Array, gain: Array) -> Array:
        """(G, n) gains as the first, of all windows, would be zero on average if the effect were not there.

        A fit to noise loses half of d^T H d on tosses that took no part, d its values over `nothing`. That is so near
        nothing: what is also looked for from afar is left to gain what it loses.
        """
        if effect is None or effect.starts:
            return gain
        out, own, steps = gain.copy(), len(effect.parameters), fitted.hypothesis.steps
        for held in self.folds:
            d = (fitted.of_part(~held).flat()[-own:] - nothing) / steps[-own:]
            out[0, held] += 0.5 * CURVATURE * np.einsum("i,nij,j->n", d, fitted.H[held][:, -own:, -own:], d)
        return out
