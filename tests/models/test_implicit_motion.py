"""The dynamics inside the implicit loss's kernel, against plain linear algebra."""

from __future__ import annotations

import numpy as np
import torch

from tests.models import reference_implicit as reference
from tests.models.implicit_problems import problem
from tossid.models.implicit import free_acceleration
from tossid.models.implicit_motion import FACTOR, HALF, MASS, WEIGHT, factor, half_response, solve
from tossid.objects import ObjectModel


def test_the_free_acceleration_is_that_of_torch(cube: ObjectModel) -> None:
    t, d, _ = problem(4, cube, bodies=3)
    torch.testing.assert_close(
        free_acceleration(t, d), reference.free_acceleration(t, d)[1].detach(), rtol=1e-9, atol=0
    )


def positive(rng: np.random.Generator, n: int) -> np.ndarray:
    root = rng.normal(size=(n, n))
    return root @ root.T + n * np.eye(n)


def test_the_factor_solves_with_the_mass_matrix() -> None:
    rng = np.random.default_rng(0)
    G, U = np.zeros((5, 7, 7)), rng.normal(size=(5, 7))
    G[MASS] = M = positive(rng, 7)
    b = U[2].copy()
    factor(G, MASS, FACTOR)
    solve(G, U, np.int64(2))
    np.testing.assert_allclose(M @ U[2], b, rtol=1e-12, atol=1e-12)


def test_a_matrix_that_is_not_positive_definite_gives_nan() -> None:
    G = np.zeros((5, 3, 3))
    G[MASS] = np.diag([1.0, -1.0, 1.0])
    factor(G, MASS, FACTOR)
    assert np.isnan(G[FACTOR, 1, 1])


def test_half_a_response_squared_is_the_response_weighted() -> None:
    """C^T = M^-1 F with W = F F^T, so that C^T C = M^-1 W M^-1."""
    rng = np.random.default_rng(1)
    G = np.zeros((5, 6, 6))
    G[MASS], G[WEIGHT] = M, W = positive(rng, 6), positive(rng, 6)
    factor(G, MASS, FACTOR)
    half_response(G)
    inverse = np.linalg.inv(M)
    np.testing.assert_allclose(G[HALF] @ G[HALF].T, inverse @ W @ inverse, rtol=1e-10)
