"""The nearest least squares of a pose graph, and its covariances.

GTSAM has the factors and their least squares. Covariances are those of `elimination` where time steps meet only through
what is static, and GTSAM's where stillness connects the steps (docs/method/pose-graph.md).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Protocol

import gtsam
import numpy as np
from numpy.typing import NDArray

from tossid.errors import SolverError
from tossid.least_squares import Damping, search_damping
from tossid.settings.tracking import GraphSettings
from tossid.vision.pose_graph.solver.elimination import SingularError, covariances

DIMENSIONS = {"o": 1, "j": 1, "p": 3}
"""Of clocks, joints and prints, by the letter of their keys; poses have six."""
LEVENBERG = Damping(grow=100.0, fall=0.1, least=0.01, vanish=1.0)
"""Gauss-Newton's steps, undamped, until one fails; then λ is 1, 100, …"""
MOST_DAMPING = 1e12
"""λ above which steps are too small to change anything."""


class Marginals(Protocol):
    """Covariances of a graph's variables."""

    def joint(self, keys: list[int]) -> NDArray[np.float64]:
        """The joint covariance of some variables, in the order of their keys."""


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
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, shared: Collection[int], *, settings: GraphSettings
) -> Marginals:
    """Covariances of all values; where the graph leaves some undetermined, with a weak prior on each.

    Args:
        graph: The factors.
        values: At the minimum.
        shared: Keys of what is static, which all time steps share.
        settings: Standard deviation of the weak prior.

    Raises:
        SolverError: Even with the prior, some value is not determined.
    """
    linear, dims = graph.linearize(values), _dimensions(values)
    for weak in (0.0, settings.weak_prior**-2):
        try:
            found = covariances(linear, dims, shared, damping=weak)
            return found if found is not None else _Gtsam(gtsam.Marginals(_damped(linear, values, weak), values))
        except (RuntimeError, SingularError) as error:
            undetermined = error
    what = str(undetermined).partition("Symbol: ")[2].partition(")")[0]
    raise SolverError(f"the sightings do not determine every pose of the graph (near {what})") from undetermined


@dataclass(frozen=True, eq=False)
class _Gtsam:
    """Covariances by GTSAM."""

    marginals: gtsam.Marginals

    def joint(self, keys: list[int]) -> NDArray[np.float64]:
        if len(keys) == 1:
            return np.asarray(self.marginals.marginalCovariance(keys[0]))
        joint = self.marginals.jointMarginalCovariance(keys)
        return np.block([[joint.at(one, other) for other in keys] for one in keys])


def _dimensions(values: gtsam.Values) -> dict[int, int]:
    """Of each key, how many numbers its variable has."""
    return {key: DIMENSIONS.get(chr(gtsam.Symbol(key).chr()), 6) for key in values.keys()}  # noqa: SIM118  (not a dict)


def _damped(linear: gtsam.GaussianFactorGraph, values: gtsam.Values, damping: float) -> gtsam.GaussianFactorGraph:
    if not damping:
        return linear
    out = gtsam.GaussianFactorGraph()
    out.push_back(linear)
    for key, n in _dimensions(values).items():
        out.add(gtsam.JacobianFactor(key, np.sqrt(damping) * np.eye(n), np.zeros(n), gtsam.noiseModel.Unit.Create(n)))
    return out
