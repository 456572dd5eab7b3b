"""Rounds of a search for effects, and what could stand in for what they have found.

One round: every effect of the library is screened by the gain of one step (a score test, but measured), the
promising ones are fitted, and judged by the log-likelihood of tosses that took no part (eight folds). The best
joins if the gain is significant over tosses (signed ranks, Bonferroni over the library) and matters; the next round
starts from there. A special case is preferred to what contains it. Effects that the others have made superfluous
leave, after every round and at the end. Then what gained much in the round in which an effect joined is tried in its
place, with everything else in: what is not clearly worse there is its confusable class.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.evidence import Evidence, student_deviance
from tossid.diagnosis.judging import POLISH, Candidate, Judge, anywhere
from tossid.diagnosis.screening import Screened, screened
from tossid.physics.effects import Effect

Array = NDArray[np.float64]
Tell = Callable[[str, float], None]

LEVEL = 0.05
"""Family-wise level of naming an effect in a round."""
MATTERS = 0.004
"""Share of the gap that an effect must close to be named."""
MOST_EFFECTS, MOST_ROUNDS = 9, 12
"""Of a search; an effect that has joined may leave again."""
MOST_SETTLED = 3
"""Fits of all effects together, each after rounds in which another has joined."""
CANDIDATES = 6
"""Effects fitted in full in a round."""
PROMISING = 3.0
"""Gain of log-likelihood by one step, to all tosses, from which an effect is fitted."""
FAR_LESS = 0.1
"""Share of the best gain by one step, below which an effect waits."""
CLASS_LEVEL = 0.05
"""An effect whose gain is below the best's at this level (one-sided) is out of its class,"""
CLASS_SHARE = 0.8
"""if it also closes less than this share of what the best closes of the gap;"""
CLASS_GAIN = 0.4
"""and so is any that gains less than this share of the best's log-likelihood."""
MORE_GENERAL = 0.2
"""An effect that contains the best is in its class only if it is better at this level."""
LARGEST_CLASS = 3


@dataclass(frozen=True)
class Path:
    """How rounds went: hypotheses on the way, what the first round tried, what gained much in the round in which an
    effect joined, the same as judged in the last of these rounds, and the last hypothesis without each effect (none
    if nothing joined)."""

    history: tuple[Candidate, ...]
    tried: dict[str, Candidate]
    classes: dict[str, tuple[Effect, ...]]
    judged: tuple[Candidate, ...]
    less: dict[str, Candidate]

    def then(self, further: Path) -> Path:
        """With rounds that went on from its last hypothesis."""
        if further.history[-1] is self.history[-1]:
            return self
        return replace(further, tried=self.tried, classes={**self.classes, **further.classes})

    def led_by(self, leader: Candidate) -> Path:
        """With another last hypothesis; an effect that has taken another's place has the other in its class."""
        history, classes = (*self.history[:-1], leader), dict(self.classes)
        before = {effect.name: effect for effect in self.history[-1].hypothesis.effects}
        now = {effect.name: effect for effect in leader.hypothesis.effects}
        for old in before.keys() - now.keys():
            group = (before[old], *classes.pop(old, ()))
            for new in now.keys() - before.keys():
                classes[new] = tuple(each for each in group if each.name != new)
        return replace(self, history=history, classes=classes)


class Rounds:
    """Rounds over a library of effects, with one judge."""

    def __init__(self, judge: Judge, library: Sequence[Effect], tell: Tell) -> None:
        self.judge, self.library, self.tell = judge, library, tell

    def forward(self, first: Candidate, history: Sequence[Candidate], done: float = 0.0) -> Path:
        """Rounds from the last hypothesis of a history until no effect belongs."""
        history, present = list(history), history[-1]
        classes: dict[str, tuple[Effect, ...]] = {}
        tried: dict[str, Candidate] = {}
        near: list[Candidate] = []
        less: dict[str, Candidate] = {}
        for turn in range(MOST_ROUNDS):
            if len(present.hypothesis.effects) == MOST_EFFECTS:
                break
            self.tell(f"round {turn + 1}", min(done + 0.08 * turn, max(done, 0.75)))
            fitted = self.round(first, present)
            if turn == 0:
                tried = {each.name: each for each in fitted}
            good = [each for each in fitted if self.belongs(first, present, each)]
            if not good:
                break
            best = self._simplest(good)
            near = [each for each in fitted if each is not best and each.total > CLASS_GAIN * best.total]
            classes[best.name] = tuple(each.effect for each in near if each.effect is not None)
            without = {best.name: replace(present, gain=-best.gain)}
            present, less = self.pruned(first, self.refreshed(best), without)
            history.append(present)
        return Path(tuple(history), tried, classes, tuple(near), less)

    def settled(self, first: Candidate, path: Path) -> Path:
        """The path with everything in its last hypothesis fitted together; and rounds again where an effect has left or
        that has moved it as clearly as an effect would: what did not belong before may belong there."""
        known: set[frozenset[str]] = set()
        for _ in range(MOST_SETTLED):
            before = path.history[-1]
            if not before.hypothesis.effects:
                break
            self.tell("all effects together", 0.8)
            present, less = self.pruned(first, self.refreshed(before, POLISH))
            path = replace(path, history=(*path.history[:-1], present), less=less)
            names = frozenset(effect.name for effect in present.hypothesis.effects)
            stayed = len(names) == len(before.hypothesis.effects)
            clearly = self.judge.better(present, before) < LEVEL / len(self.library)
            if names in known or (stayed and not (clearly and self._matters(first, before, present))):
                break  # what had left, came and left again would do so for ever
            known.add(names)
            further = path.then(self.forward(first, path.history, 0.8))
            if further is path:
                break
            path = further
        return path

    def round(self, first: Candidate, present: Candidate, at_least: float = PROMISING) -> list[Candidate]:
        """The promising effects, of which one step gains so much at least, fitted and judged; those that gain far less
        than another only if none of the others belongs."""
        inside = {effect.name for effect in present.hypothesis.effects}
        missing = [effect for effect in self.library if effect.name not in inside]
        scored = self.judge.each(partial(screened, self.judge, present), missing)
        scored = [each for each in scored if each.gain > max(at_least, PROMISING)]
        scored = sorted(scored, key=lambda each: -each.gain)[:CANDIDATES]
        near = sum(each.gain > FAR_LESS * scored[0].gain for each in scored)
        judged = partial(self._judged, present)
        fitted = self.judge.each(judged, scored[:near])
        if not any(self.belongs(first, present, each) for each in fitted):
            fitted += self.judge.each(judged, scored[near:])
        return fitted

    def _judged(self, present: Candidate, promising: Screened) -> Candidate:
        near = promising.evidence(present)
        return self.judge.judged(present, promising.effect, promising.start, near=near)

    def belongs(self, first: Candidate, present: Candidate, each: Candidate) -> bool:
        """Whether an effect's gain is significant, and matters."""
        if not (each.p_value < LEVEL / len(self.library) and each.total > 0):
            return False
        return self._matters(first, present, each)

    def _matters(self, first: Candidate, before: Candidate, after: Candidate) -> bool:
        """Whether a share of the deviance worth naming is closed, in flight alone or in all windows."""
        closed, free = _closed(before, after), self.judge.windows.free
        whole = deviances(first.evidence, first.fitted.residual)
        return any(part.any() and closed[part].sum() > MATTERS * whole[part].sum() for part in (free, ~free))

    def refreshed(self, present: Candidate, rounds: int = 1) -> Candidate:
        """Everything fitted on, with the other engine's difference as it is for these values."""
        fitted = self.judge.polished(present.evidence, present.hypothesis, rounds)
        return Candidate(present.effect, fitted, self.judge.held_out(fitted), present.gain, present.shown)

    def pruned(
        self, first: Candidate, present: Candidate, known: Mapping[str, Candidate] | None = None
    ) -> tuple[Candidate, dict[str, Candidate]]:
        """Without the effects that the others have made superfluous, but for those that are held; and what remains
        without each that stays.

        Args:
            known: what remains without effects that have just been found to belong.
        """
        judge, known = self.judge, dict(known or {})
        while True:
            asked = [e.name for e in present.hypothesis.effects if e.name not in judge.held | known.keys()]
            found = dict(zip(asked, judge.each(partial(_without, judge, present), asked), strict=True))
            gained = {name: judge.parts(-each.gain) for name, each in found.items()}
            useless = [
                name
                for name, gain in gained.items()
                if gain[0].sum() <= 0
                or anywhere(gain) > LEVEL / len(self.library)
                or not self._matters(first, found[name], present)
            ]
            if not useless:
                return present, {**known, **found}
            present, known = found[min(useless, key=lambda name: gained[name][0].sum())], {}

    def _simplest(self, good: Sequence[Candidate]) -> Candidate:
        """The best, or a special case of it, if what it has beyond that is too little to be an effect of its own."""
        level, best = LEVEL / len(self.library), max(good, key=lambda each: each.total)
        while True:
            special = () if best.effect is None else best.effect.contains
            inner = [each for each in good if each.name in special and self.judge.better(best, each) > level]
            if not inner:
                return best
            best = max(inner, key=lambda each: each.total)

    # ------------------------------------------------------------ classes

    def stand_ins(
        self, present: Candidate, less: Mapping[str, Candidate], path: Path
    ) -> tuple[dict[str, Candidate], dict[str, tuple[Candidate, ...]]]:
        """Each effect that is not held against the hypothesis without it, and what of its class could still stand in
        for it."""
        inside = {effect.name for effect in present.hypothesis.effects}
        needed, found = {}, {}
        for effect in present.hypothesis.effects:
            if effect.name in self.judge.held:
                continue
            gain = -less[effect.name].gain
            needed[effect.name] = replace(present, effect=effect, gain=gain, shown=self.judge.parts(gain))
            rivals = [each for each in path.classes.get(effect.name, ()) if each.name not in inside]
            found[effect.name] = self._rivals(less[effect.name], needed[effect.name], rivals, path.judged)
        return needed, found

    def led(self, present: Candidate, classes: Mapping[str, Sequence[Candidate]]) -> Candidate:
        """The hypothesis, or the one of those with another of a class in its effect's place that clearly leads it.

        All are fitted anew: first states that have long followed one of them hold the others back.
        """
        rivals = [(name, each) for name, group in classes.items() for each in group]
        if not rivals:
            return present
        own, *fitted = self.judge.each(self._anew, [present, *(each for _, each in rivals)])
        best = own if self.judge.better(own, present) < CLASS_LEVEL else present
        ahead = [
            each
            for (name, rival), each in zip(rivals, fitted, strict=True)
            if self.leads(each, best, rival.effect, name)
        ]
        return max(ahead, key=lambda each: float(self.judge.contest(each, best).sum()), default=best)

    def _anew(self, one: Candidate) -> Candidate:
        """A hypothesis fitted from first states that are sought for it alone."""
        begun = self.judge.start(one.hypothesis)
        return self.refreshed(replace(one, fitted=begun.fitted), POLISH)

    def leads(self, one: Candidate, other: Candidate, effect: Effect | None, instead: str) -> bool:
        """Whether a hypothesis with an effect in place of another is clearly better; what contains the other always
        fits as well, and has to be better by as much as belongs."""
        contains = effect is not None and instead in effect.contains
        return self.judge.better(one, other) < (LEVEL / len(self.library) if contains else CLASS_LEVEL)

    def _alike(self, before: Candidate, best: Candidate, other: Candidate) -> bool:
        """Whether the tosses cannot tell `other` from `best`; a more general effect always fits as well."""
        judge = self.judge
        if other.effect is None or other is best or not other.total > max(0.0, CLASS_GAIN * best.total):
            return False
        if best.name in other.effect.contains:
            return judge.better(other, best) < MORE_GENERAL
        closes = (judge.of_tosses(_closed(before, each)).sum() for each in (other, best))
        return next(closes) > CLASS_SHARE * next(closes) or judge.better(best, other) > CLASS_LEVEL

    def _rivals(
        self, without: Candidate, best: Candidate, others: Sequence[Effect], known: Sequence[Candidate]
    ) -> tuple[Candidate, ...]:
        """Which of its class could still stand in for an effect, with all others in; those `known`, if judged in the
        same company, as they were."""
        company = {effect.name for effect in without.hypothesis.effects}
        same = {
            each.name: each
            for each in known
            if {effect.name for effect in each.hypothesis.effects} == company | {each.name}
        }

        def judged(other: Effect) -> Candidate:
            return same.get(other.name) or self._judged(without, screened(self.judge, without, other))

        out = [each for each in self.judge.each(judged, others) if self._alike(without, best, each)]
        out.sort(key=lambda each: -each.total)
        return tuple(out[: LARGEST_CLASS - 1])


def deviances(evidence: Evidence, residual: Array) -> Array:
    """(W,) Student's deviance of all windows' misses."""
    out: Array = np.where(evidence.windows.inside[..., None], student_deviance(residual), 0.0).sum((1, 2))
    return out


def _closed(before: Candidate, after: Candidate) -> Array:
    """(W,) how much deviance a hypothesis has less than another."""
    return deviances(before.evidence, before.fitted.residual) - deviances(after.evidence, after.fitted.residual)


def _without(judge: Judge, present: Candidate, name: str) -> Candidate:
    return judge.judged(present, None, present.hypothesis.minus(name), 5)
