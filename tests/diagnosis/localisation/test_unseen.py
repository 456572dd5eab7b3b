"""Unseen tosses: their slow errors are those that the other tosses show."""

from __future__ import annotations

import numpy as np

from tests.diagnosis.tossed import seen
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.unseen import Unseen, unseen_windows
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def test_their_windows_have_the_slow_errors_of_the_others(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 4, seed=1)
    validator = CrossValidator.of(tosses, cube, seed=0)
    windows = unseen_windows(tosses, tosses, cube, validator)
    np.testing.assert_array_equal(windows.slow, validator.windows.slow)
    given = make_windows(tosses, cube, scatter=(3e-4, 7e-3))
    assert np.isclose(given.slow[:, 0, 0, 0], 9e-8).all()
    assert np.isclose(given.slow[:, 3, 0, 0], 4.9e-5).all()


def test_as_json_has_every_figure_with_its_interval() -> None:
    one = Interval(1.0, 0.5, 1.5)
    assert Unseen(3, one, one, one).as_json()["gap_left"] == {"value": 1.0, "ci95": [0.5, 1.5]}
