"""Damped Gauss-Newton steps: one schedule of the damping, one search for a step that is accepted.

Levenberg (1944) and Marquardt (1963) solve (H + λ D) δ = -g for a step δ, with H = JᵀJ, g = Jᵀr and D the identity or
H's diagonal. Where the step is rejected, λ grows; where it is accepted, λ falls and the steps approach Gauss-Newton's.
The callers differ in what a step costs and when it is accepted, so they bring these.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Damping:
    """How the damping λ follows from which steps are accepted.

    Attributes:
        grow: Factor of λ after a rejected step.
        fall: Factor of λ after an accepted step.
        least: A rejected step counts as if λ had been at least this, so that λ = 0 can grow.
        vanish: λ up to which an accepted step sets it to zero.
    """

    grow: float
    fall: float
    least: float = 0.0
    vanish: float = 0.0

    def rejected(self, damping: float) -> float:
        """λ after a rejected step."""
        return self.grow * max(damping, self.least)

    def accepted(self, damping: float) -> float:
        """λ after an accepted step."""
        return self.fall * damping if damping > self.vanish else 0.0

    def each(self, damping: Array, accepted: NDArray[np.bool_]) -> Array:
        """λ of independent problems, each after its own step.

        Args:
            damping: λ of each problem, (n,).
            accepted: Whether its step was accepted, (n,).
        """
        fallen = np.where(damping > self.vanish, self.fall * damping, 0.0)
        return np.where(accepted, fallen, self.grow * np.maximum(damping, self.least))


def damped_step(H: Array, g: Array, damping: float, scale: Array) -> Array:
    """The step δ that solves (H + λ diag(scale)) δ = -g.

    Args:
        H: Approximate Hessian JᵀJ, (n, n).
        g: Gradient Jᵀr, (n,).
        damping: λ.
        scale: Diagonal of the damping, (n,): H's own for Marquardt's, ones for Levenberg's.
    """
    return np.asarray(-np.linalg.solve(H + damping * np.diag(scale), g))


def search_damping(
    attempt: Callable[[float], T | None],
    damping: float,
    schedule: Damping,
    *,
    trials: int | None = None,
    most: float = np.inf,
) -> tuple[T | None, float]:
    """The first step that is accepted as the damping grows, and the damping with which it was.

    Args:
        attempt: Takes λ and returns the step's outcome, None where the step is rejected.
        damping: λ of the first attempt.
        schedule: How λ grows.
        trials: Most attempts; None for no limit.
        most: λ above which the search is given up.

    Returns:
        The outcome, None if no step was accepted; and the λ of the accepted step, else the λ that comes next.
    """
    count = 0
    while damping <= most and (trials is None or count < trials):
        found = attempt(damping)
        if found is not None:
            return found, damping
        damping, count = schedule.rejected(damping), count + 1
    return None, damping
