"""The graph's least squares against closed forms, and its covariances against the inverse of the whole Hessian."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from tossid.errors import SolverError
from tossid.vision.pose_graph.least_squares import WEAK_PRIOR, SingularError, covariances, marginals_of, optimise
from tossid.vision.pose_graph.state import clock_key

KEY = clock_key(0)
SHARED, STEPS = {1: 3, 2: 2}, {10: 3, 11: 3, 12: 3, 20: 1}


def _factor(keys: list[int], rng: np.random.Generator, rows: int = 4) -> gtsam.JacobianFactor:
    terms = [part for key in keys for part in (key, rng.normal(size=(rows, (SHARED | STEPS)[key])))]
    return gtsam.JacobianFactor(*terms, rng.normal(size=rows), gtsam.noiseModel.Isotropic.Sigma(rows, 0.3))


def _graph(seed: int = 0) -> gtsam.GaussianFactorGraph:
    """Three steps that meet in what is shared; one of them has a joint."""
    rng, graph = np.random.default_rng(seed), gtsam.GaussianFactorGraph()
    for keys in ([1], [1, 10], [10, 2], [2, 11, 1], [12, 20, 1], [20, 2], [12], [1, 2]):
        graph.add(_factor(keys, rng))
    return graph


def test_blocks_are_those_of_the_inverse_hessian() -> None:
    graph = _graph()
    found = covariances(graph, SHARED | STEPS, SHARED, damping=0.2)
    assert found is not None
    keys = graph.keyVector()
    whole = np.linalg.inv(graph.hessian()[0] + 0.2 * np.eye(15))
    first = dict(zip(keys, np.cumsum([0, *((SHARED | STEPS)[key] for key in keys)]), strict=False))
    for group in ([1], [2], [1, 2], [10], [11], [12], [20], [12, 20], [20, 12]):
        at = np.concatenate([np.arange(first[key], first[key] + (SHARED | STEPS)[key]) for key in group])
        np.testing.assert_allclose(found.joint(group), whole[np.ix_(at, at)], rtol=1e-8, atol=1e-12)


def test_what_nothing_determines_is_named() -> None:
    rng, graph = np.random.default_rng(1), gtsam.GaussianFactorGraph()
    for keys in ([1, 10], [10, 2], [2, 10]):
        graph.add(_factor(keys, rng))
    graph.add(gtsam.JacobianFactor(11, np.zeros((1, 3)), np.zeros(1), gtsam.noiseModel.Unit.Create(1)))
    with pytest.raises(SingularError, match=r"Symbol: 11\)"):
        covariances(graph, SHARED | {10: 3, 11: 3}, SHARED)


def _one_factor(residual: object, sigma: float = 1.0) -> gtsam.NonlinearFactorGraph:
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
    values = optimise(graph, _at(10.0))
    assert values.atDouble(KEY) == pytest.approx((1.0 + 4 * 4.0) / 5)
    assert marginals_of(graph, values, {KEY}).joint([KEY])[0, 0] == pytest.approx(1 / 5)


def test_damping_holds_a_step_that_would_diverge() -> None:
    """Newton's method on atan(x) diverges from |x| > 1.39."""
    graph = _one_factor(lambda x: (np.arctan(x), 1 / (1 + x * x)))
    assert optimise(graph, _at(3.0)).atDouble(KEY) == pytest.approx(0.0, abs=1e-4)


def test_an_error_that_is_never_finite_is_refused() -> None:
    with pytest.raises(SolverError, match="no finite error"):
        optimise(_one_factor(lambda x: (np.nan, 1.0)), _at(0.0))


def test_what_nothing_determines_has_the_weak_priors_covariance() -> None:
    graph = _one_factor(lambda x: (0.0, 0.0))
    marginals = marginals_of(graph, _at(0.0), {KEY})
    assert marginals.joint([KEY])[0, 0] == pytest.approx(WEAK_PRIOR**2)
