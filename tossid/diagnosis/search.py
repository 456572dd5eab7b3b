"""The search for effects: screened, fitted, judged on held-out tosses, joined, and left out again.

One round: every effect of the library is screened by the gain of one step (a score test, but measured), the
promising ones are fitted, and judged by the log-likelihood of the half of the tosses that took no part. The best
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

from tossid.diagnosis.engines import Engine
from tossid.diagnosis.fitting import Evidence, Fitted, Hypothesis, derivatives, fit, toss_sums
from tossid.diagnosis.gap import deviance
from tossid.diagnosis.windows import Windows, linearise
from tossid.physics.effects import Effect

Array = NDArray[np.float64]
Tell = Callable[[str], None]

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
LARGEST_CLASS = 3
STEP_SHARES = (1.0, 0.3, 0.1, 0.03)
"""Parts of a screening step that are tried: impacts are far from linear."""
RESTARTS = 2
"""Of windows that fit badly, at the start and whenever an effect has joined."""
POLISH = 16
"""Iterations of the last fit."""


@dataclass(frozen=True)
class Candidate:
    """A hypothesis fitted and judged. effect: the one that joined last, None for none.

    log_likelihood (n,): of every toss, at values fitted to the other half. gain (n,): that over the hypothesis before.
    """

    effect: Effect | None
    fitted: Fitted
    log_likelihood: Array
    gain: Array

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
        """One-sided, of a mean gain of zero."""
        return one_sided(self.gain)

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


def halves(n: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """(n,) a random half of the tosses."""
    out = np.zeros(n, dtype=bool)
    out[rng.permutation(n)[: n // 2]] = True
    return out


class Search:
    """The tosses' windows, and the fits and judgements made with them."""

    def __init__(
        self, windows: Windows, n: int, half: NDArray[np.bool_], n_threads: int = 1, engine: Engine | None = None
    ) -> None:
        self.windows, self.n, self.half, self.n_threads = windows, n, half, n_threads
        self.engine = Engine() if engine is None else engine

    # ------------------------------------------------------------ one hypothesis

    def start(self, hypothesis: Hypothesis) -> Candidate:
        """A hypothesis as it stands, fitted to nothing but the windows' first states."""
        world = hypothesis.world()
        kept, whitening = linearise(self.windows, world, refine=6, restarts=RESTARTS, n_threads=self.n_threads)
        evidence = self.with_engine(Evidence(kept, whitening, self.n_threads), hypothesis)
        residual = evidence.residual(world)
        scales = evidence.scales(residual)
        size = len(hypothesis.flat())
        empty = np.zeros((self.n, size, size)), np.zeros((self.n, size))
        ll = evidence.log_likelihood(residual, scales, self.n)
        return Candidate(None, Fitted(hypothesis, evidence, residual, scales, *empty), ll, np.zeros(self.n))

    def with_engine(self, evidence: Evidence, hypothesis: Hypothesis) -> Evidence:
        """Evidence that knows what another engine makes of its windows."""
        world = hypothesis.world()
        other = self.engine.difference(evidence.windows, world, n_threads=self.n_threads)
        return replace(evidence, engines=(other, self.engine.expected)).renewed(world, refine=2, restarts=RESTARTS)

    def judged(self, present: Candidate, effect: Effect | None, start: Hypothesis, iterations: int = 8) -> Candidate:
        """A hypothesis fitted to all tosses, and judged across the halves."""
        fitted = fit(present.evidence, start, n_tosses=self.n, iterations=iterations)
        held = self.held_out(fitted)
        return Candidate(effect, fitted, held, held - present.log_likelihood)

    def held_out(self, fitted: Fitted) -> Array:
        """(n,) log-likelihood of each toss at values and scales fitted to the other half."""
        out, evidence = np.zeros(self.n), fitted.evidence
        for part in (self.half, ~self.half):
            other = ~part
            judge, learn = evidence.of_tosses(other), evidence.of_tosses(part)
            residual = judge.residual(fitted.of_part(part).world())
            scales = learn.scales(fitted.residual[part[evidence.windows.toss]])
            out[other] = judge.log_likelihood(residual, scales, self.n)[other]
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
        base = present.evidence.log_likelihood(now.residual, now.scales, self.n).sum()

        def gain_of(e: Evidence, hypothesis: Hypothesis) -> tuple[float, Array]:
            residual = e.residual(hypothesis.world())
            return float(e.log_likelihood(residual, now.scales, self.n).sum() - base), residual

        nothing = now.hypothesis.plus(effect)
        best = (0.0, effect, nothing)
        here = dict(zip([p.name for p in effect.parameters], nothing.values[-1], strict=True))
        begun = [(0.0, nothing, present.evidence, now.residual)]
        tried = []
        for start in effect.starts:
            values = {**here, **start}
            hypothesis = now.hypothesis.plus(effect, np.array([values[p.name] for p in effect.parameters]))
            e = present.evidence.renewed(hypothesis.world(), refine=2)
            gain, residual = gain_of(e, hypothesis)
            tried.append((gain, hypothesis, e, residual))
        if tried:
            begun.append(max(tried, key=lambda each: each[0]))
        for gain, hypothesis, e, residual in begun:
            if gain > best[0]:
                best = (gain, effect, hypothesis)
            size = len(hypothesis.flat())
            own = list(range(size - len(effect.parameters), size))
            J = derivatives(e, hypothesis, residual, own)[..., own]
            H, g = (each.sum(0) for each in toss_sums(e, residual, J, now.scales, self.n))
            delta = np.zeros(size)
            delta[own] = -np.linalg.pinv(H + 1e-9 * np.trace(H) * np.eye(len(own))) @ g
            low, high = hypothesis.bounds
            for share in STEP_SHARES:
                there = hypothesis.at(np.clip(hypothesis.flat() + share * delta * hypothesis.steps, low, high))
                gained, _ = gain_of(e, there)
                if gained > best[0]:
                    best = (gained, effect, there)
                elif gained > gain:
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
            best = simplest(good)
            alike = sorted((each for each in fitted if is_alike(best, each)), key=lambda each: -each.total)
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
            present = self._refreshed(present, POLISH)
            present, needed = self._pruned(first, present, len(library))
            tell("what could stand in for each", 0.88)
            names = {effect.name: effect for effect in library}
            for effect in present.hypothesis.effects:
                found_classes[effect.name] = self._rivals(
                    present, effect, [names[name] for name in classes.get(effect.name, ())], needed[effect.name]
                )
            history[-1] = present
        return Found(first, present, tuple(history), tried, needed, found_classes)

    def _belongs(self, first: Candidate, present: Candidate, each: Candidate, n_library: int) -> bool:
        """Whether an effect's gain is significant, and matters."""
        closes = (present.deviance - each.deviance) / max(first.deviance, 1e-9)
        return each.p_value < LEVEL / n_library and each.total > 0 and closes > MATTERS

    def _refreshed(self, present: Candidate, iterations: int = 4) -> Candidate:
        """Fitted on, with the other engine's difference as it is for these values."""
        fitted = fit(
            self.with_engine(present.evidence, present.hypothesis),
            present.hypothesis,
            n_tosses=self.n,
            iterations=iterations,
        )
        return Candidate(present.effect, fitted, self.held_out(fitted), present.gain)

    def _pruned(self, first: Candidate, present: Candidate, n_library: int) -> tuple[Candidate, dict[str, Array]]:
        """Without the effects that the others have made superfluous; and what is lost without each that stays (n,)."""
        while True:
            effects = present.hypothesis.effects
            if not effects:
                return present, {}
            if len(effects) == 1:
                return present, {effects[0].name: present.log_likelihood - first.log_likelihood}
            less = {e.name: self.judged(present, present.effect, present.hypothesis.minus(e.name), 5) for e in effects}
            needed = {name: -each.gain for name, each in less.items()}
            useless = [
                name
                for name, each in less.items()
                if one_sided(needed[name]) > LEVEL / n_library
                or (each.deviance - present.deviance) < MATTERS * first.deviance
            ]
            if not useless:
                return present, needed
            present = less[min(useless, key=lambda name: float(needed[name].sum()))]

    def _rivals(
        self, present: Candidate, effect: Effect, others: Sequence[Effect], needed: Array
    ) -> tuple[Candidate, ...]:
        """Which of its class could still stand in for an effect, with all others in."""
        inside = {e.name for e in present.hypothesis.effects}
        base = Candidate(effect, present.fitted, present.log_likelihood, needed)
        out = []
        without = replace(present, fitted=replace(present.fitted, hypothesis=present.hypothesis.minus(effect.name)))
        for other in others:
            if other.name in inside:
                continue
            _, _, start = self._screened(_unfitted(without), other)
            each = self.judged(present, other, start)
            each = replace(each, gain=needed + each.gain)
            if is_alike(base, each):
                out.append(each)
        out.sort(key=lambda each: -each.total)
        return tuple(out[: LARGEST_CLASS - 1])


def _tell_of_round(tell: Callable[[str, float], None], turn: int, name: str) -> None:
    tell(f"round {turn + 1}: {name}", 0.08 + 0.1 * turn)


def _unfitted(present: Candidate) -> Candidate:
    """With the misses of its hypothesis as it stands."""
    evidence, world = present.evidence, present.hypothesis.world()
    return replace(present, fitted=replace(present.fitted, residual=evidence.residual(world)))


def simplest(good: Sequence[Candidate]) -> Candidate:
    """The best, or a special case of it that is as good."""
    best = max(good, key=lambda each: each.total)
    while True:
        inner = [
            each
            for each in good
            if best.effect and each.name in best.effect.contains and one_sided(best.gain - each.gain) > CLASS_LEVEL
        ]
        if not inner:
            return best
        best = max(inner, key=lambda each: each.total)


def is_alike(best: Candidate, other: Candidate) -> bool:
    """Whether the tosses cannot tell `other` from `best`; a more general effect would have to be clearly better."""
    if other.effect is None or other is best or best.name in other.effect.contains or not other.total > 0:
        return False
    close = other.total > CLASS_SHARE * best.total
    return close or one_sided(best.gain - other.gain) > CLASS_LEVEL
