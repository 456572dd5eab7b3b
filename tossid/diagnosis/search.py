"""The search for effects: screened, fitted, judged on held-out tosses, joined, and left out again.

First flight alone, whose model is right but for what is looked for: what acts there is found and named from windows
with no contact in them. Then all windows, with that in: contact has its say on which of a class it is, and then only
on what flight does not show; the values that flight has found stay, but for a fit of all whenever an effect has joined.

One round: every effect of the library is screened by the gain of one step (a score test, but measured), the
promising ones are fitted, and judged by the log-likelihood of tosses that took no part (eight folds). The best
joins if the gain is significant over tosses (signed ranks, Bonferroni over the library) and matters; the next round
starts from there. A special case is preferred to what contains it. Effects that the others have made superfluous
leave, after every round and at the end. Then what gained much in the round in which an effect joined is tried in its
place, with everything else in: what is not clearly worse there is its confusable class.

What flight shows has its name from the library's nearest. So each force is tried with another power of its state: one
that fits clearly better has another law, and no name. Nor has what differs from toss to toss.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.fitting import Evidence, Hypothesis, student_deviance
from tossid.diagnosis.judging import POLISH, Candidate, Judge, anywhere
from tossid.diagnosis.screening import Screened, screened
from tossid.physics.effects import OTHER_LAWS, Effect
from tossid.types import Phase

Array = NDArray[np.float64]
Tell = Callable[[str, float], None]

LEVEL = 0.05
"""Family-wise level of naming an effect in a round."""
MATTERS = 0.004
"""Share of the gap that an effect must close to be named."""
MOST_EFFECTS, MOST_ROUNDS = 9, 12
"""Of a search; an effect that has joined may leave again."""
CANDIDATES = 6
"""Effects fitted in full in a round."""
PROMISING = 3.0
"""Gain of log-likelihood by one step, to all tosses, from which an effect is fitted."""
FAR_LESS = 0.1
"""Share of the best gain by one step, below which an effect waits."""
LIKELY = 0.3
"""Share of what a fit is to gain that one step has to."""
CLASS_LEVEL = 0.05
"""An effect whose gain is below the best's at this level (one-sided) is out of its class,"""
CLASS_SHARE = 0.8
"""if it also closes less than this share of what the best closes of the gap;"""
CLASS_GAIN = 0.4
"""and so is any that gains less than this share of the best's log-likelihood."""
MORE_GENERAL = 0.2
"""An effect that contains the best is in its class only if it is better at this level."""
LARGEST_CLASS = 3
MOST_SCATTER = 4.0
"""Of an effect's values from toss to toss (squared), for it to be the same in all; real trackers' errors make 3."""
OTHER_POWER = 0.5
"""By how much a force's power of its state differs at least from its law's, for the law to be another."""


@dataclass(frozen=True)
class Found:
    """What a search leaves. first: without effects. present: with all that joined and stayed. history: the hypotheses
    on the way, the first and the last among them. tried: effects by name, as judged in the first round, or when
    they joined. in_flight: the same of flight alone. needed: named effects, against the hypothesis without each.
    classes: named effects, what could stand in for each. flown: how many of the named, the first, flight has shown.
    other_laws: effects that only stand in for a force of another law, each with its power of its state. unsteady:
    effects that flight shows, but not the same in all tosses. Neither has a name."""

    first: Candidate
    present: Candidate
    history: tuple[Candidate, ...]
    tried: dict[str, Candidate]
    in_flight: dict[str, Candidate]
    needed: dict[str, Candidate]
    classes: dict[str, tuple[Candidate, ...]]
    flown: int = 0
    other_laws: dict[str, Candidate] = field(default_factory=dict)
    unsteady: tuple[str, ...] = ()

    @property
    def unnamed(self) -> frozenset[str]:
        """Effects of the last hypothesis that only stand in for something else."""
        return frozenset((*self.other_laws, *self.unsteady))

    def ending(self, present: Candidate) -> Found:
        """The same, with another last hypothesis."""
        return replace(self, present=present, history=(*self.history[:-1], present))

    @property
    def swapped(self) -> tuple[Hypothesis, ...]:
        """The last hypothesis with each of the classes' others in its effect's place."""
        present = self.present.hypothesis
        return tuple(_swapped(present, name, each) for name, group in self.classes.items() for each in group)


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


class Search:
    """Rounds over a library of effects, with one judge."""

    def __init__(self, judge: Judge, library: Sequence[Effect], tell: Tell) -> None:
        self.judge, self.library, self.tell = judge, library, tell

    def run(self, hypothesis: Hypothesis) -> Found:
        """From a hypothesis without effects to those that belong."""
        seen = self._flown(hypothesis)
        if seen is not None:
            hypothesis = Hypothesis(seen.present.hypothesis.base)
        self.tell("what flight shows, in contact", 0.15)
        hypothesis = self._with_law(hypothesis, seen)
        first = self.judge.start(hypothesis)
        history: list[Candidate] = [first]
        needed: dict[str, Candidate] = {}
        classes: dict[str, tuple[Candidate, ...]] = {}
        if seen is not None and seen.present.hypothesis.effects:
            effects, values = seen.present.hypothesis.effects, seen.present.hypothesis.values
            for k in range(1, len(effects) + 1):
                history.append(self.judge.start(Hypothesis(hypothesis.base, effects[:k], values[:k]), history[-1]))
            history[-1], needed, classes = self._decided(history[-1], seen)
        flown = frozenset(effect.name for effect in history[-1].hypothesis.effects)
        library = self.library
        if seen is not None and seen.unsteady:
            # beside a force that no world here has, another of flight would only make up for it
            library = [effect for effect in library if Phase.FLIGHT not in effect.phases]
        contact = Search(replace(self.judge, held=flown), library, self.tell)
        path = contact._forward(first, history, 0.2)
        present, history = path.history[-1], list(path.history)
        if present.hypothesis.effects:
            self.tell("all effects together", 0.8)
            present, less = contact._pruned(first, contact._refreshed(present, POLISH))
            history[-1] = present
            self.tell("what could stand in for each", 0.88)
            needed_too, classes_too = contact._stand_ins(present, less, path)
            needed, classes = {**needed, **needed_too}, {**classes, **classes_too}
        in_flight = {} if seen is None else seen.tried
        others = {} if seen is None else {name: each for name, each in seen.other_laws.items() if name in needed}
        unsteady = () if seen is None else tuple(name for name in seen.unsteady if name in needed)
        return Found(
            first, present, tuple(history), path.tried, in_flight, needed, classes, len(flown), others, unsteady
        )

    # ------------------------------------------------------------ what flight shows

    def _flown(self, hypothesis: Hypothesis) -> Found | None:
        """What the windows of free flight alone show; None without such windows."""
        free = np.flatnonzero(self.judge.windows.free)
        if not len(free):
            return None
        self.tell("flight alone", 0.04)
        library = [effect for effect in self.library if Phase.FLIGHT in effect.phases]
        search = Search(replace(self.judge, windows=self.judge.windows.rows(free)), library, _silent)
        first = search.judge.start(hypothesis)
        path = search._forward(first, [first])
        needed, classes = search._stand_ins(path.history[-1], path.less, path)
        others = search._of_other_laws(path.history[-1], classes)
        present = search._with_law_found(search._without_makeshifts(first, path.history[-1], others), others)
        stay = {effect.name for effect in present.hypothesis.effects}
        needed = {name: each for name, each in needed.items() if name in stay}
        unsteady = tuple(name for name in stay - others.keys() if present.fitted.scatter(name) > MOST_SCATTER)
        unnamed = {*others, *unsteady}
        classes = {name: () if name in unnamed else group for name, group in classes.items() if name in stay}
        return Found(first, present, path.history, path.tried, {}, needed, classes, 0, others, unsteady)

    def _without_makeshifts(self, first: Candidate, present: Candidate, others: Mapping[str, Candidate]) -> Candidate:
        """Without effects that only make up for what a force of another law was taken for."""
        hypothesis = present.hypothesis
        for each in others.values():
            kept = {effect.name for effect in self._pruned(first, each)[0].hypothesis.effects}
            for effect in present.hypothesis.effects:
                if effect.name not in kept | others.keys():
                    hypothesis = hypothesis.minus(effect.name)
        return present if hypothesis is present.hypothesis else self.judge.judged(present, None, hypothesis)

    def _with_law_found(self, present: Candidate, others: Mapping[str, Candidate]) -> Candidate:
        """In a world whose force has the power found, of several the one that shows it most: what is looked for in
        contact must not make up for a wrong law."""
        if not others:
            return present
        name, each = max(others.items(), key=lambda one: one[1].total)
        law, effects = OTHER_LAWS[name], present.hypothesis.effects
        base = law.at(present.hypothesis.base, each.hypothesis.values_of(law.name))
        values = tuple(each.hypothesis.values_of(effect.name) for effect in effects)
        return self.judge.judged(present, None, Hypothesis(base, effects, values))

    def _of_other_laws(self, present: Candidate, classes: Mapping[str, Sequence[Candidate]]) -> dict[str, Candidate]:
        """Effects whose force grows with another power of its state than theirs and than their classes', with the
        power found."""
        out, level = {}, LEVEL / len(self.library)
        for name in (effect.name for effect in present.hypothesis.effects if effect.name in OTHER_LAWS):
            law = OTHER_LAWS[name]
            each = self.judge.judged(present, law, present.hypothesis.plus(law))
            clear = each.p_value < level and each.total > 0
            clear = clear and all(self.judge.better(each, other) < level for other in classes.get(name, ()))
            if clear and abs(float(each.hypothesis.values_of(law.name)[0])) > OTHER_POWER:
                out[name] = each
        return out

    def _with_law(self, hypothesis: Hypothesis, seen: Found | None) -> Hypothesis:
        """The hypothesis, with Coulomb's law in place of its relaxation if an effect of contact explains more under it.

        What is relaxed lifts what slides, and so makes up for some of what a missing bounce leaves.
        """
        relaxed = hypothesis.base
        if relaxed.law.lifting == 0 or self.judge.engine.model is not None:
            return hypothesis
        base = replace(relaxed, law=relaxed.law._replace(lifting=0.0))
        effects, values = (
            ((), ()) if seen is None else (seen.present.hypothesis.effects, seen.present.hypothesis.values)
        )
        other = self.judge.start(Hypothesis(relaxed, effects, values))
        self.tell("Coulomb's law", 0.16)
        held = replace(self.judge, held=frozenset(effect.name for effect in effects))
        contact = Search(held, [effect for effect in self.library if Phase.FLIGHT not in effect.phases], _silent)
        rigid = self.judge.start(Hypothesis(base, effects, values))
        enough = LIKELY * self.judge.contest(other, rigid).sum()
        for each in contact._round(rigid, rigid, at_least=enough):
            if self._belongs(rigid, rigid, each) and self.judge.better(each, other) < LEVEL / len(self.library):
                return Hypothesis(base)
        return hypothesis

    def _decided(
        self, leader: Candidate, seen: Found
    ) -> tuple[Candidate, dict[str, Candidate], dict[str, tuple[Candidate, ...]]]:
        """Flight's hypothesis on all windows, with what flight cannot tell apart decided by contact where it can; what
        each is needed for, and its class, as flight has them."""
        needed, classes = {}, {}
        for name, others in seen.classes.items():
            judge = self.judge
            begun = [judge.start(_swapped(leader.hypothesis, name, other), leader) for other in others]
            group = [(leader, seen.needed[name]), *zip(begun, others, strict=True)]
            best = group[0]
            for each in group[1:]:
                if judge.better(each[0], best[0]) < CLASS_LEVEL:
                    best = each
            leader = best[0]
            needed[best[1].name] = best[1]
            classes[best[1].name] = tuple(each[1] for each in group if each is not best)
        return self._refreshed(leader), needed, classes

    # ------------------------------------------------------------ rounds

    def _forward(self, first: Candidate, history: Sequence[Candidate], done: float = 0.0) -> Path:
        """Rounds from the last hypothesis of a history until no effect belongs."""
        history, present = list(history), history[-1]
        classes: dict[str, tuple[Effect, ...]] = {}
        tried: dict[str, Candidate] = {}
        near: list[Candidate] = []
        less: dict[str, Candidate] = {}
        for turn in range(MOST_ROUNDS):
            if len(present.hypothesis.effects) == MOST_EFFECTS:
                break
            self.tell(f"round {turn + 1}", min(done + 0.08 * turn, 0.75))
            fitted = self._round(first, present)
            if turn == 0:
                tried = {each.name: each for each in fitted}
            good = [each for each in fitted if self._belongs(first, present, each)]
            if not good:
                break
            best = self._simplest(good)
            near = [each for each in fitted if each is not best and each.total > CLASS_GAIN * best.total]
            classes[best.name] = tuple(each.effect for each in near if each.effect is not None)
            tried.setdefault(best.name, best)
            without = {best.name: replace(present, gain=-best.gain)}
            present, less = self._pruned(first, self._refreshed(best), without)
            history.append(present)
        return Path(tuple(history), tried, classes, tuple(near), less)

    def _round(self, first: Candidate, present: Candidate, at_least: float = PROMISING) -> list[Candidate]:
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
        if not any(self._belongs(first, present, each) for each in fitted):
            fitted += self.judge.each(judged, scored[near:])
        return fitted

    def _judged(self, present: Candidate, promising: Screened) -> Candidate:
        near = present.evidence.renewed(promising.start.world(), refine=4, restarts=1) if promising.far else None
        return self.judge.judged(present, promising.effect, promising.start, near=near)

    def _belongs(self, first: Candidate, present: Candidate, each: Candidate) -> bool:
        """Whether an effect's gain is significant, and matters."""
        if not (each.p_value < LEVEL / len(self.library) and each.total > 0):
            return False
        return self._matters(first, present, each)

    def _matters(self, first: Candidate, before: Candidate, after: Candidate) -> bool:
        """Whether a share of the deviance worth naming is closed, in flight alone or in all windows."""
        closed, free = _closed(before, after), self.judge.windows.free
        whole = deviances(first.evidence, first.fitted.residual)
        return any(part.any() and closed[part].sum() > MATTERS * whole[part].sum() for part in (free, ~free))

    def _refreshed(self, present: Candidate, rounds: int = 1) -> Candidate:
        """Everything fitted on, with the other engine's difference as it is for these values."""
        fitted = self.judge.polished(present.evidence, present.hypothesis, rounds)
        return Candidate(present.effect, fitted, self.judge.held_out(fitted), present.gain, present.shown)

    def _pruned(
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
        """The best, or a special case of it that is as good."""
        judge, best = self.judge, max(good, key=lambda each: each.total)
        while True:
            special = () if best.effect is None else best.effect.contains
            inner = [each for each in good if each.name in special and judge.better(best, each) > CLASS_LEVEL]
            if not inner:
                return best
            best = max(inner, key=lambda each: each.total)

    # ------------------------------------------------------------ classes

    def _stand_ins(
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


def _swapped(hypothesis: Hypothesis, name: str, other: Candidate) -> Hypothesis:
    """With a candidate's effect in the place of the one of that name."""
    assert other.effect is not None
    return hypothesis.with_instead(name, other.effect, other.hypothesis.values_of(other.name))


def _without(judge: Judge, present: Candidate, name: str) -> Candidate:
    return judge.judged(present, None, present.hypothesis.minus(name), 5)


def _silent(text: str, share: float) -> None:
    pass
