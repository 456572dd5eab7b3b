"""Whole tosses are predicted better by what was found without them."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.inference.conftest import FRICTION
from tests.diagnosis.inference.test_judge import folds_of
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.inference.brings import Brings, whole_tosses
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.objects import ObjectModel


def test_found_friction_brings_whole_tosses_near_the_recorded_ones(cube: ObjectModel, stated: Hypothesis) -> None:
    tosses = seen(with_effect(cube, "friction", [FRICTION]), cube, 9, seed=3, frames=70)
    sample = Sample(make_windows(tosses, cube), 9)
    found = whole_tosses(folds_of(sample, stated), tosses, sample, stated)
    (was, now), (was_mm, now_mm) = found.position_pct(), found.position_mm()
    assert now.value < 0.5 * was.value
    assert now.low <= now.value <= now.high
    assert was_mm.value == pytest.approx(was.value * 0.01 * 1e3 * cube.width)
    assert now_mm.value < was_mm.value
    assert found.improves()


def test_worse_tosses_are_no_improvement_and_lost_ones_are_worse() -> None:
    before = np.full((5, 2), 1.0)
    assert not Brings(before, before + np.array([0.6, 0.0]), 0.1).improves()
    assert Brings(before, before + np.array([0.4, 0.4]), 0.1).improves()
    assert not Brings(before, np.full((5, 2), np.nan), 0.1).improves()
