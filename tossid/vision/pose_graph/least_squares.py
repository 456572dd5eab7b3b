"""The nearest least squares of a pose graph, and its covariances; the factors and their linear algebra are GTSAM's."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from tossid.errors import SolverError
from tossid.least_squares import Damping, search_damping

Array = NDArray[np.float64]

WEAK_PRIOR = 3.0
"""Standard deviation of the prior that covariances are taken with where a pose is not determined [m, rad]."""
LEVENBERG = Damping(grow=100.0, fall=0.1, least=0.01, vanish=1.0)
"""Gauss-Newton's steps, undamped, until one fails; then λ is 1, 100, …"""
MOST_STEPS = 100
"""Of an optimisation."""
MOST_DAMPING = 1e12
"""λ above which steps are too small to change anything."""


def optimise(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    """The values at the nearest minimum of the graph's squared error, by Levenberg's damped Gauss-Newton steps.

    GTSAM's own optimisers take three to five times as long for 1500 time steps that share unknown tags.

    Raises:
        SolverError: The error at the start is not finite, and no step makes it so.
    """
    if not values.size():
        return values
    error, damping = graph.error(values), 0.0
    for _ in range(MOST_STEPS):
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


def _damped(linear: gtsam.GaussianFactorGraph, values: gtsam.Values, damping: float) -> gtsam.GaussianFactorGraph:
    """A linear graph with a prior of that inverse variance on every number, at zero."""
    if not damping:
        return linear
    out, zero = gtsam.GaussianFactorGraph(), values.zeroVectors()
    out.push_back(linear)
    for key in values.keys():  # noqa: SIM118  (not a dict)
        n = len(zero.at(key))
        out.add(gtsam.JacobianFactor(key, np.sqrt(damping) * np.eye(n), zero.at(key), gtsam.noiseModel.Unit.Create(n)))
    return out


def marginals_of(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Marginals:
    """Covariances of all values; where the graph leaves some undetermined, with a weak prior on each."""
    try:
        return gtsam.Marginals(graph, values)
    except RuntimeError:  # singular
        return gtsam.Marginals(_damped(graph.linearize(values), values, WEAK_PRIOR**-2), values)


def joint_covariance(marginals: gtsam.Marginals, keys: list[int]) -> Array:
    """The joint covariance of some variables, in the order of their keys."""
    if len(keys) == 1:
        return np.asarray(marginals.marginalCovariance(keys[0]))
    joint = marginals.jointMarginalCovariance(keys)
    return np.block([[joint.at(one, other) for other in keys] for one in keys])
