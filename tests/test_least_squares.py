"""Damped steps against closed forms, and a search that stops where it should."""

from __future__ import annotations

import numpy as np

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
