"""The polyhedral problem's matrices, against those written with Kronecker products."""

from __future__ import annotations

import numpy as np

from tests.physics.solvers.contact_problems import draw
from tests.physics.solvers.reference import lcp_kkt_error, lcp_matrices, tangent_directions
from tossid.physics.solvers.polyhedral_problem import (
    PolyhedralAnswer,
    PolyhedralProblem,
    lcp_matrix,
    make_answer,
    polyhedral_kkt_error,
    unpack,
)

K = 6


def problem(seed: int) -> PolyhedralProblem:
    A, b, mu = draw("flat", np.random.default_rng(seed), mu=0.4)
    return PolyhedralProblem(A, b, mu, tangent_directions(K))


def test_the_scaled_matrix_is_the_plain_one_in_other_units() -> None:
    given, rng = problem(0), np.random.default_rng(1)
    n = len(given.mu)
    size, scale = n * (K + 2), rng.uniform(0.5, 2, size=n)
    M, q = np.empty((size, size)), np.empty(size)
    lcp_matrix(given, scale, M, q)
    plain_M, plain_q = lcp_matrices(given.A, given.b, given.mu, K)
    # contact after contact: its normal, its directions, its gamma
    order = np.ravel([[i, *range(n + K * i, n + K * (i + 1)), n + K * n + i] for i in range(n)])
    impulses = np.concatenate([[s] * (K + 1) + [1 / s] for s in scale])  # z = impulses * z'
    velocities = np.concatenate([[s] * (K + 1) + [1 / s] for s in scale])  # w' = velocities * w
    np.testing.assert_allclose(M, velocities[:, None] * plain_M[np.ix_(order, order)] * impulses, atol=1e-12)
    np.testing.assert_allclose(q, velocities * plain_q[order], atol=1e-12)


def test_an_answer_is_read_from_the_basis() -> None:
    """Contact 1's normal impulse and third share are basic, and contact 0's gamma."""
    given = problem(2)
    answer, scale, size = make_answer(4, K), np.array([1.0, 2.0, 1.0, 1.0]), 4 * (K + 2)
    basis = np.arange(size)
    basis[:3] = size + np.array([K + 2, K + 2 + 3, K + 1])
    values = np.full(size, 9.0)
    values[:3] = [0.5, 0.25, 3.0]
    unpack(values, basis, size, scale, given, answer)
    assert answer.lam[1] == 1.0
    assert answer.beta[1, 2] == 0.5
    assert answer.gamma[0] == 3.0
    np.testing.assert_allclose(answer.lam[4 + 2 : 4 + 4], 0.5 * given.directions[2])
    assert np.count_nonzero(answer.beta) == np.count_nonzero(answer.gamma) == 1


def test_the_kernel_s_kkt_error_is_the_plain_one() -> None:
    given, rng = problem(3), np.random.default_rng(4)
    beta, gamma, lam_n = rng.uniform(size=(4, K)), rng.uniform(size=4), rng.uniform(size=4)
    lam = np.r_[lam_n, (beta @ given.directions).ravel()]
    found = polyhedral_kkt_error(given, PolyhedralAnswer(lam, beta, gamma))
    expected = lcp_kkt_error(given.A, given.b, given.mu, beta, gamma, lam_n)
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert expected > 0.1
