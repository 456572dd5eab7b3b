"""An effect with values of its own in each of some stretches of tosses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2
from scipy.stats import t as student_t

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.fitting import Fitted, fit
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.sessions.correction import CORRECTABLE
from tossid.physics.effects import Effect

Array = NDArray[np.float64]
Form = Literal["steps", "drift"]


@dataclass(frozen=True, eq=False)
class EffectOverOrder:
    """An effect that is not the same in all tosses.

    Attributes:
        effect: The effect.
        form: How it goes over the order.
        edges: First tosses of the stretches that have values of their own, and the number of tosses, (k + 1,). Of steps
            these are the sessions; of a drift, each toss is one.
        values: (n, P) its parameters in each toss.
        p_value: Probability of such a change in an order that means nothing, corrected for all that was looked at.
        differ: Probability of values that differ as much between stretches if all are one, by Wald's test (1943).
        parameters: Over all tosses, the mean of each parameter.
        stretches: Of each session, the parameters; of a drift, those of the first toss and of the last.
        rate: Of a drift, the change of each parameter from toss to toss; empty of steps.
        fitted: The fits of the stretches.
    """

    effect: Effect
    form: Form
    edges: tuple[int, ...]
    values: Array
    p_value: float
    differ: float
    parameters: dict[str, Interval]
    stretches: tuple[dict[str, Interval], ...]
    rate: dict[str, Interval]
    fitted: tuple[Fitted, ...]

    @property
    def numbers(self) -> int:
        """How many numbers the change has beside the effect's mean."""
        return len(self.effect.parameters) * (1 if self.form == "drift" else len(self.edges) - 2)

    @property
    def correctable(self) -> bool:
        """Whether it is an error of the recording that can be undone toss by toss."""
        return self.effect.name in CORRECTABLE


def rows_of(present: Candidate, edges: Sequence[int], k: int) -> NDArray[np.int64]:
    """Numbers of the windows of a stretch's tosses.

    Args:
        present: With the windows.
        edges: First tosses of the stretches, and the number of tosses.
        k: Which stretch.
    """
    toss = present.evidence.windows.toss
    return np.flatnonzero((toss >= edges[k]) & (toss < edges[k + 1]))


def fitted_stretches(
    present: Candidate,
    effect: Effect,
    edges: Sequence[int],
    validator: CrossValidator,
    *,
    near: Sequence[Array],
) -> tuple[Fitted, ...]:
    """An effect beside a hypothesis, fitted to each stretch of tosses; the hypothesis's other effects stay.

    Args:
        present: The hypothesis.
        effect: The effect.
        edges: First tosses of the stretches, and n.
        validator: Of all windows.
        near: The effect's parameters (P,) in each stretch from which its fit starts, if they suit better than the
            hypothesis's.
    """
    hypothesis = present.hypothesis
    if effect.name not in hypothesis.names:
        hypothesis = hypothesis.plus(effect)
    place = hypothesis.place_of(effect.name)
    held = frozenset(hypothesis.names) - {effect.name}
    out = []
    for k in range(len(edges) - 1):
        flat = hypothesis.flat()
        flat[place] = near[k]
        start = hypothesis.at(flat)
        evidence = present.evidence.rows(rows_of(present, edges, k))
        scales = present.fitted.scales
        there, here = (evidence.log_likelihood_of(each.world(), scales) for each in (start, hypothesis))
        begin = start if evidence.weighted_gain(there, here) > 0 else hypothesis
        out.append(fit(evidence, begin, n_tosses=validator.n, held=held))
    return tuple(out)


def values_differ(values: Sequence[Array], covariances: Sequence[Array]) -> float:
    """Probability of values that differ as much if all are one, by Wald's test (1943).

    Args:
        values: (P,) of each stretch.
        covariances: (P, P) of their errors.
    """
    information = [np.linalg.pinv(cov) for cov in covariances]
    weighted = [W @ y for W, y in zip(information, values, strict=True)]
    mean = np.linalg.pinv(np.sum(information, axis=0)) @ np.sum(weighted, axis=0)
    squared = sum((y - mean) @ W @ (y - mean) for W, y in zip(information, values, strict=True))
    return float(chi2.sf(squared, (len(values) - 1) * len(mean)))


def with_steps(effect: Effect, edges: tuple[int, ...], fits: tuple[Fitted, ...], p_value: float) -> EffectOverOrder:
    """An effect that takes steps, from the fits of its stretches.

    Args:
        effect: The effect.
        edges: First tosses of the stretches, and n.
        fits: Of the stretches.
        p_value: Of the change.
    """
    n, sizes, size = edges[-1], np.diff(edges), len(effect.parameters)
    values = [one.hypothesis.values_of(effect.name) for one in fits]
    places = [one.hypothesis.place_of(effect.name) for one in fits]
    covariances = [one.covariance()[at, at] for one, at in zip(fits, places, strict=True)]
    y, var = np.array(values), np.array([np.diag(cov) for cov in covariances])
    share = (sizes / n)[:, None]
    whole = intervals(effect, (share * y).sum(0), (share**2 * var).sum(0), n - size)
    stretches = tuple(intervals(effect, y[k], var[k], int(sizes[k]) - size) for k in range(len(fits)))
    differ = values_differ(values, covariances)
    return EffectOverOrder(
        effect, "steps", edges, np.repeat(y, sizes, axis=0), p_value, differ, whole, stretches, {}, fits
    )


def intervals(effect: Effect, values: Array, variances: Array, degrees: int) -> dict[str, Interval]:
    """An effect's parameters with 95 % intervals.

    Args:
        effect: The effect.
        values: (P,) of its parameters.
        variances: (P,) of their errors.
        degrees: Of freedom.
    """
    half = student_t.ppf(0.975, max(degrees, 1)) * np.sqrt(variances)
    names = (p.name for p in effect.parameters)
    return {
        name: Interval(float(x), float(x - h), float(x + h)) for name, x, h in zip(names, values, half, strict=True)
    }
