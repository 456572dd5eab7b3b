"""Equal rows are computed once, and each has the result that it would have had alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.distinct import distinct
from tossid.diagnosis.likelihood.whitening import linearise
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def test_rows_are_numbered_in_order_and_restored() -> None:
    numbers, counts = np.array([[0.5, 1.0], [2.0, 1.0], [0.5, 1.0], [0.5, 1.0]]), np.array([3, 3, 3, 4])
    rows, place = distinct(numbers, counts)
    assert rows.tolist() == [0, 1, 3]
    assert place.tolist() == [0, 1, 0, 2]


def test_rows_of_random_numbers_are_all_distinct() -> None:
    values = np.random.default_rng(0).normal(size=(5000, 13))
    rows, place = distinct(np.concatenate([values, values]))
    np.testing.assert_array_equal(rows, np.arange(5000))
    np.testing.assert_array_equal(place, np.tile(np.arange(5000), 2))


def test_a_toss_that_is_drawn_twice_is_simulated_once(cube: ObjectModel, monkeypatch: pytest.MonkeyPatch) -> None:
    tosses = seen(World(cube.with_changes(friction=0.3)), cube, 3, seed=2)
    once, twice = (make_windows([tosses[i] for i in draw], cube) for draw in ((0, 1, 2), (0, 1, 1, 1, 2)))
    simulated: list[int] = []
    original = World.roll_out

    def counted(self: World, q0: Any, v0: Any, **how: Any) -> Any:
        simulated.append(len(q0))
        return original(self, q0, v0, **how)

    monkeypatch.setattr(World, "roll_out", counted)
    alone, _ = linearise(once, World(cube), refine=4, restarts=2)
    few = sum(simulated)
    simulated.clear()
    both, _ = linearise(twice, World(cube), refine=4, restarts=2)
    assert sum(simulated) == few
    for copy, number in enumerate((0, 1, 1, 1, 2)):
        np.testing.assert_array_equal(both.at_q[both.toss == copy], alone.at_q[alone.toss == number])
        np.testing.assert_array_equal(both.at_v[both.toss == copy], alone.at_v[alone.toss == number])
