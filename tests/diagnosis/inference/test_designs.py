"""Changes over the order in closed form: what refitting gives, and chance as rare as stated."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.diagnosis.inference import designs
from tossid.diagnosis.inference.columns import Columns
from tossid.diagnosis.inference.designs import (
    FEWEST,
    change_p_values,
    designed,
    enough,
    gain_of,
    line_over,
    steps_at,
    with_step,
)

NO = np.zeros(0, dtype=int)


def simulated(
    values: np.ndarray, *, seed: int, scatter: float = 0.0, width: int = 3
) -> tuple[Columns, np.ndarray, np.ndarray]:
    """Sums of tosses whose first column has these values, with their design (n, m, width) and residuals (n, m).

    Tosses differ in their information, and every toss scatters in all columns.
    """
    rng, n = np.random.default_rng(seed), len(values)
    J = rng.normal(size=(n, 30, width)) * rng.lognormal(0, 0.7, size=(n, 1, 1))
    own = scatter * rng.standard_t(4, size=(n, width))
    own[:, 0] += values
    e = rng.normal(size=(n, 30)) - np.einsum("nmi,ni->nm", J, own)
    return Columns(np.einsum("nmi,nmj->nij", J, J), np.einsum("nmi,nm->ni", J, e), 1.0), J, e


def test_steps_of_a_design_are_least_squares_beside_the_active_columns() -> None:
    columns, J, e = simulated(np.repeat([0.0, 2.0], [9, 11]), seed=0)
    some = designed(columns, np.array([1]), (np.array([0, 2]), steps_at((0, 9, 20))))
    late = (np.arange(20) >= 9)[:, None, None]
    X = np.concatenate([J[..., [1]], J[..., [0, 2]] * ~late, J[..., [0, 2]] * late], axis=-1)
    assert some.step() == pytest.approx(np.linalg.lstsq(X.reshape(-1, 5), -e.ravel())[0], rel=1e-6)
    assert some.step()[[1, 3]] == pytest.approx([0.0, 2.0], abs=0.3)
    line = designed(columns, NO, (np.array([0]), line_over(20))).step()
    X = np.stack([J[..., 0], J[..., 0] * (np.arange(20) - 9.5)[:, None]], axis=-1)
    assert line == pytest.approx(np.linalg.lstsq(X.reshape(-1, 2), -e.ravel())[0], rel=1e-6)


def test_a_step_is_found_at_its_place_and_a_line_gains_more_where_values_drift() -> None:
    own = np.array([0])
    step, _, _ = simulated(np.repeat([1.0, 3.0], [13, 17]), seed=1)
    assert with_step(step, NO, own, (0, 30), ())[1] == (0, 13, 30)
    assert with_step(step, NO, own, (0, 30), ())[0] > gain_of(step, NO, own, line_over(30))
    drift, _, _ = simulated(np.linspace(-2.0, 2.0, 30), seed=1)
    assert with_step(drift, NO, own, (0, 30), ())[0] < gain_of(drift, NO, own, line_over(30))


@pytest.mark.parametrize("values", [np.repeat([0.0, 1.5], [20, 12]), np.linspace(-1.2, 1.2, 32)])
def test_what_changes_is_significant_and_what_does_not_is_not(values: np.ndarray) -> None:
    columns, _, _ = simulated(values, seed=2, scatter=0.3)
    p, places = change_p_values([[(columns, NO, np.array([k]))] for k in range(3)], (), 0)
    assert p[0] <= 0.005
    assert p[1:].min() > 0.05
    if values[0] == values[1]:
        assert abs(places[0] - 20) <= 3  # of ranks; likelihood makes it exact


def test_chance_is_as_rare_as_stated_whatever_is_the_same_in_all_tosses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(designs, "ORDERS", 199)
    small = 0
    for seed in range(120):
        columns, _, _ = simulated(np.full(24, 3.0), seed=seed, scatter=0.5, width=4)
        effects = [[(columns, NO, np.array([k]))] for k in range(3)] + [[(columns, np.array([0]), np.array([1, 3]))]]
        small += change_p_values(effects, (12,), seed)[0].min() <= 0.05
    assert small / 120 < 0.11  # 0.05, and three standard errors


def test_a_known_boundary_shows_what_a_search_of_all_places_does_not() -> None:
    clearer = 0
    for seed in range(30):
        columns, _, _ = simulated(np.repeat([0.0, 0.5], [12, 12]), seed=seed, scatter=0.3)
        effects = [[(columns, NO, np.array([0]))]]
        clearer += int(change_p_values(effects, (12,), 0)[0][0] < change_p_values(effects, (), 0)[0][0])
    assert clearer > 18


def test_few_tosses_say_nothing() -> None:
    assert not enough(2 * FEWEST)
    assert enough(12)
