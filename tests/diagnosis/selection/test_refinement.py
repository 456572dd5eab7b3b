"""Values are moved to where they fit best, and effects that are nothing with shifted windows are pruned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.refinement import correlations, intervals, line_searched, pruned_by_wald_test
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.objects import ObjectModel
from tossid.physics.effects import World


@pytest.mark.parametrize("begin", [1.05, pytest.param(1.01, marks=pytest.mark.slow)])
def test_an_effect_that_a_fit_cannot_reach_is_found_by_line_search(cube: ObjectModel, begin: float) -> None:
    nominal = World(cube)
    geometry = EFFECTS["geometry"]
    judge = CrossValidator.of(seen(geometry.at(nominal, np.array([1.03])), cube, 8, seed=9), cube, seed=0, n_threads=1)
    first, away = (judge.evaluate(each) for each in (Hypothesis(nominal), Hypothesis(nominal).plus(geometry, [begin])))
    found = SearchResult(first, away, (first, away), {}, {}, {"geometry": away}, {"geometry": ()})
    there = line_searched(judge, found)
    assert there.present.hypothesis.values_of("geometry") == pytest.approx(1.03, abs=1e-3)
    assert there.history == (first, there.present)
    # what flight determines is not moved
    shown = replace(found, n_flight=1)
    assert line_searched(judge, shown) is shown


def test_an_effect_that_is_nothing_with_shifted_windows_is_pruned(cube: ObjectModel) -> None:
    """The ground is level: tilts that are found with the first windows scatter about none."""
    nominal = World(cube)
    tosses = seen(EFFECTS["friction"].at(nominal, np.array([0.3])), cube, 10, seed=8)
    judge = CrossValidator.of(tosses, cube, seed=0, n_threads=1)
    first = judge.evaluate(Hypothesis(nominal))
    both = Hypothesis(nominal).plus(EFFECTS["ground_tilt"]).plus(EFFECTS["friction"])
    present = judge.cross_validate(first, None, both)
    tilt, friction = (present.hypothesis.values_of(name) for name in ("ground_tilt", "friction"))
    assert np.abs(tilt).max() < 2e-3
    assert friction == pytest.approx(0.3, abs=0.01)
    of = {"ground_tilt": present, "friction": present}
    found = SearchResult(first, present, (first, present), {}, {}, of, dict.fromkeys(of, ()))
    left, spread = pruned_by_wald_test(judge, found, np.array([2e-3, 2e-3, 1e-3]))
    assert [effect.name for effect in left.present.hypothesis.effects] == ["friction"]
    assert left.history == (first, left.present)
    assert list(left.needed) == list(left.classes) == ["friction"]
    np.testing.assert_array_equal(spread, [1e-3])
    # what flight determines is not pruned
    assert pruned_by_wald_test(judge, replace(found, n_flight=1), np.array([2e-3, 2e-3, 1e-3]))[0].needed == of

    # along both axes of the ground, errors are hardly related; of one parameter there is nothing to relate
    related = correlations(present.fitted, judge.n)
    assert np.diag(related["ground_tilt"]) == pytest.approx([1.0, 1.0])
    assert abs(related["ground_tilt"][0][1]) < 0.9
    assert related["friction"] == ((pytest.approx(1.0),),)

    # the scatter over shifted windows is part of the intervals
    few, more = (intervals(present.fitted, judge.n, each) for each in (None, np.array([2e-3, 2e-3, 0.1])))
    assert (more["friction"]["mu"].high - more["friction"]["mu"].low) > 0.1
    assert (few["friction"]["mu"].high - few["friction"]["mu"].low) < 0.1
