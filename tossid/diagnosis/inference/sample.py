"""A sample of tosses, on which hypotheses are fitted and compared."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.inference.evidence import Evidence, collect, log_likelihood_ratio
from tossid.diagnosis.inference.fitting import Fit, fit
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.likelihood.windows import Windows

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LEAST_GAIN = 3.0
"""Of log-likelihood, by values that the other tosses determine, that an effect must bring."""
LEAST_CLOSED = 0.004
"""Share of the first deviance of flight or of contact that an effect must close."""


@dataclass(frozen=True)
class Sample:
    """The windows of n tosses.

    Attributes:
        windows: All, or those of free flight.
        n: How many tosses.
        n_threads: Of simulators, and how many hypotheses are fitted at once.
    """

    windows: Windows
    n: int
    n_threads: int = 1
    _known: list[Evidence] = field(default_factory=list, init=False, compare=False, repr=False)

    def of_tosses(self, chosen: Index) -> Sample:
        """Some of the tosses.

        Args:
            chosen: (m,) their numbers.
        """
        part = replace(self, windows=self.windows.of_tosses(chosen), n=len(chosen))
        part._known.extend(evidence.of_tosses(chosen) for evidence in self._known[:1])
        return part

    def in_flight(self) -> Sample:
        """The windows of free flight."""
        return replace(self, windows=self.windows.rows(np.flatnonzero(self.windows.free)))

    def evidence(self, hypothesis: Hypothesis) -> Evidence:
        """The evidence of a hypothesis, by the full procedure.

        The first evidence and the last ones are kept: what windows do not feel is not computed again.

        Args:
            hypothesis: The hypothesis.
        """
        alike = [e for e in self._known if e.hypothesis.law == hypothesis.law]
        for evidence in alike:
            if evidence.hypothesis.world() is hypothesis.world():
                return evidence
        flying = [e for e in alike if e.hypothesis.world().flies_like(hypothesis.world())]
        known = flying[-1] if flying else None
        evidence = collect(self.windows, hypothesis, known=known, n_threads=self.n_threads)
        self._known[:] = [*self._known[:1], *self._known[1:][-1:], evidence]
        return evidence

    def evaluated(self, evidence: Evidence) -> Fit:
        """A hypothesis at its values, nothing of which is fitted.

        Args:
            evidence: Of it.
        """
        return fit(evidence, evidence.hypothesis, n=self.n, iterations=0, held=frozenset(evidence.hypothesis.names))

    def refitted(
        self, near: Evidence, start: Hypothesis, *, iterations: int, follow: int = 0, held: frozenset[str] = frozenset()
    ) -> Fit:
        """A hypothesis fitted from given values, with the evidence of the full procedure at the end.

        Args:
            near: Evidence of a hypothesis near by.
            start: Values to begin with.
            iterations: Most steps.
            follow: Steps by which first states follow to the start.
            held: Effects whose values stay.
        """
        made = fit(near, start, n=self.n, iterations=iterations, held=held, follow=follow)
        return self.reevaluated(made, held)

    def refitted_in_full(self, start: Hypothesis, held: frozenset[str]) -> Fit:
        """A hypothesis fitted from given values, with the evidence of the full procedure at the beginning as well.

        Args:
            start: Values to begin with.
            held: Effects whose values stay.
        """
        evidence = self.evidence(start)
        return self.refitted(evidence, evidence.hypothesis, iterations=4, held=held)

    def reevaluated(self, made: Fit, held: frozenset[str] = frozenset()) -> Fit:
        """A fit with the evidence of the full procedure.

        Args:
            made: The fit.
            held: Effects whose values stay.
        """
        evidence = self.evidence(made.hypothesis)
        return fit(evidence, made.hypothesis, n=self.n, iterations=0, held=held, sizes=made.sizes)

    def ratio(self, one: Evidence, other: Evidence) -> Array:
        """(n,) robust logarithms of how much likelier tosses are under one hypothesis than under another.

        Args:
            one: Of a hypothesis.
            other: Of another.
        """
        ratio = log_likelihood_ratio(one, other)
        return np.bincount(one.windows.toss, weights=ratio, minlength=self.n).astype(float)

    def gains(self, one: Fit, other: Fit) -> Array:
        """(n,) the same at values that the other tosses determine.

        Args:
            one: A hypothesis.
            other: Another.
        """
        return self.ratio(one.evidence, other.evidence) - one.optimism() + other.optimism()

    def without(self, present: Fit, name: str, held: frozenset[str] = frozenset()) -> Fit:
        """A hypothesis without one of its effects, the others fitted again.

        Args:
            present: With it.
            name: Of the effect.
            held: Effects whose values stay.
        """
        own = present.columns_of(name)
        others = [k for k in range(len(present.free)) if k not in own]
        step = np.zeros(len(present.free))
        step[own] = -present.from_nominal(name)
        if others:
            H = present.columns.H.sum(0)
            pull = H[np.ix_(others, own)] @ step[own]
            step[others] = -np.linalg.lstsq(H[np.ix_(others, others)], pull, rcond=1e-9)[0]
        start = present.moved(step).without(name)
        return fit(present.evidence, start, n=self.n, iterations=2, held=held, follow=3)


def reduces_deviance(one: Evidence, other: Evidence, first: Evidence) -> bool:
    """Whether a hypothesis closes enough more of the deviance of flight, or of contact, than another.

    Args:
        one: Of a hypothesis.
        other: Of another.
        first: Of the simulator as it is stated, of whose deviance it is a share.
    """
    closed = other.deviances() - one.deviances()
    whole, free = first.deviances(), one.windows.free
    return any(p.any() and closed[p].sum() > LEAST_CLOSED * whole[p].sum() for p in (free, ~free))


def margin(gain: Array) -> float:
    """Difference of log-likelihood within which two hypotheses are as likely: two standard errors, and `LEAST_GAIN`.

    Args:
        gain: (n,) of each toss.
    """
    noise = np.sqrt(len(gain)) * gain.std(ddof=1) if len(gain) > 1 else np.inf
    return max(LEAST_GAIN, 2 * float(noise))
