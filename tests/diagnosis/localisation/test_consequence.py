"""What an effect does to whole tosses: as far as it moves them, and a headline only beyond a tolerance."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.consequence import changed, consequences
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.objects import ObjectModel
from tossid.physics.effects import World

NOTHING = Interval(0.0, 0.0, 0.0)


def test_friction_matters_and_a_breath_does_not(cube: ObjectModel) -> None:
    """A uniform force of 0.0005 N is a seventieth of a per cent of the weight."""
    hypothesis = Hypothesis(World(cube)).plus(EFFECTS["friction"], np.array([0.3]))
    hypothesis = hypothesis.plus(EFFECTS["uniform_force"], np.array([5e-4, 0.0, 0.0]))
    tosses = seen(hypothesis.world(), cube, 8, seed=3)
    validator = CrossValidator.of(tosses, cube, seed=0)
    last = validator.evaluate(hypothesis)
    found = SearchResult(last, last, (last,), {}, {}, {}, {})
    closes = {"friction": Interval(0.9, 0.8, 1.0), "uniform_force": Interval(0.001, 0.0, 0.002)}
    out = consequences(tosses, validator, found, closes)
    assert out["friction"].matters
    assert out["friction"].position_pct > 1.0
    assert not out["uniform_force"].matters
    assert out["uniform_force"].position_pct < 0.5
    # what closes enough of the gap matters, however little it moves
    closes["uniform_force"] = Interval(0.05, 0.04, 0.06)
    assert consequences(tosses, validator, found, closes)["uniform_force"].matters


def test_distances_are_medians_of_means_over_a_toss(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 3, seed=1, frames=20)
    one = np.stack([toss.q for toss in tosses])
    other = one.copy()
    other[0, :, 0] += 1.0  # a toss that went elsewhere
    other[1:, :, 0] += 0.01 * cube.width
    position, rotation = changed(one, other, tosses, cube.width)
    assert position == pytest.approx(1.0)
    assert rotation == pytest.approx(0.0, abs=1e-4)
    other[:2] = np.nan
    assert changed(one, other, tosses, cube.width)[0] == np.inf


def test_no_effects_no_consequences(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 3, seed=1, frames=40)
    validator = CrossValidator.of(tosses, cube, seed=0)
    first = validator.evaluate(Hypothesis(World(cube)))
    assert consequences(tosses, validator, SearchResult(first, first, (first,), {}, {}, {}, {}), {}) == {}
