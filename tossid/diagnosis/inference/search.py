"""The search for the effects that explain a gap: flight as a block, then contact.

A round screens every effect of the library beside the present hypothesis, in closed form. The likeliest few are fitted,
and the simplest of those that gain as much as the best joins, if the tosses show it. Then an effect that the others
have made superfluous is pruned. Where contact is rough, one effect alone shows little of what it does beside others: so
all likely ones are fitted at once, and what is not needed is pruned one by one. At the end each effect is compared with
what could take its place.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.inference.alternatives import (
    ALIKE,
    MOST_RIVALS,
    FlightHypothesis,
    likeliest,
    not_containing,
    replacements,
    rival_of,
    rivals_in_flight,
    simplest,
    simplest_first,
    stands,
    with_special_cases,
)
from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.inference.fitting import Fit, fit
from tossid.diagnosis.inference.found import Fitted, Found, Rival, Round, words
from tossid.diagnosis.inference.hypothesis import ContactLaw, Hypothesis
from tossid.diagnosis.inference.sample import LEAST_GAIN, Sample, margin, reduces_deviance
from tossid.diagnosis.inference.screening import FLIPS, Candidate, Screening, screen
from tossid.parallel import in_threads
from tossid.physics.effects import Effect
from tossid.types import Phase

_log = logging.getLogger(__name__)
Array = NDArray[np.float64]
Item = TypeVar("Item")
Result = TypeVar("Result")

LEVEL = 0.025
"""Of each block: how often it names anything where nothing is."""
JUDGING_LEVEL = 0.25
"""The same where a search is repeated on fewer tosses: nine of twelve cannot show at `LEVEL` what twelve have shown."""
TRIED, FITTED = 8, 3
"""Candidates that are tried at their starts where contact is rough, and how many are fitted in a round."""
JOINT, MOST_EFFECTS = 8, 12
"""Effects that are fitted at once at most, and effects of a hypothesis."""
ROUGH = 4.0
"""Robust size of whitened residuals of impacts or slides, in standard deviations, from which contact is rough."""
FEW = 20
"""Tosses that are searched first; the others take part where these end."""
CLEAR = 60.0
"""Wald's statistic from which no fit without an effect is needed to keep it."""


@dataclass(frozen=True)
class Search:
    """A search over a sample of tosses.

    Attributes:
        sample: The tosses.
        library: The effects to choose from.
        stated: The simulator as it is stated, without effects.
        laws: Of contact, that the tosses may follow instead.
        seed: Of flips and draws.
        judging: Whether it is repeated on fewer tosses to judge what all have found, at `JUDGING_LEVEL`.
        watch: Called with what a round has reached, and what stands beside it.
    """

    sample: Sample
    library: tuple[Effect, ...]
    stated: Hypothesis
    laws: tuple[ContactLaw, ...] = ()
    seed: int = 0
    judging: bool = False
    watch: Callable[[Fit, Screening], None] = lambda present, screening: None

    def run(self, first: Evidence | None = None) -> Found:
        """The whole search: on few tosses, then from there on all.

        Args:
            first: Evidence of the simulator as it is stated, if it is known.
        """
        first = first or self.sample.evidence(self.stated)
        n, of_few = self.sample.n, None
        if n > 1.5 * FEW:
            few = np.sort(np.random.default_rng(self.seed).permutation(n)[:FEW])
            part = replace(self, sample=self.sample.of_tosses(few))
            of_few = part._blocks(first.of_tosses(few), None)
        return self._with_rivals(self._blocks(first, of_few))

    def _blocks(self, first: Evidence, of_few: Found | None) -> Found:
        """Flight, then contact, from what fewer tosses have found if they were searched before."""
        sample, known = self.sample, self.stated if of_few is None else of_few.hypothesis
        flight, rounds, rivals = None, tuple[Round, ...](), dict[str, tuple[Rival, ...]]()
        library, flown = self.library, frozenset[str]()
        if not sample.windows.free.any():
            evidence = first if of_few is None else sample.evidence(known)
        else:
            flights, rounds = self._flight(first, of_few)
            # each explanation of flight is joined by what is known of contact, and contact tells them apart
            of_contact = [(e, v) for e, v in known.items() if of_few is None or e.name not in of_few.flown]
            options = [replace(each.fit.hypothesis, law=known.law).with_all(of_contact) for each in flights]
            tried = [sample.evidence(option) for option in options] if options[0].effects else [first]
            best = likeliest(tried, sample, self.library)
            rivals = rivals_in_flight(flights, [sample.ratio(each, tried[best]) for each in tried], best)
            flight, evidence = flights[best].fit, tried[best]
            flown = frozenset(flight.hypothesis.names)
            # the model of flight is right but for forces: what flight does not show of them is not there
            library = tuple(effect for effect in self.library if not effect.is_force)
        present = sample.evaluated(evidence)
        if {*evidence.hypothesis.names} - flown:
            present = sample.refitted(evidence, evidence.hypothesis, iterations=4, held=flown)
        present, more = self._rounds(present, first, library, flown)
        return Found(first, present, flight, (*rounds, *more), rivals=rivals)

    def _flight(self, first: Evidence, of_few: Found | None) -> tuple[list[FlightHypothesis], tuple[Round, ...]]:
        """What free flight shows, and what does the same there."""
        in_air = replace(self, sample=self.sample.in_flight(), laws=())
        there = first.rows(np.flatnonzero(self.sample.windows.free))
        flight, before = in_air.sample.evaluated(there), tuple[Round, ...]()
        if of_few is not None:
            before = of_few.rounds
            if of_few.flight is not None and of_few.flown:
                flight = in_air.sample.refitted(there, of_few.flight.hypothesis, iterations=6, follow=2)
        flying = [effect for effect in self.library if Phase.FLIGHT in effect.phases]
        flight, rounds = in_air._rounds(flight, there, flying, frozenset())
        names, flights = flight.hypothesis.names, [FlightHypothesis(flight, "", "")]
        for each in (*rounds, *before):
            if each.joined is None or each.joined.candidate.name not in names:
                continue
            name, least = each.joined.candidate.name, ALIKE * each.joined.candidate.total
            alike = [c for c in each.screening.candidates if c.total > least and c.name not in names]
            for c in simplest_first(not_containing(name, alike), self.library)[:MOST_RIVALS]:
                assert c.effect is not None
                if any((name, c.name) == (other.instead_of, other.name) for other in flights):
                    continue
                option = flight.hypothesis.with_replaced(name, c.effect, c.start.values_of(c.name))
                fitted = in_air.sample.refitted(flight.evidence, option, iterations=4)
                # what was found beside the one may be superfluous beside the other
                fitted = in_air._pruned(fitted, there, frozenset())
                if c.name in fitted.hypothesis.names:
                    flights.append(FlightHypothesis(fitted, name, c.name))
        return flights, rounds

    # ---------------------------------------------------------------- rounds

    def _rounds(
        self, present: Fit, first: Evidence, library: Sequence[Effect], held: frozenset[str]
    ) -> tuple[Fit, tuple[Round, ...]]:
        """Rounds from a hypothesis until nothing more joins. Effects that are held keep their values."""
        rounds, seen = list[Round](), {present.hypothesis.contents}
        minimal: Fit | None = None  # the last one of which nothing could be pruned: that is not tried twice
        while len(present.hypothesis.effects) < MOST_EFFECTS:
            rounds.append(self._round(present, first, library, held))
            if rounds[-1].joined is None:
                fewer = present if present is minimal else self._needed_alone(present, first, held)
                if fewer is present:
                    break
                present = minimal = fewer
            else:
                joined, rounds[-1] = self._joined(rounds[-1], held)
                present = self._pruned(joined, first, held)
                minimal = present if present is joined else None
                is_first = rounds[-1].effect is not None and sum(one.effect is not None for one in rounds) == 1
                if is_first and _is_rough(present.evidence):
                    present = self._all_at_once(present, first, rounds[-1], held)
            if present.hypothesis.contents in seen:
                break
            seen.add(present.hypothesis.contents)
        return present, tuple(rounds)

    def _joined(self, made: Round, held: frozenset[str]) -> tuple[Fit, Round]:
        """The hypothesis with what has joined, or with a special case of it that stands in its place.

        That is by full evidence: what only follows a fit cannot say which of two that are alike is the simpler story.
        """
        assert made.joined is not None
        present = self.sample.refitted_in_full(made.joined.fit.hypothesis, held)
        special = () if made.effect is None else made.effect.contains
        for each in (f for f in made.fitted if f.candidate.name in special):
            simpler = self.sample.refitted_in_full(each.fit.hypothesis, held)
            if stands(simpler.hypothesis, present.hypothesis, self.sample.gains(simpler, present), self.library):
                present, made = simpler, replace(made, joined=each)
        return present, made

    def _round(self, present: Fit, first: Evidence, library: Sequence[Effect], held: frozenset[str]) -> Round:
        """Candidates beside a hypothesis, and which of them joins."""
        sample, evidence = self.sample, present.evidence
        # as soon as a force is in, its law is tested too: what is sought beside it must not make up for a wrong one
        free = (effect for effect in present.hypothesis.effects if effect.name not in held)
        library = [*library, *(effect.other_power_law for effect in free if effect.other_power_law is not None)]
        rng = np.random.default_rng(self.seed)
        level, flips = (JUDGING_LEVEL, FLIPS // 10) if self.judging else (LEVEL, FLIPS)
        screening = screen(evidence, library, n=sample.n, free=present.free, laws=self.laws, rng=rng, flips=flips)
        gaining = [c for c in screening.candidates if c.total > LEAST_GAIN]
        laws = [c for c in gaining if c.effect is None]
        likely = [c for c in gaining if c.effect is not None and c.p_value < level]

        def started(c: Candidate) -> Evidence:
            """A candidate at its start; another law of contact has another engine, whose difference is needed."""
            return sample.evidence(c.start) if c.effect is None else evidence.relinearised(c.start, steps=2)

        # (first states of its own make another law likelier than a secant shows, so each that gains is tried)
        likely = [*laws, *with_special_cases(likely, TRIED if _is_rough(evidence) else FITTED)]
        near = dict(zip(likely, self._map(started, likely), strict=True))
        if _is_rough(evidence):
            likely.sort(key=lambda c: -sample.ratio(near[c], evidence).sum())
            likely = with_special_cases(likely, FITTED)

        def fitted(candidate: Candidate) -> Fitted:
            start = near[candidate]
            there = fit(start, start.hypothesis, n=sample.n, iterations=3, held=held)
            return Fitted(candidate, there, sample.gains(there, present))

        fits = sorted(self._map(fitted, likely), key=lambda each: -each.gain.sum())
        good = [f for f in fits if f.gain.sum() > LEAST_GAIN and reduces_deviance(f.fit.evidence, evidence, first)]
        joined = simplest(good)
        made = Round(present, screening, tuple(fits), joined)
        _log.debug("%s", made)
        self.watch(present, screening)
        return made

    def _all_at_once(self, present: Fit, first: Evidence, one: Round, held: frozenset[str]) -> Fit:
        """All likely effects together, without those that are not needed; the present hypothesis if that is better."""
        sample, before = self.sample, one.before
        start = replace(before.hypothesis, law=present.hypothesis.law)
        start = start.with_all(one.screening.together(JOINT, LEAST_GAIN))
        near = before.evidence if start.law == before.hypothesis.law else present.evidence
        joint = sample.refitted(near, start, iterations=8, follow=4, held=held)
        joint = sample.refitted(joint.evidence, joint.hypothesis, iterations=4, held=held)
        joint = self._needed_alone(joint, first, held)
        gain = sample.gains(joint, present).sum()
        _log.debug("all at once, %.0f: %s", gain, words(joint.hypothesis))
        return joint if gain > 0 else present

    def _needed_alone(self, present: Fit, first: Evidence, held: frozenset[str]) -> Fit:
        """What is left when effects that are not needed have left one by one (backward elimination)."""
        fewer = self._pruned(present, first, held)
        while fewer is not present:
            present, fewer = fewer, self._pruned(fewer, first, held)
        return present

    def _pruned(self, present: Fit, first: Evidence, held: frozenset[str]) -> Fit:
        """Without the effect that is needed least, if it is not needed."""
        by_wald = sorted((present.wald(name), name) for name in present.hypothesis.names if name not in held)
        for wald, name in by_wald if len(by_wald) > 1 else []:
            if wald > CLEAR:
                break
            without = self.sample.without(present, name, held)
            gain = self.sample.gains(present, without)
            _log.debug("without %s: Wald %.0f, loses %.1f, margin %.1f", name, wald, gain.sum(), margin(gain))
            needed = gain.sum() > margin(gain)
            if not (needed and reduces_deviance(present.evidence, without.evidence, first)):
                return self.sample.reevaluated(without, held)
        return present

    # ---------------------------------------------------------------- rivals

    def _with_rivals(self, found: Found, *, replaced: bool = False) -> Found:
        """With what each effect is needed for and what could take its place, which it does, once, if it is better."""
        sample, needed, rivals = self.sample, dict[str, Array](), dict(found.rivals)
        for name in found.hypothesis.names:
            if name in found.flown:
                assert found.flight is not None
                in_air = sample.in_flight()
                needed[name] = in_air.gains(found.flight, in_air.without(found.flight, name))
                continue
            needed[name] = sample.gains(found.fit, sample.without(found.fit, name, found.flown))
            if found.rounds[-1].before is not found.fit:
                continue
            rivals[name] = tuple(self._map(partial(rival_of, sample, found, name), replacements(found, name)))
            better = [r for r in rivals[name] if stands(r.fit.hypothesis, found.hypothesis, r.gain, self.library)]
            if better and not replaced:
                best = max(better, key=lambda each: each.gain.sum())
                _log.debug("%s takes the place of %s", best.effect.name, name)
                present = sample.reevaluated(best.fit, found.flown)
                round_ = self._round(present, found.first, self.library, found.flown)
                return self._with_rivals(replace(found, fit=present, rounds=(*found.rounds, round_)), replaced=True)
        return replace(found, needed=needed, rivals=rivals)

    def _map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        return list(in_threads(function, items, self.sample.n_threads))


def _is_rough(evidence: Evidence) -> bool:
    return bool(max(evidence.scales[[Phase.IMPACT, Phase.SLIDE]]) > ROUGH)
