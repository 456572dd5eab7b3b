"""What the tosses say of each effect of a library: its verdict, its values, and the size that they would reveal."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.findings import Change, EffectVerdict, Felt, Finding
from tossid.diagnosis.inference.final_values import DEGREES
from tossid.diagnosis.inference.found import Found
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.judge import Fold, Frequencies, lost_without
from tossid.diagnosis.inference.screening import Candidate, Screening
from tossid.diagnosis.inference.verdict import DETECTABLE, Facts, verdict_of_found, verdict_of_others
from tossid.diagnosis.localisation.gap import Rows, is_clear, share_closed_in
from tossid.physics.effects import Effect
from tossid.types import Phase

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Judgement:
    """A search and what its judge has seen.

    Attributes:
        found: By the search over all tosses.
        folds: Without which it was repeated.
        frequency: How often effects are named; None if the search was not repeated.
        before: Rows of the simulator as it is stated.
        after: Rows with what was found without them.
        floor: (K,) expected deviance of noise alone in each channel.
        felt: How whole tosses change without each effect that was found, by its name.
        worse: Effects with which whole tosses that took no part are predicted worse.
        variance: (P,) of an effect's parameters beside that over tosses, by its name.
        beyond_solvers: Whether the gap without effects is larger than what exact solvers of the same body disagree on.
    """

    found: Found
    folds: Sequence[Fold]
    frequency: Frequencies | None
    before: Rows
    after: Rows
    floor: Array
    felt: Mapping[str, Felt]
    worse: Collection[str]
    variance: Mapping[str, Array]
    beyond_solvers: bool

    def findings(self, library: Sequence[Effect]) -> tuple[Finding, ...]:
        """A finding for each effect: what is found, by how much whole tosses feel it, then the others by evidence.

        Args:
            library: The effects.
        """
        ours = sorted(map(self._found, self.found.hypothesis.effects), key=lambda f: -size_of(f.felt))
        names, alike = {f.name for f in ours}, []
        for finding in ours:
            for rival in finding.confusable_with:
                if rival not in names:
                    names.add(rival)
                    alike.append(self._in_place_of(finding, rival))
        rest = [self._not_found(effect) for effect in library if effect.name not in names]
        rest.sort(key=lambda f: (f.verdict != "not_supported", -f.evidence["gain"]))
        return (*ours, *alike, *rest)

    def _found(self, effect: Effect) -> Finding:
        """An effect of the hypothesis."""
        found, name = self.found, effect.name
        fitted, alike = found.fit_of(name), tuple(rival.effect.name for rival in found.alike(name))
        frequency, screened = self._frequency(name, *alike), self._screened(name)
        facts = Facts(alike, frequency, name in self.worse, self._closes(effect), found.has_its_law(name))
        return self._finding(
            effect,
            verdict_of_found(facts),
            float(found.needed[name].sum()),
            1.0 if screened is None else screened[1].p_value,
            parameters=fitted.intervals(name, self.variance.get(name, 0.0), DEGREES),
            gap_closed=lost_without(self.folds, name, self.floor),
            confusable_with=alike,
            detectable=_detectable(screened),
            felt=self.felt[name],
            frequency=frequency,
            correlation=fitted.correlation(name),
        )

    def _closes(self, effect: Effect) -> float:
        """The share of the gap that all effects close in flight, if flight has determined it, else in contact.

        What is left and not clearly above noise counts as closed. Where something is left in contact, its law is not
        quite right, and of a gap that is no larger than what solvers disagree on, no effect closes anything.
        """
        flown = effect.name in self.found.flown
        phases = [phase for phase in effect.phases if (phase == Phase.FLIGHT) == flown]
        if not is_clear(self.after, phases):
            return 1.0
        if not flown and not self.beyond_solvers:
            return 0.0
        return share_closed_in(self.before, self.after, phases)

    def _in_place_of(self, of: Finding, name: str) -> Finding:
        """An effect that may be the cause in the place of one that was found."""
        rival = next(r for r in self.found.alike(of.name) if r.effect.name == name)
        return self._finding(
            rival.effect,
            "candidate" if of.verdict == "candidate" else "confusable",
            of.evidence["gain"] + float(rival.gain.sum()),
            of.evidence["p_value"],
            parameters=rival.fit.intervals(name),
            gap_closed=of.gap_closed,
            confusable_with=(of.name, *(each for each in of.confusable_with if each != name)),
            frequency=self._frequency(name),
            correlation=rival.fit.correlation(name),
        )

    def _not_found(self, effect: Effect) -> Finding:
        """An effect that the search has not found."""
        screened = self._screened(effect.name)
        sizes = _detectable(screened)
        return self._finding(
            effect,
            verdict_of_others(sizes, {p.name: p.high - p.low for p in effect.parameters}),
            *((0.0, 1.0) if screened is None else (screened[1].total, screened[1].p_value)),
            detectable=sizes,
            frequency=self._frequency(effect.name),
        )

    def _finding(self, effect: Effect, verdict: EffectVerdict, gain: float, p_value: float, **more: Any) -> Finding:
        evidence = {"gain": gain, "p_value": p_value, "n_tosses": float(self.found.fit.n)}
        return Finding.of(effect, verdict, self.found.first.hypothesis.world(), evidence, **more)

    def _screened(self, name: str) -> tuple[Screening, Candidate] | None:
        """An effect as the last round that looked at it saw it."""
        seen = ((each.screening, c) for each in reversed(self.found.rounds) for c in each.screening.candidates)
        return next((one for one in seen if one[1].name == name), None)

    def _frequency(self, *names: str) -> float | None:
        return None if self.frequency is None else self.frequency.of_any(names)


def _detectable(screened: tuple[Screening, Candidate] | None) -> dict[str, float]:
    """The smallest size of each parameter that these tosses would have shown."""
    errors = {} if screened is None else screened[0].standard_errors(screened[1])
    return {name: DETECTABLE * error for name, error in errors.items()}


def size_of(felt: Felt | None) -> float:
    """How much whole tosses feel; a percent of the width counts as much as a degree.

    Args:
        felt: In both.
    """
    return 0.0 if felt is None else max(felt.position_pct, felt.rotation_deg)


def changes(findings: Sequence[Finding]) -> tuple[Change, ...]:
    """What a person changes: what whole tosses feel, that which they feel most first.

    Args:
        findings: Of all effects.
    """
    felt = sorted((f for f in findings if f.matters), key=lambda f: -size_of(f.felt))
    return tuple(
        Change(f.name, key, f.stated.get(key, 0.0), value) for f in felt for key, value in f.parameters.items()
    )


def alternatives(found: Found) -> tuple[Hypothesis, ...]:
    """Hypotheses that may be right instead: with another effect in the place of one.

    Args:
        found: By a search.
    """
    return tuple(
        found.hypothesis.with_replaced(name, rival.effect, rival.fit.hypothesis.values_of(rival.effect.name))
        for name in found.hypothesis.names
        for rival in found.alike(name)
    )
