"""The tree's factor about the centre of mass, against the mass matrix."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from tests.physics.trees import random_state, random_tree
from tossid.physics import articulated, tree
from tossid.physics.system import make_system


@numba.njit
def factorise(tree, q, v, none, P, E, L, rate):  # type: ignore[no-untyped-def]
    """What the time stepper calls in a step, which Python cannot."""
    articulated.outward_pass(tree, q, v, P, E)
    articulated.own_inertia_and_bias(tree, P, E)
    articulated.inward_pass(tree.parent, P)
    return articulated.factorise(tree.parent, tree.joint_type, none, none, P, L, rate)


@pytest.mark.parametrize("seed", range(5))
def test_the_factor_about_the_centre_of_mass_is_that_of_the_mass_matrix(seed: int) -> None:
    """S is the Schur complement of M's linear block: M's without the momentum of the whole."""
    rng = np.random.default_rng(seed)
    model = random_tree(rng, n_bodies=1 + seed)
    system, (q, v) = make_system(model), random_state(rng, model)
    view = articulated.make_articulated(system)
    P, E = np.zeros((model.n_bodies, articulated.WIDTH)), np.zeros((model.n_bodies, 3, 3))
    L, rate = np.zeros((model.nv - 3, model.nv - 3)), np.zeros(model.nv - 3)
    assert factorise(view, q, v, np.zeros(model.n_bodies), P, E, L, rate)
    np.fill_diagonal(L, 1 / np.diag(L))
    work = tree.make_work(system)
    tree.kinematics(system, q, work)
    tree.mass_matrix(system, work)
    M = work.M
    schur = M[3:, 3:] - M[3:, :3] @ M[:3, 3:] / model.mass.sum()
    np.testing.assert_allclose(np.tril(L) @ np.tril(L).T, schur, rtol=0, atol=1e-12)
