"""Damped steps against closed forms, and a search that stops where it should."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.least_squares import Damping, damped_step, search_damping

SCHEDULE = Damping(grow=10.0, fall=0.1, least=0.1, vanish=1.0)


def test_without_damping_a_step_solves_a_linear_problem() -> None:
    rng = np.random.default_rng(0)
    J, x = rng.normal(size=(9, 4)), rng.normal(size=4)
    step = damped_step(J.T @ J, J.T @ (J @ np.zeros(4) - J @ x), 0.0, np.ones(4))
    np.testing.assert_allclose(step, x, atol=1e-12)


def test_strong_damping_turns_the_step_downhill() -> None:
    rng = np.random.default_rng(1)
    J, g = rng.normal(size=(9, 4)), rng.normal(size=4)
    step = damped_step(J.T @ J, g, 1e9, np.ones(4))
    np.testing.assert_allclose(step, -g / 1e9, rtol=1e-6)


def test_damping_grows_from_zero_and_vanishes() -> None:
    assert [SCHEDULE.rejected(0.0), SCHEDULE.rejected(1.0)] == [1.0, 10.0]
    assert [SCHEDULE.accepted(100.0), SCHEDULE.accepted(1.0)] == [10.0, 0.0]
    both = SCHEDULE.each(np.array([0.0, 100.0, 1.0]), np.array([False, True, True]))
    np.testing.assert_array_equal(both, [1.0, 10.0, 0.0])


def test_the_search_takes_the_first_accepted_step_or_gives_up() -> None:
    tried: list[float] = []

    def attempt(damping: float) -> str | None:
        tried.append(damping)
        return "good" if damping >= 100 else None

    assert search_damping(attempt, 0.0, SCHEDULE) == ("good", 100.0)
    assert tried == [0.0, 1.0, 10.0, 100.0]
    assert search_damping(attempt, 0.0, SCHEDULE, trials=2) == (None, 10.0)
    assert search_damping(attempt, 0.0, SCHEDULE, most=50.0) == (None, 100.0)


def test_rosenbrocks_valley_is_descended() -> None:
    """The minimum (1, 1) of 100 (y - x²)² + (1 - x)², from (-1.2, 1)."""
    x, damping = np.array([-1.2, 1.0]), 1e-3
    schedule = Damping(grow=10.0, fall=0.2)

    def residuals(at: np.ndarray) -> np.ndarray:
        return np.array([10 * (at[1] - at[0] ** 2), 1 - at[0]])

    for _ in range(60):
        r, J = residuals(x), np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])
        H, g, here = J.T @ J, J.T @ r, x

        def attempt(damping: float, H: np.ndarray = H, g: np.ndarray = g, here: np.ndarray = here) -> np.ndarray | None:
            moved = here + damped_step(H, g, damping, np.diag(H))
            return moved if np.sum(residuals(moved) ** 2) < np.sum(residuals(here) ** 2) else None

        found, damping = search_damping(attempt, damping, schedule, trials=20)
        if found is None:
            break
        x, damping = found, schedule.accepted(damping)
    assert x == pytest.approx([1.0, 1.0], abs=1e-8)
