"""Whether an effect takes steps or drifts, and at which rate.

What a toss says of an effect by one step of Gauss-Newton is far from the value that it has where that is far from the
simulator's. So the effect is fitted to each toss alone. A line and steps are then regressed on the same values with the
same scatter between tosses, and compared by their cost.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.fitting import Fitted, fit
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.sessions.moments import moments_of_steps, steps_at
from tossid.diagnosis.sessions.regression import robust_regression
from tossid.diagnosis.sessions.stretches import EffectOverOrder, fitted_stretches, intervals
from tossid.physics.effects import Effect
from tossid.settings.diagnosis.order import OrderSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Alone:
    """An effect fitted to each toss alone.

    Attributes:
        effect: The effect.
        edges: The tosses that have windows, the first of all for the first of these, and the number of tosses.
        fits: Of these tosses.
        values: (n, P) the effect's parameters in its steps.
        info: (n, P, P) their information; 0 of tosses that say nothing.
    """

    effect: Effect
    edges: tuple[int, ...]
    fits: tuple[Fitted, ...]
    values: Array
    info: Array


def fitted_alone(present: Candidate, effect: Effect, validator: CrossValidator, near: Sequence[Array]) -> Alone:
    """An effect beside a hypothesis, fitted to each toss alone.

    Args:
        present: The hypothesis.
        effect: The effect.
        validator: Of all windows.
        near: The effect's parameters (P,) in each toss from which its fit starts, as of `fitted_stretches`.
    """
    tosses = np.unique(present.evidence.windows.toss).tolist()
    edges = (0, *tosses[1:], validator.n)
    fits = fitted_stretches(present, effect, edges, validator, near=[near[i] for i in tosses])
    size = len(effect.parameters)
    values, info = np.zeros((validator.n, size)), np.zeros((validator.n, size, size))
    for i, one in zip(tosses, fits, strict=True):
        at = one.hypothesis.place_of(effect.name)
        values[i], info[i] = one.hypothesis.flat()[at] / one.hypothesis.steps[at], one.H[i][at, at]
    return Alone(effect, edges, fits, values, info)


def follows_line(
    values: Array, info: Array, at: Sequence[int], settings: OrderSettings, *, known: Collection[int] = ()
) -> bool:
    """Whether values of tosses follow a line rather than steps.

    Both are robust regressions, with the scatter between tosses of that which leaves less. Twice their costs are
    compared, with log n for each number (Schwarz 1978): a slope of each parameter, or for each step its heights and its
    moment.

    Args:
        values: (n, P) of an effect's parameters.
        info: (n, P, P) their information.
        at: First tosses after the steps; each is moved to where it is likeliest.
        settings: From which distance on a toss counts no more, and how far a moment may move.
        known: First tosses of sessions of the dataset. A step at one does not cost its moment.
    """
    n, outlier, moments = len(values), settings.outlier, len(set(at) - set(known))
    at = moments_of_steps((values, info, np.empty((n, 0))), at, settings)
    designs = (_line(n), steps_at(at, n))
    scatter = min(robust_regression(values, info, design, outlier=outlier).scatter for design in designs)
    line, steps = (robust_regression(values, info, each, outlier=outlier, scatter=scatter) for each in designs)
    return line.cost < steps.cost + moments * float(np.log(steps.n))


def drifting(alone: Alone, validator: CrossValidator, settings: OrderSettings, p_value: float) -> EffectOverOrder:
    """An effect that drifts at a constant rate.

    Args:
        alone: The effect fitted to each toss alone.
        validator: Of all windows.
        settings: From which distance on a toss counts no more.
        p_value: Of the change.
    """
    n, effect, hypothesis = len(alone.values), alone.effect, alone.fits[0].hypothesis
    steps, held = hypothesis.steps[hypothesis.place_of(effect.name)], frozenset(hypothesis.names) - {effect.name}
    line, found = _line(n), robust_regression(alone.values, alone.info, _line(n), outlier=settings.outlier)

    def combined(*weights: float) -> dict[str, Interval]:
        w = np.array(weights)
        variance = np.einsum("i,ipjp,j->p", w, found.covariance, w)
        return intervals(effect, w @ found.coefficients * steps, variance * steps**2, found.n - 2)

    values, fits = np.empty((n, len(steps))), []
    for one, a, b in zip(alone.fits, alone.edges[:-1], alone.edges[1:], strict=True):
        place, flat = one.hypothesis.place_of(effect.name), one.hypothesis.flat()
        flat[place] = (found.coefficients[0] + line[a] * found.coefficients[1]) * steps
        at = one.hypothesis.clipped(flat)
        values[a:b] = at.values_of(effect.name)
        fits.append(fit(one.evidence, at, n_tosses=validator.n, iterations=0, held=held))
    slope, of_slope = found.coefficients[1], found.covariance[1, :, 1]
    differ = float(chi2.sf(slope @ np.linalg.pinv(of_slope) @ slope, len(slope)))
    ends = (combined(1.0, line[0, 0]), combined(1.0, line[-1, 0]))
    return EffectOverOrder(
        effect,
        "drift",
        alone.edges,
        values,
        p_value,
        differ,
        combined(1.0, 0.0),
        ends,
        combined(0.0, 1.0),
        tuple(fits),
    )


def _line(n: int) -> Array:
    """(n, 1) numbers of tosses, about their mean."""
    return np.arange(n, dtype=np.float64)[:, None] - 0.5 * (n - 1)
