"""From which toss on an effect has another value: moments of steps, as what each toss says shows them.

That something changes is tested elsewhere (`tossid.motion.sessions.change_points`); here its place is made exact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.sessions.regression import huber, robust_regression
from tossid.motion.sessions.change_points import Change, Witness, robust_mean, without_covariates
from tossid.settings.diagnosis.order import OrderSettings

Array = NDArray[np.float64]


def clearest_steps(
    witnesses: Mapping[str, Witness], changes: Sequence[Change], settings: OrderSettings
) -> tuple[int, ...]:
    """The first tosses after changes, as the witness says in which the changes are clearest.

    Of each witness that changes, a constant and steps at its changes are fitted (Huber 1964) and compared by twice
    their cost, with log n for each of their numbers.

    Args:
        witnesses: Of `witnesses_of`.
        changes: Of `changes_over_order`; at least one.
        settings: How far a moment may move.
    """
    outlier, judged = settings.changes.outlier, []
    for name in {name for change in changes for name in change.p}:
        at = moments_of_steps(witnesses[name], [change.at for change in changes if name in change.p], settings)
        recorded, info, covariates = witnesses[name]
        values, n = without_covariates(recorded, info, covariates, outlier=outlier), len(recorded)
        parts = [slice(a, b) for a, b in pairwise((0, *at, n))]
        scatter = max(robust_mean(values[part], info[part], outlier=outlier).scatter for part in parts)
        constant, steps = (
            robust_regression(values, info, design, outlier=outlier, scatter=scatter).cost
            for design in (np.empty((n, 0)), steps_at(at, n))
        )
        judged.append((constant - steps, name, at))
    return max(judged)[2]


def steps_at(at: Sequence[int], n: int) -> Array:
    """(n, k) whether each of n tosses is after each of k steps, as 0 and 1.

    Args:
        at: First tosses after the steps.
        n: How many tosses.
    """
    return (np.arange(n)[:, None] >= np.asarray(at)).astype(float)


def moments_of_steps(witness: Witness, at: Sequence[int], settings: OrderSettings) -> tuple[int, ...]:
    """The likeliest first tosses of steps near where they were found.

    The score statistic compares both sides of a step with one mean. Here each toss has the mean of the side that it
    would be on.

    Args:
        witness: Values, information and covariates of tosses in their order.
        at: First tosses after the changes.
        settings: How far a moment may move.
    """
    recorded, info, covariates = witness
    outlier, n = settings.changes.outlier, len(recorded)
    values = without_covariates(recorded, info, covariates, outlier=outlier)
    edges = [0, *at, n]
    for k in range(1, len(edges) - 1):
        low, now, high = edges[k - 1 : k + 2]
        sides = [robust_mean(values[part], info[part], outlier=outlier) for part in (slice(low, now), slice(now, high))]
        if not all(side.n for side in sides):
            continue
        W = info @ np.linalg.inv(np.eye(values.shape[1]) + max(side.scatter for side in sides) ** 2 * info)
        cost = []
        for side in sides:
            off = np.where(np.trace(info, axis1=1, axis2=2)[:, None] > 0, values - side.value, 0.0)
            size = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", off, W, off), 0.0))
            cost.append(huber(size, outlier))
        saved = np.cumsum(cost[0] - cost[1])
        near = np.arange(max(low + 1, now - settings.largest_move), min(high - 1, now + settings.largest_move) + 1)
        edges[k] = int(near[np.argmin(saved[near - 1])])
    return tuple(edges[1:-1])


def at_sessions(at: Sequence[int], boundaries: Sequence[int], near: int) -> tuple[int, ...]:
    """Steps where sessions are known to begin, if they are nearby; no two at one toss.

    Args:
        at: First tosses after the steps.
        boundaries: First tosses of sessions.
        near: Tosses within which a step is one of these.
    """
    moved = {
        min((b for b in boundaries if abs(b - each) <= near), key=lambda b: abs(b - each), default=each) for each in at
    }
    return tuple(sorted(moved - {0}))
