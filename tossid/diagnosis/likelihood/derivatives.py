"""Derivatives of whitened residuals by the parameters of effects: differences of whole predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.evidence import Evidence, Hypothesis
from tossid.physics.effects import Effect, World

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Derivatives:
    """Derivatives of whitened residuals, and where they were taken.

    Attributes:
        values: (W, L, K, P) by the parameters, in units of their steps.
        taken_at: (W, L, K) residuals that are not whitened, where they were taken.
        sizes: (P,) of the differences, in steps.
    """

    values: Array
    taken_at: Array
    sizes: Array

    def renewed(
        self, evidence: Evidence, hypothesis: Hypothesis, residuals: Array, which: Sequence[int], sizes: Array
    ) -> Derivatives:
        """Taken anew in windows whose predictions have moved since, and by parameters whose differences have changed.

        Args:
            evidence: As of `derivatives`, like the others.
            hypothesis: Where they are needed.
            residuals: (W, L, K) whitened, there.
            which: Numbers of the parameters.
            sizes: (P,) of central differences, in steps.
        """
        here, w = evidence.predicted(hypothesis.world()), evidence.windows
        moved = (np.abs(here - self.taken_at) / w.noise).max((1, 2)) > w.settings.whitening.reuse_tolerance
        resized = np.abs(np.log2(sizes / self.sizes)) > 1.0
        values = self.values.copy()
        for columns, rows in (
            ([j for j in which if resized[j]], np.arange(len(moved))),
            ([j for j in which if not resized[j]], np.flatnonzero(moved)),
        ):
            if columns and len(rows):
                new = derivatives(evidence, hypothesis, residuals, columns, sizes, rows)
                for j in columns:
                    values[rows, ..., j] = new[rows, ..., j]
        taken_at = np.where(moved[:, None, None], here, self.taken_at)
        return Derivatives(values, taken_at, np.where(resized, sizes, self.sizes))


def derivatives(
    evidence: Evidence,
    hypothesis: Hypothesis,
    residuals: Array,
    which: Sequence[int] | None = None,
    sizes: Array | None = None,
    rows: NDArray[np.int64] | None = None,
) -> Array:
    """(W, L, K, P) derivatives of whitened residuals by the parameters, in units of their steps.

    Windows that do not feel a parameter are not simulated for it.

    Args:
        evidence: At first states that suit the hypothesis.
        hypothesis: Where they are taken.
        residuals: (W, L, K) whitened, there.
        which: Numbers of the parameters by which they are taken, all if None; the others' are 0.
        sizes: (P,) of central differences, in steps; None for one-sided differences of one step.
        rows: (n,) in which windows they are taken, all if None; in the others they are 0.
    """
    flat, steps, base = hypothesis.flat(), hypothesis.steps, hypothesis.world()
    low, high = hypothesis.bounds
    J = np.zeros((*residuals.shape, len(flat)))
    asked = np.ones(len(residuals), dtype=bool) if rows is None else np.isin(np.arange(len(residuals)), rows)

    def at(j: int, value: float) -> World:
        moved = flat.copy()
        moved[j] = value
        return hypothesis.at(moved).world()

    for j in range(len(flat)) if which is None else which:
        if sizes is None:
            up = flat[j] + steps[j] if flat[j] + steps[j] <= high[j] else flat[j] - steps[j]
            there = at(j, up)
            felt = np.flatnonzero(asked & evidence.windows.feels(there, base))
            if len(felt):
                J[felt, ..., j] = (evidence.residuals(there, felt) - residuals[felt]) * (steps[j] / (up - flat[j]))
        else:
            ends = np.clip(flat[j] + np.array([-0.5, 0.5]) * sizes[j] * steps[j], low[j], high[j])
            below, above = (at(j, end) for end in ends)
            felt = np.flatnonzero(asked & (evidence.windows.feels(above, base) | evidence.windows.feels(below, base)))
            if len(felt):
                change = evidence.residuals(above, felt) - evidence.residuals(below, felt)
                J[felt, ..., j] = change * (steps[j] / (ends[1] - ends[0]))
    return J


def effect_derivatives(
    evidence: Evidence, hypothesis: Hypothesis, effect: Effect, residuals: Array
) -> tuple[Hypothesis, list[int], Array]:
    """Derivatives by one effect's parameters, at its values or, beside a hypothesis without it, where it does nothing.

    They are kept with the evidence: what changes over the order, screening, and what could be found ask for the same.

    Args:
        evidence: At first states that suit the hypothesis.
        hypothesis: With the effect or without it.
        effect: The effect.
        residuals: (W, L, K) whitened, of the hypothesis.

    Returns:
        The hypothesis with the effect, the numbers of its p parameters, and the derivatives (W, L, K, p).
    """
    beside = hypothesis.world()
    if effect.name not in hypothesis.names:
        hypothesis = hypothesis.plus(effect)
    place = hypothesis.place_of(effect.name)
    own, key = list(range(place.start, place.stop)), (id(beside), effect.name)
    if key not in evidence.slopes:
        if effect.near_nothing:
            residuals = evidence.residuals(hypothesis.world())
        evidence.slopes[key] = beside, derivatives(evidence, hypothesis, residuals, own)[..., own]
    return hypothesis, own, evidence.slopes[key][1]
