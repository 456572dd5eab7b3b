"""The search for the effects that explain a gap: flight as a block, then contact.

A round screens every effect of the library beside the present hypothesis, in closed form. The likeliest few are fitted,
and the simplest of those that gain as much as the best joins, if the tosses show it. Then an effect that the others
have made superfluous leaves. Where contact is rough, one effect alone shows little of what it does beside others: so
all likely ones are fitted at once, and what is not needed leaves one by one. At the end each effect is compared with
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

from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.inference.fitting import Fit, fit
from tossid.diagnosis.inference.found import Fitted, Found, Rival, Round, words
from tossid.diagnosis.inference.hypothesis import ContactLaw, Hypothesis
from tossid.diagnosis.inference.sample import Sample, closes, noise_of
from tossid.diagnosis.inference.screening import Candidate, Screening, screen
from tossid.parallel import in_threads
from tossid.physics.effects import Effect
from tossid.types import Phase

_log = logging.getLogger(__name__)
Array = NDArray[np.float64]
Item = TypeVar("Item")
Made = TypeVar("Made")

LEVEL = 0.025
"""Of each block: how often it names anything where nothing is."""
JUDGING_LEVEL = 0.25
"""The same where a search is repeated on fewer tosses: nine of twelve cannot show at `LEVEL` what twelve have shown."""
LEAST_GAIN = 3.0
"""Of log-likelihood, by values that the other tosses determine."""
TRIED, FITTED = 8, 3
"""Candidates that are tried at their starts where contact is rough, and how many are fitted in a round."""
JOINT, MOST_EFFECTS = 8, 9
"""Effects that are fitted at once at most, and effects of a hypothesis."""
ROUGH = 4.0
"""Robust size of whitened residuals of impacts or slides, in standard deviations, from which contact is rough."""
FEW = 20
"""Tosses that are searched first; the others take part where these end."""
CLEAR = 60.0
"""Wald's statistic from which no fit without an effect is needed to keep it."""
ALIKE, MOST_RIVALS = 0.8, 3
"""Share of an effect's gain from which another may be the cause in its place, and how many such are looked at."""
LEAST_AHEAD = {1: 2.0, 0: 1.0, -1: -2.0}
"""Standard errors of log-likelihood by which a hypothesis with more, as many or fewer parameters must be ahead."""
NONE: frozenset[str] = frozenset()


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
        n, begun = self.sample.n, None
        if n > 1.5 * FEW:
            few = np.sort(np.random.default_rng(self.seed).permutation(n)[:FEW])
            part = replace(self, sample=self.sample.of_tosses(few))
            begun = part._blocks(first.of_tosses(few), None)
        return self._compared(self._blocks(first, begun))

    # ---------------------------------------------------------------- flight, then contact

    def _blocks(self, first: Evidence, begun: Found | None) -> Found:
        """Both blocks, from what fewer tosses have found if they were searched before."""
        start = self.stated if begun is None else begun.hypothesis
        if not self.sample.windows.free.any():
            present = self.sample.fixed(first if begun is None else self.sample.evidence(start))
            present, rounds = self._contact(present, first, self.library, NONE)
            return Found(first, present, None, rounds)
        flight, rounds, causes = self._flight(first, begun)
        # each cause is joined by what is known of contact, and contact tells the causes apart
        beside = [] if begun is None else [(e, v) for e, v in start.items() if e.name not in begun.flown]
        options = [_with_all(replace(c.fit.hypothesis, law=start.law), beside) for c in causes]
        if options[0].effects:
            tried = [self.sample.fixed(self.sample.evidence(option)) for option in options]
        else:
            tried = [self.sample.fixed(first)]
        best = self._likeliest(tried)
        flight, held = causes[best].fit, frozenset(causes[best].fit.hypothesis.names)
        rivals = _rivals(causes, [self.sample.ratio(t.evidence, tried[best].evidence) for t in tried], best)
        # the model of flight is right but for forces: what flight does not show of them is not there
        library = tuple(effect for effect in self.library if not effect.is_force)
        present, more = self._contact(tried[best], first, library, held)
        return Found(first, present, flight, (*rounds, *more), rivals=rivals)

    def _flight(self, first: Evidence, begun: Found | None) -> tuple[Fit, tuple[Round, ...], list[_Cause]]:
        """What free flight shows, and what does the same there."""
        in_air = replace(self, sample=self.sample.in_flight(), laws=())
        there = first.rows(np.flatnonzero(self.sample.windows.free))
        flight = in_air.sample.fixed(there)
        if begun is not None and begun.flight is not None and begun.flown:
            flight = in_air.sample.refitted(there, begun.flight.hypothesis, iterations=6, follow=2)
        flying = [effect for effect in self.library if Phase.FLIGHT in effect.phases]
        flight, rounds = in_air._rounds(flight, there, flying, NONE)
        causes = [_Cause(flight, "", "")]
        for one in (*rounds, *(() if begun is None else begun.rounds)):
            joined = one.joined
            if joined is None or joined.candidate.name not in flight.hypothesis.names:
                continue
            name, least = joined.candidate.name, ALIKE * joined.candidate.total
            others = [
                c
                for c in one.screening.candidates
                # (what contains the effect always fits as well)
                if c.effect and c.total > least and name not in c.effect.contains
                if c.name not in flight.hypothesis.names
            ]
            for c in others[:MOST_RIVALS]:
                if c.effect is not None and not any((name, c.name) == (o.instead_of, o.name) for o in causes):
                    option = flight.hypothesis.instead(name, c.effect, c.start.values_of(c.name))
                    made = in_air.sample.refitted(flight.evidence, option, iterations=4)
                    # what was found beside the one may be superfluous beside the other
                    made = in_air._pruned(made, there, NONE)
                    if c.name in made.hypothesis.names:
                        causes.append(_Cause(made, name, c.name))
        return flight, tuple(rounds), causes

    def _contact(
        self, present: Fit, first: Evidence, library: Sequence[Effect], held: frozenset[str]
    ) -> tuple[Fit, tuple[Round, ...]]:
        """What contact shows beside what flight has determined."""
        if set(present.hypothesis.names) - held:
            present = self.sample.refitted(present.evidence, present.hypothesis, iterations=4, held=held)
        present, rounds = self._rounds(present, first, library, held)
        return present, tuple(rounds)

    def _likeliest(self, tried: Sequence[Fit]) -> int:
        """Which hypothesis is the likeliest at its values: the simplest of those that are as likely within noise."""
        best = 0
        for k, each in enumerate(tried):
            ahead = self.sample.ratio(each.evidence, tried[best].evidence)
            more = len(each.hypothesis.flat()) - len(tried[best].hypothesis.flat())
            if ahead.sum() > LEAST_AHEAD[int(np.sign(more))] * noise_of(ahead):
                best = k
        return best

    # ---------------------------------------------------------------- rounds

    def _rounds(
        self, present: Fit, first: Evidence, library: Sequence[Effect], held: frozenset[str]
    ) -> tuple[Fit, list[Round]]:
        """Rounds from a hypothesis until nothing more joins. Effects that are held keep their values."""
        rounds: list[Round] = []
        seen = {_contents(present.hypothesis)}
        while len(present.hypothesis.effects) < MOST_EFFECTS:
            one = self._round(present, first, library, held)
            rounds.append(one)
            if one.joined is None:
                break
            made = one.joined.fit
            made = self.sample.refitted(self.sample.evidence(made.hypothesis), made.hypothesis, iterations=4, held=held)
            present = self._pruned(made, first, held)
            of_effects = [each for each in rounds if each.joined and each.joined.candidate.effect is not None]
            if of_effects == [one] and _is_rough(present.evidence):
                present = self._all_at_once(present, first, one, held)
            if _contents(present.hypothesis) in seen:
                break
            seen.add(_contents(present.hypothesis))
        return present, rounds

    def _round(self, present: Fit, first: Evidence, library: Sequence[Effect], held: frozenset[str]) -> Round:
        """Candidates beside a hypothesis, and which of them joins."""
        sample, e = self.sample, present.evidence
        # as soon as a force is in, its law is tested too: what is sought beside it must not make up for a wrong one
        free = (effect for effect in present.hypothesis.effects if effect.name not in held)
        library = [*library, *(effect.other_power_law for effect in free if effect.other_power_law is not None)]
        rng = np.random.default_rng(self.seed)
        screening = screen(e, library, n=sample.n, free=present.free, laws=self.laws, rng=rng)
        level = JUDGING_LEVEL if self.judging else LEVEL
        gaining = [c for c in screening.candidates if c.total > LEAST_GAIN]
        laws = [c for c in gaining if c.effect is None]
        likely = [c for c in gaining if c.effect is not None and c.p_value < level]

        def begun(c: Candidate) -> Evidence:
            """A candidate at its start; another law of contact has another engine, whose difference is needed."""
            return e.near(c.start, steps=2) if c.effect is not None else sample.evidence(c.start)

        def fitted(c: Candidate, near: Evidence) -> Fitted:
            made = fit(near, near.hypothesis, n=sample.n, iterations=3, held=held)
            return Fitted(c, made, sample.gains(made, present))

        # (first states of its own make another law likelier than a secant shows, so each that gains is tried)
        likely = [*laws, *_with_special_cases(likely, TRIED if _is_rough(e) else FITTED)]
        tried = list(zip(likely, self._map(begun, likely), strict=True))
        if _is_rough(e):
            tried.sort(key=lambda each: -sample.ratio(each[1], e).sum())
            tried = tried[:FITTED]
        made = sorted(self._map(lambda each: fitted(*each), tried), key=lambda each: -each.gain.sum())
        good = [each for each in made if each.gain.sum() > LEAST_GAIN and closes(each.fit.evidence, e, first)]
        joined = _simplest(good)
        _log.debug("%s", "\n".join(_in_words(screening, made, joined)))
        self.watch(present, screening)
        return Round(present, screening, tuple(made), joined)

    def _all_at_once(self, present: Fit, first: Evidence, one: Round, held: frozenset[str]) -> Fit:
        """All likely effects together, without those that are not needed; the present hypothesis if that is better."""
        sample, before = self.sample, one.before
        law = present.hypothesis.law
        start = _with_all(replace(before.hypothesis, law=law), one.screening.together(JOINT, LEAST_GAIN))
        near = before.evidence if law is before.hypothesis.law else present.evidence
        made = sample.refitted(near, start, iterations=8, follow=4, held=held)
        made = sample.refitted(made.evidence, made.hypothesis, iterations=4, held=held)
        fewer = self._pruned(made, first, held)
        while fewer is not made:
            made, fewer = fewer, self._pruned(fewer, first, held)
        _log.debug("all at once, %.0f: %s", sample.gains(made, present).sum(), words(made.hypothesis))
        return made if sample.gains(made, present).sum() > 0 else present

    def _pruned(self, present: Fit, first: Evidence, held: frozenset[str]) -> Fit:
        """Without the effect that is needed least, if it is not needed."""
        asked = sorted((present.wald(name), name) for name in present.hypothesis.names if name not in held)
        for wald, name in asked if len(asked) > 1 else []:
            if wald > CLEAR:
                break
            without = self.sample.without(present, name, held)
            gain = self.sample.gains(present, without)
            _log.debug("without %s: Wald %.0f, loses %.1f +- %.1f", name, wald, gain.sum(), noise_of(gain))
            needed = gain.sum() > max(LEAST_GAIN, 2 * noise_of(gain))
            if not (needed and closes(present.evidence, without.evidence, first)):
                return self.sample.settled(without, held)
        return present

    def _compared(self, found: Found, *, settled: bool = False) -> Found:
        """With what each effect is needed for and what could take its place, which it does, once, if it is likelier."""
        needed, rivals = dict[str, Array](), dict(found.rivals)
        last = found.rounds[-1]
        for name in found.hypothesis.names:
            if name in found.flown:
                assert found.flight is not None
                in_air = self.sample.in_flight()
                needed[name] = in_air.gains(found.flight, in_air.without(found.flight, name))
                continue
            needed[name] = self.sample.gains(found.fit, self.sample.without(found.fit, name, found.flown))
            if last.before is not found.fit:
                continue
            close = last.screening.instead(found.fit.own(name), found.fit.away(name))
            # (what contains the effect always fits as well)
            others = [c for share, c in close if share > ALIKE and c.effect and name not in c.effect.contains]
            rivals[name] = tuple(self._map(partial(self._rival, found, name), others[:MOST_RIVALS]))
            better = [r for r in rivals[name] if r.gain.sum() > max(LEAST_GAIN, 2 * noise_of(r.gain))]
            if better and not settled:
                best = max(better, key=lambda each: each.gain.sum())
                _log.debug("%s takes the place of %s", best.effect.name, name)
                present = self.sample.settled(best.fit, found.flown)
                round_ = self._round(present, found.first, self.library, found.flown)
                return self._compared(replace(found, fit=present, rounds=(*found.rounds, round_)), settled=True)
        return replace(found, needed=needed, rivals=rivals)

    def _rival(self, found: Found, name: str, candidate: Candidate) -> Rival:
        """An effect in the place of another of the hypothesis, all fitted again."""
        assert candidate.effect is not None
        start = found.hypothesis.instead(name, candidate.effect, candidate.start.values_of(candidate.name))
        made = fit(found.fit.evidence, start, n=self.sample.n, iterations=3, held=found.flown, follow=3)
        return Rival(candidate.effect, made, self.sample.gains(made, found.fit))

    def _map(self, made: Callable[[Item], Made], items: Iterable[Item]) -> list[Made]:
        return list(in_threads(made, items, self.sample.n_threads))


@dataclass(frozen=True)
class _Cause:
    """A hypothesis of flight, and which effect it has in the place of which."""

    fit: Fit
    instead_of: str
    name: str


def _rivals(causes: Sequence[_Cause], ratios: Sequence[Array], best: int) -> dict[str, tuple[Rival, ...]]:
    """What could take the place of an effect that flight has found: causes by how likely contact makes them."""
    out = dict[str, tuple[Rival, ...]]()
    chosen = causes[best]
    for k, each in enumerate(causes):
        if k == best:
            continue
        if not chosen.name:  # the search's own choice
            name, other = each.instead_of, each.name
        elif k == 0 or each.instead_of == chosen.instead_of:
            name, other = chosen.name, each.name or chosen.instead_of
        else:
            continue
        out[name] = (*out.get(name, ()), Rival(each.fit.hypothesis.effect(other), each.fit, ratios[k]))
    return out


def _in_words(screening: Screening, fitted: Sequence[Fitted], joined: Fitted | None) -> list[str]:
    """A round in lines."""
    screened = (f"{c.name} {c.total:.0f} (p {c.p_value:.3f})" for c in screening.candidates[:6])
    lines = [f"    {f.candidate.name} {f.gain.sum():.1f}: {words(f.fit.hypothesis)}" for f in fitted]
    end = "-> " + ("nothing" if joined is None else joined.candidate.name)
    return ["screened " + ", ".join(screened), *lines, end]


def _is_rough(evidence: Evidence) -> bool:
    return bool(max(evidence.scales[[Phase.IMPACT, Phase.SLIDE]]) > ROUGH)


def _simplest(fitted: Sequence[Fitted]) -> Fitted | None:
    """Of the candidates that gain as much as the best within noise, the one with the fewest parameters."""
    chosen = fitted[0] if fitted else None
    for each in fitted[1:]:
        assert chosen is not None
        behind = fitted[0].gain - each.gain
        fewer = len(each.fit.hypothesis.flat()) < len(chosen.fit.hypothesis.flat())
        if fewer and behind.sum() < max(2 * noise_of(behind), LEAST_GAIN, 0.01 * fitted[0].gain.sum()):
            chosen = each
    return chosen


def _with_special_cases(candidates: Sequence[Candidate], most: int) -> list[Candidate]:
    """The first candidates, and those of the others that are special cases of one of them."""
    special = {name for c in candidates[:most] if c.effect is not None for name in c.effect.contains}
    return [*candidates[:most], *(c for c in candidates[most:] if c.name in special)]


def _with_all(hypothesis: Hypothesis, effects: Iterable[tuple[Effect, Array]]) -> Hypothesis:
    """A hypothesis with further effects that it has not yet."""
    for effect, values in effects:
        if effect.name not in hypothesis.names:
            hypothesis = hypothesis.plus(effect, values)
    return hypothesis


def _contents(hypothesis: Hypothesis) -> tuple[str, frozenset[str]]:
    return hypothesis.law.name, frozenset(hypothesis.names)
