"""The search for effects, in rounds (`rounds`): first in flight, then in contact.

First flight alone, whose model is right but for what is looked for: what acts there is found and named from windows
with no contact in them. Then all windows, with that in: contact has its say on which of a class it is, and then only
on what flight does not show; the values that flight has found stay, but for a fit of all whenever an effect has joined.

What flight shows has its name from the library's nearest. So each force is tried with another power of its state: one
that fits clearly better has another law, and no name. Nor has what differs from toss to toss.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from tossid.diagnosis.evidence import Hypothesis
from tossid.diagnosis.judging import Candidate
from tossid.diagnosis.rounds import LEVEL, Rounds
from tossid.physics.effects import OTHER_LAWS, Effect
from tossid.types import Phase

LIKELY = 0.3
"""Share of what a fit is to gain that one step has to."""
MOST_SCATTER, MOST_OF_ITSELF = 4.0, 0.1
"""Of an effect's values from toss to toss (squared), over noise and over the effect itself, for it to be the same in
all; real trackers' errors make 2 to 5 and up to 0.05."""
MOST_SWAPS = 4
"""Of an effect for another of its class, once all that belongs is in."""
OTHER_POWER = 0.5
"""By how much a force's power of its state differs at least from its law's, for the law to be another."""


@dataclass(frozen=True)
class Found:
    """What a search leaves. first: without effects. present: with all that joined and stayed. history: the hypotheses
    on the way, the first and the last among them. tried: effects by name, as judged in the first round.
    in_flight: the same of flight alone. needed: named effects, against the hypothesis without each. classes: named
    effects, what could stand in for each. flown: how many of the named, the first, flight has shown.
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


class Search(Rounds):
    """Rounds of flight, then of all, with one judge."""

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
            leader, needed, classes = self._decided(history[-1], seen.needed, seen.classes)
            history[-1] = self.refreshed(leader)
        flown = len(history[-1].hypothesis.effects)
        # what could stand in for what flight shows is tried in its place, not beside it
        decided = {each.name for group in classes.values() for each in group}
        library = [effect for effect in self.library if effect.name not in decided]
        if seen is not None and seen.unsteady:
            # beside a force that no world here has, another of flight would only make up for it
            library = [effect for effect in library if Phase.FLIGHT not in effect.phases]
        contact = self._holding(history[-1], flown, library)
        path, swaps = contact.forward(first, history, 0.2), MOST_SWAPS
        while True:
            path = contact.settled(first, path)
            present = leader = path.history[-1]
            if swaps and len(present.hypothesis.effects) > flown:
                # what contact no longer misses may tell what stood in its way before
                leader, needed, classes = self._decided(present, needed, classes, anew=True)
            if leader is present:
                self.tell("what could stand in for each", 0.88)
                needed_too, classes_too = contact.stand_ins(present, path.less, path)
                leader = contact.led(present, classes_too) if swaps else present
            if leader is present:
                break
            path, swaps = path.led_by(leader), swaps - 1
            contact = self._holding(leader, flown, library)
        needed, classes = {**needed, **needed_too}, {**classes, **classes_too}
        in_flight = {} if seen is None else seen.tried
        others = {} if seen is None else {name: each for name, each in seen.other_laws.items() if name in needed}
        unsteady = () if seen is None else tuple(name for name in seen.unsteady if name in needed)
        return Found(first, present, path.history, path.tried, in_flight, needed, classes, flown, others, unsteady)

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
        path = search.forward(first, [first])
        needed, classes = search.stand_ins(path.history[-1], path.less, path)
        others = search._of_other_laws(path.history[-1], classes)
        present = search._with_law_found(search._without_makeshifts(first, path.history[-1], others), others)
        stay = {effect.name for effect in present.hypothesis.effects}
        needed = {name: each for name, each in needed.items() if name in stay}
        unsteady = tuple(name for name in stay - others.keys() if _differs(present, name))
        unnamed = {*others, *unsteady}
        classes = {name: () if name in unnamed else group for name, group in classes.items() if name in stay}
        return Found(first, present, path.history, path.tried, {}, needed, classes, 0, others, unsteady)

    def _without_makeshifts(self, first: Candidate, present: Candidate, others: Mapping[str, Candidate]) -> Candidate:
        """Without effects that only make up for what a force of another law was taken for."""
        hypothesis = present.hypothesis
        for each in others.values():
            kept = {effect.name for effect in self.pruned(first, each)[0].hypothesis.effects}
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
        contact = Rounds(held, [effect for effect in self.library if Phase.FLIGHT not in effect.phases], _silent)
        rigid = self.judge.start(Hypothesis(base, effects, values))
        enough = LIKELY * self.judge.contest(other, rigid).sum()
        for each in contact.round(rigid, rigid, at_least=enough):
            if self.belongs(rigid, rigid, each) and self.judge.better(each, other) < LEVEL / len(self.library):
                return Hypothesis(base)
        return hypothesis

    def _holding(self, present: Candidate, flown: int, library: Sequence[Effect]) -> Rounds:
        """Rounds over a library in which the first effects of a hypothesis, which flight has shown, are held."""
        held = frozenset(effect.name for effect in present.hypothesis.effects[:flown])
        return Rounds(replace(self.judge, held=held), library, self.tell)

    def _decided(
        self,
        leader: Candidate,
        needed: dict[str, Candidate],
        classes: Mapping[str, Sequence[Candidate]],
        anew: bool = False,
    ) -> tuple[Candidate, dict[str, Candidate], dict[str, tuple[Candidate, ...]]]:
        """A hypothesis on all windows, with what flight cannot tell apart decided by contact where it can; what each
        effect is needed for, and its class, as flight has them. It is decided twice: before contact is searched, and
        when what contact missed is in.

        Args:
            needed: as flight has them, by name.
            classes: likewise.
            anew: whether first states are sought for each alone, and not only near the leader's.
        """
        judge, needed, decided = self.judge, dict(needed), {}
        near, own = None if anew else leader, None
        for name, others in classes.items():
            group, best = [needed.pop(name), *others], 0
            if others:
                own = own or judge.start(leader.hypothesis, near)
                asked = [_swapped(leader.hypothesis, name, other) for other in others]
                begun = [own, *judge.each(partial(judge.start, near=near), asked)]
                for k in range(1, len(begun)):
                    if self.leads(begun[k], begun[best], group[k].effect, group[best].name):
                        best = k
                if best:
                    leader = own = begun[best]
            needed[group[best].name] = group[best]
            decided[group[best].name] = tuple(each for each in group if each is not group[best])
        return leader, needed, decided


def _swapped(hypothesis: Hypothesis, name: str, other: Candidate) -> Hypothesis:
    """With a candidate's effect in the place of the one of that name."""
    assert other.effect is not None
    return hypothesis.with_instead(name, other.effect, other.hypothesis.values_of(other.name))


def _differs(present: Candidate, name: str) -> bool:
    """Whether an effect is clearly not the same in all tosses."""
    over_noise, over_itself = present.fitted.scatter(name)
    return over_noise > MOST_SCATTER and over_itself > MOST_OF_ITSELF


def _silent(text: str, share: float) -> None:
    pass
