"""The nearest least squares of a pose graph, and its covariances (GTSAM)."""

from __future__ import annotations

import gtsam
import numpy as np

from tossid.errors import SolverError
from tossid.least_squares import Damping, search_damping
from tossid.settings.tracking import GraphSettings

DIMENSIONS = {"o": 1, "j": 1, "p": 3}
"""Of clocks, joints and prints, by the letter of their keys; poses have six."""
LEVENBERG = Damping(grow=100.0, fall=0.1, least=0.01, vanish=1.0)
"""Gauss-Newton's steps, undamped, until one fails; then λ is 1, 100, …"""
MOST_DAMPING = 1e12
"""λ above which steps are too small to change anything."""


def optimise(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, *, settings: GraphSettings) -> gtsam.Values:
    """The values at the nearest minimum of the graph's squared error, by Levenberg's damped Gauss-Newton steps.

    GTSAM's own optimisers need time that grows with the square of the number of time steps before they start.

    Args:
        graph: The factors.
        values: Where to start.
        settings: Number of steps.

    Raises:
        SolverError: The error at the start is not finite, and no step makes it so.
    """
    if not values.size():
        return values
    error, damping = graph.error(values), 0.0
    for _ in range(settings.iterations):
        linear, here = graph.linearize(values), values

        def attempt(
            damping: float,
            linear: gtsam.GaussianFactorGraph = linear,
            here: gtsam.Values = here,
            least: float = error,
        ) -> tuple[gtsam.Values, float] | None:
            try:
                moved = here.retract(_damped(linear, here, damping).optimize())
                new = graph.error(moved)
            except RuntimeError:  # singular: only a damped step exists
                return None
            return (moved, new) if new <= least else None

        step, damping = search_damping(attempt, damping, LEVENBERG, most=MOST_DAMPING)
        if step is None:
            if not np.isfinite(error):
                raise SolverError("the pose graph has no finite error at its first poses")
            return values
        values, gain, error, damping = step[0], error - step[1], step[1], LEVENBERG.accepted(damping)
        if gain <= 1e-7 + 1e-9 * error:
            break
    return values


def marginals_of(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, *, settings: GraphSettings
) -> gtsam.Marginals:
    """Covariances of all values; where the graph leaves some undetermined, with a weak prior on each.

    Args:
        graph: The factors.
        values: At the minimum.
        settings: Standard deviation of the weak prior.

    Raises:
        SolverError: Even with the prior, some value is not determined.
    """
    try:
        return gtsam.Marginals(graph, values)
    except RuntimeError:
        pass
    try:
        return gtsam.Marginals(_damped(graph.linearize(values), values, settings.weak_prior**-2), values)
    except RuntimeError as error:
        what = str(error).partition("Symbol: ")[2].partition(")")[0]
        raise SolverError(f"the sightings do not determine every pose of the graph (near {what})") from error


def _damped(linear: gtsam.GaussianFactorGraph, values: gtsam.Values, damping: float) -> gtsam.GaussianFactorGraph:
    if not damping:
        return linear
    out = gtsam.GaussianFactorGraph()
    out.push_back(linear)
    for key in values.keys():  # noqa: SIM118  (not a dict)
        n = DIMENSIONS.get(chr(gtsam.Symbol(key).chr()), 6)
        out.add(gtsam.JacobianFactor(key, np.sqrt(damping) * np.eye(n), np.zeros(n), gtsam.noiseModel.Unit.Create(n)))
    return out
