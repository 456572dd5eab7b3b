"""The search for effects: screened, fitted, judged on held-out tosses, joined, and left out again.

First flight alone, whose model is right but for what is looked for: what acts there is found and named from windows
with no contact in them. Then all windows, with that in, where contact has its say on which of a class it is.

One round: every effect of the library is screened by the gain of one step (a score test, but measured), the
promising ones are fitted, and judged by the log-likelihood of tosses that took no part (eight folds). The best
joins if the gain is significant over tosses (signed ranks, Bonferroni over the library) and matters; the next round
starts from there. Effects whose gain is not clearly below the best's are its confusable class; a special case
is preferred to what contains it. Effects that the others have made superfluous leave, after every round and at the
end; then classes are looked at once more, with everything else in.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wilcoxon

from tossid.diagnosis.engines import LIFTING, Engine
from tossid.diagnosis.fitting import (
    Evidence,
    Fitted,
    Hypothesis,
    derivatives,
    fit,
    gains,
    student_deviance,
    toss_sums,
)
from tossid.diagnosis.windows import FLIGHT_WEIGHT, Windows, linearise
from tossid.physics.effects import Effect, World
from tossid.types import Phase

Array = NDArray[np.float64]
Tell = Callable[[str], None]

FOLDS = 8
CURVATURE = 0.65
"""Of Student's log-likelihood on Gaussian misses, over the weighted squares that Gauss-Newton has of it."""
LEVEL = 0.05
"""Family-wise level of naming an effect in a round."""
MATTERS = 0.004
"""Share of the gap that an effect must close to be named."""
MOST_EFFECTS = 7
CANDIDATES = 6
"""Effects fitted in full in a round."""
PROMISING = 3.0
"""Gain of log-likelihood by one step, to all tosses, from which an effect is fitted."""
LIKELY = 0.3
"""Share of what a fit is to gain that one step has to."""
CLASS_LEVEL = 0.05
"""An effect whose gain is below the best's at this level (one-sided) is out of its class."""
CLASS_SHARE = 0.8
"""And so is one that gains less than this share of what the best gains."""
MORE_GENERAL = 0.2
"""An effect that contains the best is in its class only if it is better at this level."""
LARGEST_CLASS = 3
STEP_SHARES = (1.0, 0.3, 0.1, 0.03)
"""Parts of a screening step that are tried: impacts are far from linear."""
ENGINE_ROUNDS = 2
"""Of first states and the other engine's differences, each with the other as it was."""
RESTARTS = 2
"""Of windows that fit badly, at the start and whenever an effect has joined."""
POLISH = 16
"""Iterations of the last fit."""


@dataclass(frozen=True)
class Candidate:
    """A hypothesis fitted and judged. effect: the one that joined last, None for none.

    log_likelihood (W,): of every window, at values fitted to the other folds. gain (W,): of every window, over the
    hypothesis before.
    shown (n,): of every toss, weighted, but for what a fit to nothing would lose.
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
        return one_sided(self.shown)

    @property
    def name(self) -> str:
        return "" if self.effect is None else self.effect.name


@dataclass(frozen=True)
class Found:
    """What a search leaves. first: without effects. present: with all that joined and stayed. history: the hypotheses
    on the way, the first and the last among them. tried: effects by name, as judged in the first round, or when
    they joined. in_flight: the same of flight alone. needed: named effects, against the hypothesis without each.
    classes: named effects, what could stand in for each."""

    first: Candidate
    present: Candidate
    history: tuple[Candidate, ...]
    tried: dict[str, Candidate]
    in_flight: dict[str, Candidate]
    needed: dict[str, Candidate]
    classes: dict[str, tuple[Candidate, ...]]

    def ending(self, present: Candidate) -> Found:
        """The same, with another last hypothesis."""
        return replace(self, present=present, history=(*self.history[:-1], present))


def one_sided(values: Array) -> float:
    """p-value of values that tend to be positive (Wilcoxon's signed ranks: few tosses miss by far more than others,
    and a mean would be theirs); 1 for fewer than three values."""
    if len(values) < 3 or not np.any(values):
        return 1.0
    return float(wilcoxon(values, alternative="greater", method="auto").pvalue)


def folds(n: int, rng: np.random.Generator) -> tuple[NDArray[np.bool_], ...]:
    """Parts of the tosses (n,), drawn, of which each in turn takes no part."""
    place = rng.permutation(n)
    return tuple(place % FOLDS == k for k in range(min(FOLDS, n)))


class Search:
    """The tosses' windows, and the fits and judgements made with them."""

    def __init__(
        self,
        windows: Windows,
        n: int,
        folds: tuple[NDArray[np.bool_], ...],
        n_threads: int = 1,
        engine: Engine | None = None,
    ) -> None:
        self.windows, self.n, self.folds, self.n_threads = windows, n, folds, n_threads
        self.engine = Engine() if engine is None else engine

    # ------------------------------------------------------------ one hypothesis

    def with_contact(self, world: World) -> World:
        """The world with the contact that the tosses follow most: Coulomb's law, its relaxation, or, where a MuJoCo
        model is asked about, that model's own; the last only together with the engine."""
        relaxed = replace(world, law=world.law._replace(lifting=LIFTING))
        tried = [(world, Engine()), (relaxed, Engine())]
        if self.engine.model is not None:
            tried.append((relaxed, self.engine))
        best = -np.inf
        for each, engine in tried:
            self.engine = engine
            kept, whitening = linearise(self.windows, each, refine=4, n_threads=self.n_threads)
            evidence = self.with_engine(Evidence(kept, whitening, self.n_threads), Hypothesis(each), restarts=0)
            residual = evidence.residual(each)
            value = float(evidence.log_likelihood(residual, evidence.scales(residual)).sum())
            if value > best:
                best, taken, chosen = value, each, engine
        self.engine = chosen
        return taken

    def start(self, hypothesis: Hypothesis, near: Candidate | None = None) -> Candidate:
        """A hypothesis as it stands, fitted to nothing but the windows' first states.

        Args:
            near: one from whose first states those of this one are not far.
        """
        world = hypothesis.world()
        if near is None:
            kept, whitening = linearise(self.windows, world, refine=6, restarts=RESTARTS, n_threads=self.n_threads)
            evidence = Evidence(kept, whitening, self.n_threads)
        else:
            evidence = near.evidence.renewed(world, refine=4)
        for _ in range(ENGINE_ROUNDS if near is None else 1):
            evidence = self.with_engine(evidence, hypothesis)
        residual = evidence.residual(world)
        evidence, scales = evidence.with_trust(residual), evidence.scales(residual)
        size = len(hypothesis.flat())
        empty = np.zeros((self.n, size, size)), np.zeros((self.n, size))
        ll = evidence.log_likelihood(residual, scales)
        fitted = Fitted(hypothesis, evidence, residual, scales, *empty)
        return Candidate(None, fitted, ll, np.zeros(len(ll)), np.zeros(self.n))

    def with_engine(self, evidence: Evidence, hypothesis: Hypothesis, restarts: int = RESTARTS) -> Evidence:
        """Evidence that knows what another engine makes of its windows, from first states that know it too."""
        world = hypothesis.world()
        other = self.engine.difference(evidence.windows, world, n_threads=self.n_threads)
        evidence = replace(evidence, engines=(other, self.engine.expected))
        return evidence.renewed(world, refine=2, restarts=restarts)

    def judged(self, present: Candidate, effect: Effect | None, start: Hypothesis, iterations: int = 8) -> Candidate:
        """A hypothesis fitted to all tosses, and judged across the folds."""
        begin = present.evidence
        if effect is not None and effect.starts:
            # far from the present hypothesis, and so are its first states
            begin = replace(self.start(start, present).evidence, trust=begin.trust)
        fitted = self._settled(fit(begin, start, n_tosses=self.n, iterations=iterations))
        ll = self.held_out(fitted)
        made = Candidate(effect, fitted, ll, np.zeros(len(ll)), np.zeros(self.n))
        gain = self.contest(made, replace(present, log_likelihood=self._best_of(present, made.evidence)))
        nothing = np.zeros(0) if effect is None else effect.nominal(present.hypothesis.world())
        return replace(made, gain=gain, shown=self._shown(effect, fitted, nothing, self.of_tosses(gain)))

    def _settled(self, fitted: Fitted) -> Fitted:
        """With windows that fit badly begun anew, and all trusted as far as they fit under this hypothesis.

        As far as they fitted under another would be a bias for that one: where misses only change, what grows costs
        more than what shrinks brings.
        """
        evidence = self.with_engine(fitted.evidence, fitted.hypothesis)
        residual = evidence.residual(fitted.hypothesis.world())
        evidence = evidence.with_trust(residual)
        return replace(fitted, evidence=evidence, residual=residual, scales=evidence.scales(residual))

    def _best_of(self, present: Candidate, evidence: Evidence) -> Array:
        """(W,) log-likelihoods of a hypothesis at its own first states or at those of another, whichever suit it: what
        was found on the way to the other must not count for the other."""
        world = present.hypothesis.world()
        there = evidence.renewed(world, refine=2)
        there = there.with_trust(there.residual(world))
        return np.maximum(present.log_likelihood, self.held_out(present.fitted, there))

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

    def better(self, one: Candidate, other: Candidate) -> float:
        """p-value that one predicts the tosses no better than another."""
        return one_sided(self.of_tosses(self.contest(one, other)))

    def _shown(self, effect: Effect | None, fitted: Fitted, nothing: Array, gain: Array) -> Array:
        """(n,) gains as they would be zero on average if the effect were not there.

        A fit to noise loses half of d^T H d on tosses that took no part, d its values over `nothing`. That is so near
        nothing: what is also looked for from afar is left to gain what it loses.
        """
        if effect is None or effect.starts:
            return gain
        out, own, steps = gain.copy(), len(effect.parameters), fitted.hypothesis.steps
        for held in self.folds:
            d = (fitted.of_part(~held).flat()[-own:] - nothing) / steps[-own:]
            out[held] += 0.5 * CURVATURE * np.einsum("i,nij,j->n", d, fitted.H[held][:, -own:, -own:], d)
        return out

    # ------------------------------------------------------------ one round

    def round(
        self, present: Candidate, library: Sequence[Effect], tell: Tell, at_least: float = PROMISING
    ) -> list[Candidate]:
        """The promising effects, of which one step gains so much at least, fitted and judged."""
        inside = {effect.name for effect in present.hypothesis.effects}
        scored = [self._screened(present, effect) for effect in library if effect.name not in inside]
        scored.sort(key=lambda each: -each[0])
        out = []
        for gain, effect, start in scored[:CANDIDATES]:
            if gain > max(at_least, PROMISING):
                tell(effect.name)
                out.append(self.judged(present, effect, start))
        return out

    def _screened(self, present: Candidate, effect: Effect) -> tuple[float, Effect, Hypothesis]:
        """Gain of a step of Gauss-Newton or a part of it, from nothing or from the best start, and the values there.

        First states are as they are for the present hypothesis, or as they are for a start, whichever suit: starts
        are far from it.
        """
        now, e0 = present.fitted, present.evidence
        weights = e0.windows.weights

        def ll(e: Evidence, hypothesis: Hypothesis, residual: Array | None = None) -> Array:
            return e.log_likelihood(e.residual(hypothesis.world()) if residual is None else residual, now.scales)

        def worth(gain: Array) -> float:
            return max(float(gain.sum()), float(gain @ weights) / FLIGHT_WEIGHT)

        nothing = now.hypothesis.plus(effect)
        here = dict(zip([p.name for p in effect.parameters], nothing.values[-1], strict=True))
        base = ll(e0, now.hypothesis, now.residual)
        begun = [(0.0, nothing, e0, base)]
        tried = []
        for start in effect.starts:
            values = {**here, **start}
            hypothesis = now.hypothesis.plus(effect, np.array([values[p.name] for p in effect.parameters]))
            e = e0.renewed(hypothesis.world(), refine=2, anew=False)
            tried.append((float(gains(ll(e, hypothesis), base) @ weights), hypothesis, e))
        if tried:
            _, hypothesis, e = max(tried, key=lambda each: each[0])
            e = e.renewed(hypothesis.world())
            before = np.maximum(base, ll(e, now.hypothesis))
            gain = gains(np.maximum(ll(e0, hypothesis), ll(e, hypothesis)), before)
            begun.append((worth(gain), hypothesis, e, before))
        best = (0.0, effect, nothing)
        for begin, hypothesis, e, before in begun:
            if begin > best[0]:
                best = (begin, effect, hypothesis)
            size = len(hypothesis.flat())
            own = list(range(size - len(effect.parameters), size))
            residual = e.residual(hypothesis.world())
            J = derivatives(e, hypothesis, residual, own)[..., own]
            H, g = (each.sum(0) for each in toss_sums(e, residual, J, now.scales, self.n))
            delta = np.zeros(size)
            delta[own] = -np.linalg.pinv(H + 1e-9 * np.trace(H) * np.eye(len(own))) @ g
            low, high = hypothesis.bounds
            for share in STEP_SHARES:
                moved = hypothesis.at(np.clip(hypothesis.flat() + share * delta * hypothesis.steps, low, high))
                gained = worth(gains(ll(e, moved), before))
                if gained > best[0]:
                    best = (gained, effect, moved)
                elif gained > begin:
                    break
        return best

    # ------------------------------------------------------------ the whole search

    def run(self, hypothesis: Hypothesis, library: Sequence[Effect], tell: Callable[[str, float], None]) -> Found:
        """From a hypothesis without effects to those that belong."""
        seen = self._flown(hypothesis, library, tell)
        tell("what flight shows, in contact", 0.15)
        hypothesis = self._with_law(hypothesis, seen, library, tell)
        first = self.start(hypothesis)
        history: list[Candidate] = [first]
        classes: dict[str, tuple[str, ...]] = {}
        if seen is not None and seen.present.hypothesis.effects:
            effects, values = seen.present.hypothesis.effects, seen.present.hypothesis.values
            for k in range(1, len(effects) + 1):
                history.append(self.start(Hypothesis(hypothesis.base, effects[:k], values[:k]), history[-1]))
            history[-1], classes = self._decided(history[-1], seen)
        in_flight = {} if seen is None else seen.tried
        path = self._forward(first, history, classes, library, partial(_tell_of_round, tell))
        present, history = path.history[-1], list(path.history)
        needed: dict[str, Candidate] = {}
        found: dict[str, tuple[Candidate, ...]] = {}
        if present.hypothesis.effects:
            tell("all effects together", 0.8)
            present, less = self._pruned(first, self._refreshed(present, POLISH), len(library))
            history[-1] = present
            tell("what could stand in for each", 0.88)
            needed, found = self._stand_ins(present, less, library, path.classes)
        return Found(first, present, tuple(history), path.tried, in_flight, needed, found)

    def _flown(
        self, hypothesis: Hypothesis, library: Sequence[Effect], tell: Callable[[str, float], None]
    ) -> Found | None:
        """What the windows of free flight alone show; None without such windows."""
        free = np.flatnonzero(self.windows.free)
        if not len(free):
            return None
        tell("flight alone", 0.04)
        search = Search(self.windows.rows(free), self.n, self.folds, self.n_threads, self.engine)
        library = [effect for effect in library if Phase.FLIGHT in effect.phases]
        first = search.start(hypothesis)
        path = search._forward(first, [first], {}, library, lambda turn, name: None)
        present = path.history[-1]
        needed, found = search._stand_ins(present, path.less, library, path.classes)
        return Found(first, present, path.history, path.tried, {}, needed, found)

    def _with_law(
        self,
        hypothesis: Hypothesis,
        seen: Found | None,
        library: Sequence[Effect],
        tell: Callable[[str, float], None],
    ) -> Hypothesis:
        """The hypothesis, with Coulomb's law in place of its relaxation if an effect of contact explains more under it.

        What is relaxed lifts what slides, and so makes up for some of what a missing bounce leaves.
        """
        relaxed = hypothesis.base
        if relaxed.law.lifting == 0 or self.engine.model is not None:
            return hypothesis
        base = replace(relaxed, law=relaxed.law._replace(lifting=0.0))
        effects, values = (
            ((), ()) if seen is None else (seen.present.hypothesis.effects, seen.present.hypothesis.values)
        )
        other = self.start(Hypothesis(relaxed, effects, values))
        contact = [effect for effect in library if Phase.FLIGHT not in effect.phases]
        tell("Coulomb's law", 0.16)
        rigid = self.start(Hypothesis(base, effects, values))
        enough = LIKELY * self.contest(other, rigid).sum()
        for each in self.round(rigid, contact, lambda name: None, at_least=enough):
            belongs = self._belongs(rigid, rigid, each, len(library))
            if belongs and self.better(each, other) < LEVEL / len(library):
                return Hypothesis(base)
        return hypothesis

    def _decided(self, leader: Candidate, seen: Found) -> tuple[Candidate, dict[str, tuple[str, ...]]]:
        """Flight's hypothesis on all windows, with what flight cannot tell apart decided by contact where it can."""
        leader = self.judged(leader, None, leader.hypothesis)
        classes: dict[str, tuple[str, ...]] = {}
        for name, others in seen.classes.items():
            best, best_name = leader, name
            for other in others:
                k = [effect.name for effect in best.hypothesis.effects].index(best_name)
                effects, values = list(best.hypothesis.effects), list(best.hypothesis.values)
                effects[k], values[k] = other.hypothesis.effects[-1], other.hypothesis.values[-1]
                there = Hypothesis(leader.hypothesis.base, tuple(effects), tuple(values))
                each = self.judged(self.start(there, leader), None, there)
                if self.better(each, best) < CLASS_LEVEL:
                    best, best_name = each, other.name
            leader = best
            classes[best_name] = tuple(n for n in (name, *(o.name for o in others)) if n != best_name)
        return self._refreshed(leader), classes

    def _forward(
        self,
        first: Candidate,
        history: Sequence[Candidate],
        classes: dict[str, tuple[str, ...]],
        library: Sequence[Effect],
        tell: Callable[[int, str], None],
    ) -> Path:
        """Rounds from the last hypothesis of a history until no effect belongs."""
        history, classes, present = list(history), dict(classes), history[-1]
        tried: dict[str, Candidate] = {}
        less: dict[str, Candidate] = {}
        for k in range(MOST_EFFECTS - len(present.hypothesis.effects)):
            tell(k, "")
            fitted = self.round(present, library, partial(tell, k))
            if k == 0:
                tried = {each.name: each for each in fitted}
            good = [each for each in fitted if self._belongs(first, present, each, len(library))]
            if not good:
                break
            best = self._simplest(good)
            alike = sorted((each for each in fitted if self._alike(present, best, each)), key=lambda each: -each.total)
            classes[best.name] = tuple(each.name for each in alike)
            tried.setdefault(best.name, best)
            present, less = self._pruned(first, self._refreshed(best), len(library))
            history.append(present)
        return Path(tuple(history), tried, classes, less)

    def _stand_ins(
        self,
        present: Candidate,
        less: Mapping[str, Candidate],
        library: Sequence[Effect],
        classes: Mapping[str, Sequence[str]],
    ) -> tuple[dict[str, Candidate], dict[str, tuple[Candidate, ...]]]:
        """Each effect against the hypothesis without it, and what of its class could still stand in for it."""
        inside = {effect.name for effect in present.hypothesis.effects}
        others = {effect.name: effect for effect in library if effect.name not in inside}
        needed, found = {}, {}
        for effect in present.hypothesis.effects:
            gain = self.contest(present, less[effect.name])
            needed[effect.name] = replace(present, effect=effect, gain=gain, shown=self.of_tosses(gain))
            rivals = [others[name] for name in classes.get(effect.name, ()) if name in others]
            found[effect.name] = self._rivals(less[effect.name], needed[effect.name], rivals)
        return needed, found

    def _belongs(self, first: Candidate, present: Candidate, each: Candidate, n_library: int) -> bool:
        """Whether an effect's gain is significant, and matters."""
        if not (each.p_value < LEVEL / n_library and each.total > 0):
            return False
        return self._matters(first, present, each)

    def _matters(self, first: Candidate, before: Candidate, after: Candidate) -> bool:
        """Whether a share of the deviance worth naming is closed, in flight alone or in all windows."""
        closed, free = self._closed(before, after), self.windows.free
        whole = deviances(first.evidence, first.fitted.residual)
        return any(part.any() and closed[part].sum() > MATTERS * whole[part].sum() for part in (free, ~free))

    def _refreshed(self, present: Candidate, iterations: int = 4) -> Candidate:
        """Fitted on, with the other engine's difference as it is for these values."""
        fitted = fit(
            self.with_engine(present.evidence, present.hypothesis),
            present.hypothesis,
            n_tosses=self.n,
            iterations=iterations,
        )
        fitted = replace(fitted, evidence=fitted.evidence.with_trust(fitted.residual))
        return Candidate(present.effect, fitted, self.held_out(fitted), present.gain, present.shown)

    def _pruned(self, first: Candidate, present: Candidate, n_library: int) -> tuple[Candidate, dict[str, Candidate]]:
        """Without the effects that the others have made superfluous; and what remains without each that stays."""
        while True:
            effects = present.hypothesis.effects
            less = {e.name: self.judged(present, None, present.hypothesis.minus(e.name), 5) for e in effects}
            useless = [
                name
                for name, each in less.items()
                if self.better(present, each) > LEVEL / n_library or not self._matters(first, each, present)
            ]
            if not useless:
                return present, less
            present = less[max(useless, key=lambda name: self.of_tosses(less[name].gain).sum())]

    def _closed(self, before: Candidate, after: Candidate) -> Array:
        """(W,) how much deviance a hypothesis has less than another."""
        return deviances(before.evidence, before.fitted.residual) - deviances(after.evidence, after.fitted.residual)

    def _simplest(self, good: Sequence[Candidate]) -> Candidate:
        """The best, or a special case of it that is as good."""
        best = good[0]
        for each in good[1:]:
            if self.of_tosses(self.contest(each, best)).sum() > 0:
                best = each
        while True:
            special = () if best.effect is None else best.effect.contains
            inner = [each for each in good if each.name in special and self.better(best, each) > CLASS_LEVEL]
            if not inner:
                return best
            best = max(inner, key=lambda each: each.total)

    def _alike(self, before: Candidate, best: Candidate, other: Candidate) -> bool:
        """Whether the tosses cannot tell `other` from `best`; a more general effect always fits as well."""
        if other.effect is None or other is best or not other.total > 0:
            return False
        if best.name in other.effect.contains:
            return self.better(other, best) < MORE_GENERAL
        closes = (self.of_tosses(self._closed(before, each)).sum() for each in (other, best))
        return next(closes) > CLASS_SHARE * next(closes) or self.better(best, other) > CLASS_LEVEL

    def _rivals(self, without: Candidate, best: Candidate, others: Sequence[Effect]) -> tuple[Candidate, ...]:
        """Which of its class could still stand in for an effect, with all others in."""
        out = []
        for other in others:
            _, _, start = self._screened(without, other)
            each = self.judged(without, other, start)
            if self._alike(without, best, each):
                out.append(each)
        out.sort(key=lambda each: -each.total)
        return tuple(out[: LARGEST_CLASS - 1])


@dataclass(frozen=True)
class Path:
    """How a search went: hypotheses on the way, what its first round tried, by name what seemed alike, and the last
    hypothesis without each effect (none if nothing joined)."""

    history: tuple[Candidate, ...]
    tried: dict[str, Candidate]
    classes: dict[str, tuple[str, ...]]
    less: dict[str, Candidate]


def deviances(evidence: Evidence, residual: Array) -> Array:
    """(W,) Student's deviance of all windows' misses."""
    out: Array = np.where(evidence.windows.inside[..., None], student_deviance(residual), 0.0).sum((1, 2))
    return out


def _tell_of_round(tell: Callable[[str, float], None], turn: int, name: str) -> None:
    tell(f"round {turn + 1}: {name or 'screening'}", 0.2 + 0.09 * turn)
