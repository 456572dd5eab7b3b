"""The exact friction cone: 10,000 problems, known answers, and a plain reference."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.solvers.contact_problems import BOTTOM, GRAVITY, INERTIA, MASS, STEP, UP, delassus, draw, draw_many
from tests.physics.solvers.reference import ACCEPTED_KKT_ERROR, cone_kkt_error, cone_reference
from tossid.physics.solvers import ExactCone, SolverStatus, solve_contacts


@pytest.mark.parametrize(
    ("solver", "share"), [(ExactCone(), 0.01), pytest.param(ExactCone(60, 60), 0.005, marks=pytest.mark.slow)]
)
def test_ten_thousand_problems_satisfy_complementarity_or_say_otherwise(solver: ExactCone, share: float) -> None:
    total, unsolved = 0, 0
    for A, b, mu in draw_many(10_000, 0).values():
        solution = solve_contacts(A, b, mu, solver=solver)
        solved = solution.status == SolverStatus.SOLVED
        kkt_error = cone_kkt_error(A, b, mu, solution.lam)
        assert kkt_error[solved].max() <= ACCEPTED_KKT_ERROR
        assert (solution.kkt_error[~solved] > 1e-9).all()
        unsolved += solution.unsolved
        total += len(b)
    assert total == 10_000
    assert unsolved / total <= share


def test_ordinary_contact_of_the_cube_is_always_solved() -> None:
    rng = np.random.default_rng(1)
    for family in ("rest", "slide", "flat", "edge", "point", "duplicate"):
        problems = [draw(family, rng, mu=0.18) for _ in range(400)]
        A, b, mu = (np.stack(parts) for parts in zip(*problems, strict=True))
        assert solve_contacts(A, b, mu).unsolved == 0, family


def test_a_particle_has_the_closed_form() -> None:
    """A = I / m: lam_n = -m b_n, and friction stops the slip or is mu lam_n against it."""
    rng = np.random.default_rng(2)
    count, mass = 500, 0.7
    b, mu = rng.normal(size=(count, 3)), rng.uniform(0, 2, size=(count, 1))
    lam = solve_contacts(np.tile(np.eye(3) / mass, (count, 1, 1)), b, mu).lam
    normal = mass * np.maximum(-b[:, 0], 0)
    slip = np.linalg.norm(b[:, 1:], axis=1)
    friction = np.minimum(mu[:, 0] * normal, mass * slip)
    np.testing.assert_allclose(lam[:, 0], normal, atol=1e-12)
    np.testing.assert_allclose(lam[:, 1:], -(friction / slip)[:, None] * b[:, 1:], atol=1e-9)


def test_a_block_at_rest_is_carried_and_a_sliding_one_braked() -> None:
    J, A = delassus(BOTTOM, np.tile(UP, (4, 1)), MASS, np.full(3, INERTIA))
    rest, slide = np.zeros(6), np.zeros(6)
    slide[:2] = [0.6, -0.8]
    fall = np.array([0, 0, -GRAVITY * STEP, 0, 0, 0])
    b = np.array([J @ (v + fall) for v in (rest, slide)])
    solution = solve_contacts(np.stack([A, A]), b, np.full(4, 0.18))
    assert solution.unsolved == 0
    weight = MASS * GRAVITY * STEP
    impulse = np.array(
        [MASS * (np.diag(np.r_[np.full(3, 1 / MASS), np.full(3, 1 / INERTIA)]) @ J.T @ lam) for lam in solution.lam]
    )
    np.testing.assert_allclose(impulse[:, 2], weight, rtol=1e-7)
    np.testing.assert_allclose(impulse[0, :2], 0, atol=1e-9)
    np.testing.assert_allclose(impulse[1, :2], -0.18 * weight * slide[:2], rtol=1e-6)


def test_friction_never_adds_energy() -> None:
    for A, b, mu in draw_many(2000, 3).values():
        solution = solve_contacts(A, b, mu)
        n = mu.shape[1]
        w = np.einsum("bij,bj->bi", A, solution.lam) + b
        solved = solution.status == SolverStatus.SOLVED
        power = np.einsum("bi,bi->b", solution.lam[:, n:], w[:, n:])[solved]
        size = np.abs(solution.lam).max(axis=1)[solved]
        assert (power <= 1e-8 * (1 + size)).all()


@pytest.mark.parametrize("family", ["slide", "edge", "point", "vee"])
def test_agrees_with_the_reference(family: str) -> None:
    rng = np.random.default_rng(4)
    compared = 0
    for _ in range(6):
        A, b, mu = draw(family, rng, mu=0.18)
        lam, kkt_error = cone_reference(A, b, mu, tolerance=1e-7, turns=20)
        if kkt_error > 1e-7:
            continue
        np.testing.assert_allclose(A @ solve_contacts(A[None], b[None], mu).lam[0], A @ lam, atol=1e-5)
        compared += 1
    assert compared >= 4


@pytest.mark.parametrize(("family", "several"), [("point", False), ("edge", False), ("slide", True), ("flat", True)])
def test_four_corners_have_several_solutions_and_rounding_chooses_one(family: str, several: bool) -> None:
    """Why two programs that assemble the same problem in another order of sums may step differently (ADR 2)."""
    rng = np.random.default_rng(8)
    A, b, mu = (np.stack(parts) for parts in zip(*(draw(family, rng, mu=1.0) for _ in range(300)), strict=True))
    one = solve_contacts(A, b, mu, tolerance=1e-11)
    warm = solve_contacts(A, b, mu, tolerance=1e-11, warm=one.lam * rng.uniform(0, 2, size=one.lam.shape))
    rounded = solve_contacts(A, b * (1 + 1e-15 * rng.normal(size=b.shape)), mu, tolerance=1e-11)
    solved = (one.status == 0) & (warm.status == 0) & (rounded.status == 0)
    assert solved.mean() > 0.95
    w, w_warm, w_rounded = (np.einsum("bij,bj->bi", A, found.lam) + b for found in (one, warm, rounded))
    for found in (one, warm):
        assert cone_kkt_error(A, b, mu, found.lam)[solved].max() <= 2e-11
    apart, by_rounding = np.abs(w_warm - w).max(axis=1)[solved], np.abs(w_rounded - w).max(axis=1)[solved]
    if several:
        assert apart.max() > 1e-4
        assert by_rounding.max() > 1e-9
    else:
        assert apart.max() < 1e-9
        assert by_rounding.max() < 1e-11


def test_walls_that_close_on_each_other_are_reported() -> None:
    """Two opposite walls both coming in: no impulse can keep the body out of both."""
    _, A = delassus(np.zeros((2, 3)), np.array([[1.0, 0, 0], [-1.0, 0, 0]]), MASS, np.full(3, INERTIA))
    b = np.array([[-1.0, -1.0, 0, 0, 0, 0], [np.inf, 0, 0, 0, 0, 0]])
    solution = solve_contacts(np.stack([A, A]), b, np.array([0.3, 0.3]))
    assert solution.status.tolist() == [SolverStatus.MAX_ITERATIONS, SolverStatus.NOT_FINITE]
    assert solution.kkt_error[0] > 0.1
    assert solution.unsolved == 2
