"""The nearest least squares of a pose graph, and its covariances (GTSAM)."""

from __future__ import annotations

import gtsam
import numpy as np

from tossid.errors import SolverError

ITERATIONS = 100
"""Most steps of an optimisation."""
SIZES = {"o": 1, "j": 1, "p": 3}
"""Dimensions of clocks, joints and prints; poses have six."""
VAGUE = 3.0
"""Standard deviation [m, rad] of a pose that nothing else determines."""


def optimise(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    """The nearest least squares, by Gauss-Newton steps that are damped where they fail (Levenberg).

    GTSAM's own optimisers take time with the square of the number of time steps before they start.

    Raises:
        SolverError: the error is no number.
    """
    if not values.size():
        return values
    error, damping = graph.error(values), 0.0
    for _ in range(ITERATIONS):
        linear = graph.linearize(values)
        while True:
            try:
                better = values.retract(_damped(linear, values, damping).optimize())
                new = graph.error(better)
            except RuntimeError:  # what the sightings do not tell, damping must hold
                new = np.inf
            if new <= error:
                break
            damping = max(100 * damping, 1.0)
            if damping > 1e12:
                if not np.isfinite(error):
                    raise SolverError("the pose graph has no finite error at its first poses")
                return values
        gain, values, error, damping = error - new, better, new, damping / 10 if damping > 1 else 0.0
        if gain <= 1e-7 + 1e-9 * error:
            break
    return values


def marginals_of(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Marginals:
    """Covariances; of what the sightings hardly tell, with a prior of `VAGUE` beside."""
    try:
        return gtsam.Marginals(graph, values)
    except RuntimeError:
        pass
    try:
        return gtsam.Marginals(_damped(graph.linearize(values), values, VAGUE**-2), values)
    except RuntimeError as error:
        what = str(error).partition("Symbol: ")[2].partition(")")[0]
        raise SolverError(f"the sightings do not determine every pose of the graph (near {what})") from error


def _damped(linear: gtsam.GaussianFactorGraph, values: gtsam.Values, damping: float) -> gtsam.GaussianFactorGraph:
    if not damping:
        return linear
    out = gtsam.GaussianFactorGraph()
    out.push_back(linear)
    for key in values.keys():  # noqa: SIM118  (not a dict)
        n = SIZES.get(chr(gtsam.Symbol(key).chr()), 6)
        out.add(gtsam.JacobianFactor(key, np.sqrt(damping) * np.eye(n), np.zeros(n), gtsam.noiseModel.Unit.Create(n)))
    return out
