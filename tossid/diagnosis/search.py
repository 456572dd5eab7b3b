"""The search for effects: screened, fitted, judged on held-out tosses, joined, and left out again.

One round: every effect of the library is screened by the gain of one step (a score test, but measured), the
promising ones are fitted, and judged by the log-likelihood of tosses that took no part (eight folds). The best
joins if the gain is significant over tosses (signed ranks, Bonferroni over the library) and matters; the next round
starts from there. Effects whose gain is not clearly below the best's are its confusable class; a special case
is preferred to what contains it. Effects that the others have made superfluous leave, after every round and at the
end; then classes are looked at once more, with everything else in.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wilcoxon

from tossid.diagnosis.engines import LIFTING, Engine
from tossid.diagnosis.fitting import Evidence, Fitted, Hypothesis, derivatives, fit, gains, toss_sums
from tossid.diagnosis.gap import deviance
from tossid.diagnosis.windows import Windows, linearise
from tossid.physics.effects import Effect, World

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

    log_likelihood (W,): of every window, at values fitted to the other folds. gain (n,): of every toss, over the
    hypothesis before.
    shown (n,): the gain but for what a fit to nothing would lose.
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
        return float(self.gain.sum())

    @property
    def p_value(self) -> float:
        """One-sided, that the tosses show nothing of the effect."""
        return one_sided(self.shown)

    @property
    def deviance(self) -> float:
        """Of all whitened misses."""
        return float(deviance(self.evidence, self.fitted.residual).sum())

    @property
    def name(self) -> str:
        return "" if self.effect is None else self.effect.name


@dataclass(frozen=True)
class Found:
    """What a search leaves. first: without effects. present: with all that joined and stayed. history: the hypotheses
    on the way, the first and the last among them. tried: effects by name, as judged in the first round, or when
    they joined. needed: named effects, how much of the log-likelihood is lost without each (n,). classes: named
    effects, what could stand in for each."""

    first: Candidate
    present: Candidate
    history: tuple[Candidate, ...]
    tried: dict[str, Candidate]
    needed: dict[str, Array]
    classes: dict[str, tuple[Candidate, ...]]


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

    def with_contact(self, world: World, library: Sequence[Effect] = ()) -> World:
        """The world with the contact that the tosses follow most: Coulomb's law, its relaxation, or, where a MuJoCo
        model is asked about, that model's own; the last only together with the engine.

        The relaxation lifts what slides, and so makes up for some of what a missing bounce leaves: it is taken only if
        no effect of the library explains more under Coulomb's law.
        """
        relaxed = replace(world, law=world.law._replace(lifting=LIFTING))
        tried = [(world, Engine()), (relaxed, Engine())]
        if self.engine.model is not None:
            tried.append((relaxed, self.engine))
        best = -np.inf
        for each, engine in tried:
            self.engine = engine
            kept, whitening = linearise(self.windows, each, refine=4, n_threads=self.n_threads)
            evidence = self.with_engine(Evidence(kept, whitening, self.n_threads), Hypothesis(each))
            residual = evidence.residual(each)
            value = float(evidence.log_likelihood(residual, evidence.scales(residual)).sum())
            if value > best:
                best, taken, chosen = value, each, engine
        self.engine = chosen
        if taken is relaxed and chosen.model is None:
            other = self.start(Hypothesis(relaxed))
            for fitted in self.round(self.start(Hypothesis(world)), library, lambda name: None):
                if self.contest(fitted, other).sum() > 0:
                    return world
        return taken

    def start(self, hypothesis: Hypothesis) -> Candidate:
        """A hypothesis as it stands, fitted to nothing but the windows' first states."""
        world = hypothesis.world()
        kept, whitening = linearise(self.windows, world, refine=6, restarts=RESTARTS, n_threads=self.n_threads)
        evidence = Evidence(kept, whitening, self.n_threads)
        for _ in range(ENGINE_ROUNDS):
            evidence = self.with_engine(evidence, hypothesis)
        residual = evidence.residual(world)
        evidence, scales = evidence.with_trust(residual), evidence.scales(residual)
        size = len(hypothesis.flat())
        empty = np.zeros((self.n, size, size)), np.zeros((self.n, size))
        ll = evidence.log_likelihood(residual, scales)
        return Candidate(None, Fitted(hypothesis, evidence, residual, scales, *empty), ll, *np.zeros((2, self.n)))

    def with_engine(self, evidence: Evidence, hypothesis: Hypothesis) -> Evidence:
        """Evidence that knows what another engine makes of its windows, from first states that know it too."""
        world = hypothesis.world()
        other = self.engine.difference(evidence.windows, world, n_threads=self.n_threads)
        evidence = replace(evidence, engines=(other, self.engine.expected))
        return evidence.renewed(world, refine=2, restarts=RESTARTS)

    def judged(self, present: Candidate, effect: Effect | None, start: Hypothesis, iterations: int = 8) -> Candidate:
        """A hypothesis fitted to all tosses, and judged across the folds."""
        fitted = fit(present.evidence, start, n_tosses=self.n, iterations=iterations)
        made = Candidate(effect, fitted, self.held_out(fitted), *np.zeros((2, self.n)))
        gain = self.contest(made, present)
        nothing = np.zeros(0) if effect is None else effect.nominal(present.hypothesis.world())
        return replace(made, gain=gain, shown=self._shown(effect, fitted, nothing, gain))

    def held_out(self, fitted: Fitted, evidence: Evidence | None = None) -> Array:
        """(W,) log-likelihood of each window at values fitted to the other folds.

        Args:
            evidence: around which first states; the hypothesis's own if None.
        """
        evidence = fitted.evidence if evidence is None else evidence
        out = np.zeros(len(evidence.windows.toss))
        for held in self.folds:
            judge = evidence.of_tosses(held)
            residual = judge.residual(fitted.of_part(~held).world())
            out[held[evidence.windows.toss]] = judge.log_likelihood(residual, fitted.scales)
        return out

    def contest(self, one: Candidate, other: Candidate) -> Array:
        """(n,) by how much log-likelihoods of tosses are better under one hypothesis than under another.

        Each is tried from the first states that suit the one and from those that suit the other: where contact is
        rough, how well first states were found differs by more than the hypotheses do.
        """
        here = gains(one.log_likelihood, self.held_out(other.fitted, one.evidence))
        there = gains(self.held_out(one.fitted, other.evidence), other.log_likelihood)
        return np.bincount(self.windows.toss, weights=0.5 * (here + there), minlength=self.n).astype(float)

    def better(self, one: Candidate, other: Candidate) -> float:
        """p-value that one predicts the tosses no better than another."""
        return one_sided(self.contest(one, other))

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

    def round(self, present: Candidate, library: Sequence[Effect], tell: Tell) -> list[Candidate]:
        """The promising effects, fitted and judged."""
        inside = {effect.name for effect in present.hypothesis.effects}
        scored = [self._screened(present, effect) for effect in library if effect.name not in inside]
        scored.sort(key=lambda each: -each[0])
        out = []
        for gain, effect, start in scored[:CANDIDATES]:
            if gain > PROMISING:
                tell(effect.name)
                out.append(self.judged(present, effect, start))
        return out

    def _screened(self, present: Candidate, effect: Effect) -> tuple[float, Effect, Hypothesis]:
        """Gain of a step of Gauss-Newton or a part of it, from nothing or from the best start, and the values there.

        First states are as they are for the present hypothesis, but for the starts: those are far from it.
        """
        now = present.fitted
        base = present.evidence.log_likelihood(now.residual, now.scales)

        def gain(e: Evidence, hypothesis: Hypothesis, before: Array) -> float:
            return float(gains(e.log_likelihood(e.residual(hypothesis.world()), now.scales), before).sum())

        nothing = now.hypothesis.plus(effect)
        here = dict(zip([p.name for p in effect.parameters], nothing.values[-1], strict=True))
        begun = [(0.0, nothing, present.evidence)]
        tried = []
        for start in effect.starts:
            values = {**here, **start}
            hypothesis = now.hypothesis.plus(effect, np.array([values[p.name] for p in effect.parameters]))
            e = present.evidence.renewed(hypothesis.world(), refine=2)
            there = gain(e, hypothesis, e.log_likelihood(e.residual(now.hypothesis.world()), now.scales))
            tried.append((0.5 * (there + gain(present.evidence, hypothesis, base)), hypothesis, e))
        if tried:
            begun.append(max(tried, key=lambda each: each[0]))
        best = (0.0, effect, nothing)
        for begin, hypothesis, e in begun:
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
            before = e.log_likelihood(residual, now.scales)
            for share in STEP_SHARES:
                moved = hypothesis.at(np.clip(hypothesis.flat() + share * delta * hypothesis.steps, low, high))
                gained = begin + gain(e, moved, before)
                if gained > best[0]:
                    best = (gained, effect, moved)
                elif gained > begin:
                    break
        return best

    # ------------------------------------------------------------ the whole search

    def run(self, hypothesis: Hypothesis, library: Sequence[Effect], tell: Callable[[str, float], None]) -> Found:
        """From a hypothesis without effects to those that belong."""
        present = first = self.start(hypothesis)
        history, tried = [first], {}
        classes: dict[str, tuple[str, ...]] = {}
        for turn in range(MOST_EFFECTS):
            tell(f"round {turn + 1}: screening {len(library)} effects", 0.05 + 0.1 * turn)
            fitted = self.round(present, library, partial(_tell_of_round, tell, turn))
            if turn == 0:
                tried = {each.name: each for each in fitted}
            good = [each for each in fitted if self._belongs(first, present, each, len(library))]
            if not good:
                break
            best = self._simplest(good)
            alike = sorted((each for each in fitted if self._alike(present, best, each)), key=lambda each: -each.total)
            classes[best.name] = tuple(each.name for each in alike)
            tried.setdefault(best.name, best)
            present = self._refreshed(best)
            history.append(present)
            pruned, _ = self._pruned(first, present, len(library))
            if pruned is not present:
                present = pruned
                history[-1] = present
        needed: dict[str, Array] = {}
        found_classes: dict[str, tuple[Candidate, ...]] = {}
        if present is not first:
            tell("all effects together", 0.8)
            present, less = self._pruned(first, self._refreshed(present, POLISH), len(library))
            history[-1] = present
            tell("what could stand in for each", 0.88)
            inside = {effect.name for effect in present.hypothesis.effects}
            others = {effect.name: effect for effect in library if effect.name not in inside}
            for effect in present.hypothesis.effects:
                gain = self.contest(present, less[effect.name])
                needed[effect.name] = gain
                found_classes[effect.name] = self._rivals(
                    less[effect.name],
                    replace(present, effect=effect, gain=gain, shown=gain),
                    [others[name] for name in classes.get(effect.name, ()) if name in others],
                )
        return Found(first, present, tuple(history), tried, needed, found_classes)

    def _belongs(self, first: Candidate, present: Candidate, each: Candidate, n_library: int) -> bool:
        """Whether an effect's gain is significant, and matters."""
        if not (each.p_value < LEVEL / n_library and each.total > 0):
            return False
        return self._closed(present, each) > MATTERS * first.deviance

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
                if self.better(present, each) > LEVEL / n_library
                or self._closed(each, present) < MATTERS * first.deviance
            ]
            if len(effects) < 2 or not useless:
                return present, less
            present = less[max(useless, key=lambda name: less[name].total)]

    def _closed(self, before: Candidate, after: Candidate) -> float:
        """How much deviance a hypothesis has less than another, around the first states of either."""
        closed = 0.0
        for evidence in (before.evidence, after.evidence):
            one, other = (evidence.residual(each.hypothesis.world()) for each in (before, after))
            closed += 0.5 * float((deviance(evidence, one) - deviance(evidence, other)).sum())
        return closed

    def _simplest(self, good: Sequence[Candidate]) -> Candidate:
        """The best, or a special case of it that is as good."""
        best = good[0]
        for each in good[1:]:
            if self.contest(each, best).sum() > 0:
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
        close = self._closed(before, other) > CLASS_SHARE * self._closed(before, best)
        return close or self.better(best, other) > CLASS_LEVEL

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


def _tell_of_round(tell: Callable[[str, float], None], turn: int, name: str) -> None:
    tell(f"round {turn + 1}: {name}", 0.08 + 0.1 * turn)
