"""Forward selection of effects.

In a round every effect of the library is screened by the gain of one step, the promising ones are fitted in full, and
cross-validated. The best joins if its gain is significant over tosses (signed ranks, Bonferroni over the library) and
closes enough of the gap. A special case is preferred to an effect that contains it, unless a second effect is needed
where the general one does as well alone. After every round, effects that the others have made superfluous are pruned.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.screening import Screened, screen
from tossid.diagnosis.selection.significance import PARTS, fewest_tosses, part_p_value
from tossid.diagnosis.under_way import UnderWay
from tossid.physics.effects import Effect

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SelectionPath:
    """How rounds of forward selection went.

    Attributes:
        history: The hypotheses on the way.
        first_round: What the first round fitted, by name.
        classes: For each effect that joined, what gained much in the same round.
        runners_up: The same as they were fitted in the last of these rounds.
        without: The last hypothesis without each of its effects, by name; empty if none joined.
    """

    history: tuple[Candidate, ...]
    first_round: dict[str, Candidate]
    classes: dict[str, tuple[Effect, ...]]
    runners_up: tuple[Candidate, ...]
    without: dict[str, Candidate]

    def then(self, further: SelectionPath) -> SelectionPath:
        """With rounds that went on from its last hypothesis.

        Args:
            further: These rounds.
        """
        if further.history[-1] is self.history[-1]:
            return self
        return replace(further, first_round=self.first_round, classes={**self.classes, **further.classes})

    def ending_in(self, last: Candidate) -> SelectionPath:
        """With another last hypothesis; an effect that has taken another's place has the other in its class.

        Args:
            last: That hypothesis.
        """
        history, classes = (*self.history[:-1], last), dict(self.classes)
        before = {effect.name: effect for effect in self.history[-1].hypothesis.effects}
        now = {effect.name: effect for effect in last.hypothesis.effects}
        for old in before.keys() - now.keys():
            group = (before[old], *classes.pop(old, ()))
            for new in now.keys() - before.keys():
                classes[new] = tuple(each for each in group if each.name != new)
        return replace(self, history=history, classes=classes)


class ForwardSelection:
    """Rounds of forward selection over a library of effects."""

    def __init__(self, validator: CrossValidator, library: Sequence[Effect], under_way: UnderWay) -> None:
        """Rounds that may be run from any hypothesis.

        Args:
            validator: What fits and judges.
            library: The effects to choose from.
            under_way: Told what is known.
        """
        self.validator, self.library, self.under_way = validator, library, under_way
        self.settings = validator.settings.selection
        self.level = self.settings.level / max(len(library), 1)
        windows = validator.windows
        tests = 1 if windows.free.all() else PARTS
        needed = fewest_tosses(self.settings.level, tests=tests, effects=len(library))
        self.can_name = len(np.unique(windows.toss)) >= needed

    def run(
        self,
        first: Candidate,
        history: Sequence[Candidate],
        done: float = 0.0,
        until: Callable[[Candidate], bool] = lambda present: False,
    ) -> SelectionPath:
        """Rounds from the last hypothesis of a history until no effect is significant; none with too few tosses.

        Args:
            first: The hypothesis without effects, of whose gap shares are taken.
            history: The hypotheses so far.
            done: Share of the whole work that is done.
            until: Whether rounds end with a hypothesis to which an effect has been added.
        """
        history, present = list(history), history[-1]
        classes: dict[str, tuple[Effect, ...]] = {}
        first_round: dict[str, Candidate] = {}
        runners_up: list[Candidate] = []
        without: dict[str, Candidate] = {}
        general: list[tuple[str, Candidate]] = []
        for turn in range(self.settings.most_rounds if self.can_name else 0):
            if len(present.hypothesis.effects) == self.settings.most_effects:
                break
            share = min(done + 0.08 * turn, max(done, 0.75))
            self.under_way(f"round {turn + 1}", share)
            fitted = self.round(first, present, share=share)
            if turn == 0:
                first_round = {each.name: each for each in fitted}
            significant = [each for each in fitted if self.is_significant(first, present, each)]
            if not significant:
                break
            best = self._simplest(significant)
            least = self.settings.class_gain * best.total
            runners_up = [each for each in fitted if each is not best and each.total > least]
            classes[best.name] = self._rivals(best, runners_up)
            known = {best.name: replace(present, gain=-best.gain)}
            one = self._one_for_both(best, general)
            general += [(best.name, each) for each in significant if best.name in _contained(each)]
            if one is not None:
                special, both = one
                parts = [effect for effect in best.hypothesis.effects if effect.name in (special, best.name)]
                rivals = [*parts, *(effect for part in parts for effect in classes.pop(part.name, ()))]
                distinct = {effect.name: effect for effect in rivals if effect.name != both.name}
                classes[both.name] = tuple(distinct.values())
                history = [each for each in history if special not in each.hypothesis.names]
                best, known = both, {}
            present, without = self.pruned(first, self.refitted(best), known, thorough=False)
            again = [k for k, each in enumerate(history) if set(each.hypothesis.names) == set(present.hypothesis.names)]
            history.append(present)
            self.under_way.reached(present)
            if until(present):
                break
            if again:
                # what joins and leaves again would do so for ever
                history.append(self._most_likely(history[again[0] :]))
                without = {}  # they are of the one that rounds came back to
                break
        return SelectionPath(tuple(history), first_round, classes, tuple(runners_up), without)

    def refit_until_stable(self, first: Candidate, path: SelectionPath) -> SelectionPath:
        """The path with all effects of its last hypothesis fitted together.

        Rounds go on where an effect is pruned then, or where the refit moves the hypothesis as clearly as an effect
        would: what was not significant before may be significant there.

        Args:
            first: The hypothesis without effects.
            path: So far.
        """
        known: set[frozenset[str]] = set()
        for _ in range(self.settings.most_joint_refits):
            before = path.history[-1]
            if not before.hypothesis.effects:
                break
            self.under_way("all effects together", 0.8)
            refits = self.validator.settings.cross_validation.refits
            present, without = self.pruned(first, self.refitted(before, refits))
            path = replace(path, history=(*path.history[:-1], present), without=without)
            names = frozenset(present.hypothesis.names)
            same = len(names) == len(before.hypothesis.effects)
            clearly = self.validator.p_value_over(present, before) < self.level
            if names in known or (same and not (clearly and self._closes_enough(first, before, present))):
                break  # an effect that left, came back and left again would do so for ever
            known.add(names)
            further = path.then(self.run(first, path.history, 0.8))
            if further is path:
                break
            path = further
        return path

    def round(
        self, first: Candidate, present: Candidate, least_gain: float = 0.0, share: float = 0.0
    ) -> list[Candidate]:
        """The promising effects, fitted and cross-validated.

        Those that gain far less by one step than the best are fitted only if none of the others is significant.

        Args:
            first: The hypothesis without effects.
            present: To which an effect is added.
            least_gain: By one step, from which an effect is promising; the settings' if that is more.
            share: Of the whole work that is done.
        """
        promising = self.promising(present, least_gain)
        if promising:
            self.under_way(f"fitting, with {promising[0].effect.name} as the first suspect", share)
        likely = sum(each.gain > self.settings.second_choice * promising[0].gain for each in promising)
        fitted = self.validator.map(partial(self.fitted, present), promising[:likely])
        if not any(self.is_significant(first, present, each) for each in fitted):
            fitted += self.validator.map(partial(self.fitted, present), promising[likely:])
        return fitted

    def promising(self, present: Candidate, least_gain: float = 0.0) -> list[Screened]:
        """The effects that gain most by one step, the most promising first, and those that contain the first of them.

        Args:
            present: To which each is added.
            least_gain: As of `round`.
        """
        missing = [effect for effect in self.library if effect.name not in present.hypothesis.names]
        screened = self.validator.map(partial(screen, self.validator, present), missing)
        self.under_way.suspected([(each.effect, each.gain) for each in screened])
        least = max(least_gain, self.settings.least_screening_gain)
        promising = sorted((each for each in screened if each.gain > least), key=lambda each: -each.gain)
        count = self.settings.candidates
        general = (each for each in promising[count:] if promising[0].effect.name in each.effect.contains)
        return [*promising[:count], *general]

    def fitted(self, present: Candidate, promising: Screened) -> Candidate:
        """An effect fitted beside those of a hypothesis, and cross-validated.

        Args:
            present: The hypothesis.
            promising: The effect, and where its fit begins.
        """
        near = promising.evidence(present)
        return self.validator.cross_validate(present, promising.effect, promising.start, near=near)

    def is_significant(self, first: Candidate, present: Candidate, each: Candidate) -> bool:
        """Whether an effect's gain is significant, and closes enough of the gap.

        Args:
            first: The hypothesis without effects.
            present: The hypothesis without the effect.
            each: The hypothesis with it.
        """
        return each.p_value < self.level and each.total > 0 and self._closes_enough(first, present, each)

    def _closes_enough(self, first: Candidate, before: Candidate, after: Candidate) -> bool:
        """Whether a share of the deviance worth naming is closed, in free flight alone or in all other windows."""
        closed, free = deviance_closed(before, after), self.validator.windows.free
        whole = first.evidence.deviances(first.fitted.residuals)
        least = self.settings.least_closed
        return any(part.any() and closed[part].sum() > least * whole[part].sum() for part in (free, ~free))

    def refitted(self, present: Candidate, rounds: int = 1) -> Candidate:
        """A hypothesis with all parameters fitted further, and the other engine's difference as it is there.

        Args:
            present: The hypothesis.
            rounds: Most fits.
        """
        fitted = self.validator.refit(present.evidence, present.hypothesis, rounds)
        log_likelihood = self.validator.held_out_log_likelihood(fitted)
        return replace(present, fitted=fitted, log_likelihood=log_likelihood)

    def pruned(
        self,
        first: Candidate,
        present: Candidate,
        known: Mapping[str, Candidate] | None = None,
        *,
        thorough: bool = True,
    ) -> tuple[Candidate, dict[str, Candidate]]:
        """The hypothesis without effects that the others have made superfluous, but for those that are held.

        Args:
            first: The hypothesis without effects.
            present: The hypothesis.
            known: The hypothesis without an effect that has just been found significant, by name.
            thorough: Whether it is tried without those too that are clearly other than nominal.

        Returns:
            The hypothesis, and what it is without each effect that stays and that it was tried without.
        """
        validator, known = self.validator, dict(known or {})
        while True:
            asked = [name for name in present.hypothesis.names if name not in validator.held | known.keys()]
            if not thorough:
                asked = [name for name in asked if not self._is_clearly_needed(present, name)]
            without = dict(zip(asked, validator.map(partial(self.without, present), asked), strict=True))
            gains = {name: validator.gains_of(name, present.fitted, -each.gain) for name, each in without.items()}
            superfluous = [
                name
                for name, gain in gains.items()
                if gain[0].sum() <= 0
                or part_p_value(gain) > self.level
                or not self._closes_enough(first, without[name], present)
            ]
            if not superfluous:
                return present, {**known, **without}
            present, known = without[min(superfluous, key=lambda name: gains[name][0].sum())], {}

    def without(self, present: Candidate, name: str) -> Candidate:
        """The hypothesis without one effect, refitted and cross-validated.

        Args:
            present: The hypothesis.
            name: Of the effect.
        """
        return self.validator.cross_validate(present, None, present.hypothesis.minus(name), 5)

    def _is_clearly_needed(self, present: Candidate, name: str) -> bool:
        """Whether an effect's parameters are far from their nominal values (Wald's test, by its own fit)."""
        hypothesis, fitted = present.hypothesis, present.fitted
        own = hypothesis.place_of(name)
        if not np.diagonal(fitted.H.sum(0))[own].all():
            return False
        effect = hypothesis.effects[hypothesis.names.index(name)]
        away = hypothesis.values_of(name) - effect.nominal(hypothesis.base)
        cov = fitted.covariance()[own, own]
        size = np.sqrt(np.maximum(np.diag(cov), 1e-300))
        correlation = cov / np.outer(size, size)
        wald = float(away / size @ np.linalg.pinv(correlation, hermitian=True) @ (away / size))
        return not effect.near_nothing and wald > self.settings.clearly_needed

    def _rivals(self, best: Candidate, runners_up: Sequence[Candidate]) -> tuple[Effect, ...]:
        """What may stand in for an effect: what gained much beside it, and all that contains it."""
        known = tuple(each.effect for each in runners_up if each.effect is not None)
        names = {best.name, *best.hypothesis.names, *(effect.name for effect in known)}
        more = (effect for effect in self.library if best.name in effect.contains and effect.name not in names)
        return (*known, *more)

    def _one_for_both(self, best: Candidate, general: Sequence[tuple[str, Candidate]]) -> tuple[str, Candidate] | None:
        """A general effect in place of what joins and of a special case of it that joined before, if it does as well.

        Args:
            best: With what joins.
            general: Significant effects that contain one that joined before, beside the same others, with its name.

        Returns:
            The special case, and the hypothesis with the general effect; None if there is none.
        """
        names = frozenset(best.hypothesis.names)
        for special, each in general:
            others = names - {special, best.name}
            both = special in names and frozenset(each.hypothesis.names) == others | {each.name}
            if both and self.validator.p_value_over(best, each) > self.settings.class_level:
                return special, each
        return None

    def _most_likely(self, hypotheses: Sequence[Candidate]) -> Candidate:
        """The one that predicts held-out tosses best."""
        first, validator = hypotheses[0], self.validator
        return max(hypotheses, key=lambda each: float(validator.by_toss(validator.gain_over(each, first)).sum()))

    def _simplest(self, significant: Sequence[Candidate]) -> Candidate:
        """The best, or a special case of it where the best is not significantly better."""
        best = max(significant, key=lambda each: each.total)
        while True:
            inner = [
                each
                for each in significant
                if each.name in _contained(best) and self.validator.p_value_over(best, each) > self.level
            ]
            if not inner:
                return best
            best = max(inner, key=lambda each: each.total)


def _contained(candidate: Candidate) -> tuple[str, ...]:
    """Names of the special cases of the effect that joined last."""
    return () if candidate.effect is None else candidate.effect.contains


def deviance_closed(before: Candidate, after: Candidate) -> Array:
    """(W,) how much less deviance a hypothesis has than another.

    Args:
        before: The other.
        after: The hypothesis.
    """
    return before.evidence.deviances(before.fitted.residuals) - after.evidence.deviances(after.fitted.residuals)
