"""Covariances by elimination beside the inverse of the whole Hessian, and beside GTSAM's."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from tossid.vision.pose_graph.solver.elimination import SingularError, covariances

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


def test_large_groups_are_left_to_others() -> None:
    """Stillness connects every step with the next."""
    rng, graph = np.random.default_rng(2), gtsam.GaussianFactorGraph()
    dims = {1: 3} | {100 + i: 6 for i in range(12)}
    for i in range(12):
        last = 100 + max(i - 1, 0)
        terms = [part for key in {1, 100 + i, last} for part in (key, rng.normal(size=(9, dims[key])))]
        graph.add(gtsam.JacobianFactor(*terms, np.zeros(9), gtsam.noiseModel.Unit.Create(9)))
    assert covariances(graph, dims, {1}) is None
