"""Effects that take steps and effects that drift are told apart, and the rate of a drift is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.sessions.test_changes import SETTINGS, N
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.sessions.drift import drifting, fitted_alone, follows_line
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def steps(*at: int) -> np.ndarray:
    return (np.arange(N)[:, None] >= np.array(at)).sum(axis=1) / len(at)


@pytest.mark.parametrize("noise", [0.01, 0.05, 0.15])
@pytest.mark.parametrize(
    ("true", "found", "line"),
    [
        (steps(20), (20,), False),
        (steps(9), (11,), False),
        (steps(31), (29,), False),
        (steps(13, 27), (13, 27), False),
        (steps(13) - steps(27), (13, 27), False),
        (np.arange(N) / (N - 1), (20,), True),
        (np.arange(N) / (N - 1), (7, 27), True),
        (np.arange(N) / (N - 1), (8, 16, 24, 32), True),
    ],
)
def test_a_line_and_steps_are_told_apart(true: np.ndarray, found: tuple[int, ...], line: bool, noise: float) -> None:
    """Tosses scatter by more than they say, and two are odd."""
    rng = np.random.default_rng(4)
    values = true[:, None] + noise * rng.normal(size=(N, 1))
    values[[5, 30]] += 0.7
    info = np.tile(np.eye(1) / (0.2 * noise) ** 2, (N, 1, 1))
    assert follows_line(values, info, found, SETTINGS) == line


@pytest.mark.slow
def test_the_rate_of_a_clock_that_drifts_far(cube: ObjectModel) -> None:
    """One step of Gauss-Newton ends far from the clock of the last tosses, and most fits do not."""
    n, rate, made = 12, -6e-3, []
    for i in range(n):
        at = with_effect(cube, "time_base", [1.0 + rate * i])
        made.append(replace(seen(at, cube, 1, seed=60 + i, frames=60)[0], name=str(i)))
    validator = Problem(made, World(cube), [EFFECTS["time_base"]]).validator(over_order=True)
    present = validator.evaluate(Hypothesis(World(cube)))
    alone = fitted_alone(present, EFFECTS["time_base"], validator, [np.ones(1)] * n)
    assert follows_line(alone.values, alone.info, (6,), SETTINGS)
    found = drifting(alone, validator, SETTINGS, 0.001)
    assert found.rate["rate_rel"].low < rate < found.rate["rate_rel"].high
    assert found.rate["rate_rel"].high - found.rate["rate_rel"].low < 0.5 * abs(rate)
    true = 1.0 + rate * np.arange(n)
    off = np.abs(alone.values[:, 0] * EFFECTS["time_base"].parameters[0].step - true)
    assert np.median(off) < 1e-3
    assert found.differ < 1e-6
    assert found.numbers == 1
    assert all(
        end["rate_rel"].low < value < end["rate_rel"].high
        for end, value in zip(found.stretches, true[[0, -1]], strict=True)
    )
    np.testing.assert_allclose(found.values[:, 0], true, atol=6e-3)
    assert found.edges == tuple(range(n + 1))
