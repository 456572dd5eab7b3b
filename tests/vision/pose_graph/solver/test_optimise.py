"""The optimiser against a closed form, where Gauss-Newton alone would diverge, and where nothing is determined."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from tossid.errors import SolverError
from tossid.settings.tracking import GraphSettings
from tossid.vision.pose_graph.priors import clock_key
from tossid.vision.pose_graph.solver.optimise import marginals_of, optimise

SETTINGS, KEY = GraphSettings(), clock_key(0)


def _graph(residual: object, sigma: float = 1.0) -> gtsam.NonlinearFactorGraph:
    """A graph of one factor of a single number x; residual(x) gives r and dr/dx."""

    def error(_: object, values: gtsam.Values, H: list[np.ndarray] | None) -> np.ndarray:
        r, slope = residual(values.atDouble(KEY))  # type: ignore[operator]
        if H is not None:
            H[0] = np.array([[slope]])
        return np.array([r])

    graph = gtsam.NonlinearFactorGraph()
    graph.add(gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(1, sigma), [KEY], error))
    return graph


def _at(x: float) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(KEY, x)
    return values


def test_two_priors_meet_at_their_weighted_mean() -> None:
    graph = gtsam.NonlinearFactorGraph()
    for mean, sigma in ((1.0, 1.0), (4.0, 0.5)):
        graph.add(gtsam.PriorFactorDouble(KEY, mean, gtsam.noiseModel.Isotropic.Sigma(1, sigma)))
    values = optimise(graph, _at(10.0), settings=SETTINGS)
    assert values.atDouble(KEY) == pytest.approx((1.0 + 4 * 4.0) / 5)
    assert marginals_of(graph, values, {KEY}, settings=SETTINGS).joint([KEY])[0, 0] == pytest.approx(1 / 5)


def test_damping_holds_a_step_that_would_diverge() -> None:
    """Newton's method on atan(x) diverges from |x| > 1.39."""
    graph = _graph(lambda x: (np.arctan(x), 1 / (1 + x * x)))
    assert optimise(graph, _at(3.0), settings=SETTINGS).atDouble(KEY) == pytest.approx(0.0, abs=1e-4)


def test_an_error_that_is_never_finite_is_refused() -> None:
    with pytest.raises(SolverError, match="no finite error"):
        optimise(_graph(lambda x: (np.nan, 1.0)), _at(0.0), settings=SETTINGS)


def test_what_nothing_determines_has_the_weak_priors_covariance() -> None:
    graph = _graph(lambda x: (0.0, 0.0))
    marginals = marginals_of(graph, _at(0.0), {KEY}, settings=SETTINGS)
    assert marginals.joint([KEY])[0, 0] == pytest.approx(SETTINGS.weak_prior**2)
