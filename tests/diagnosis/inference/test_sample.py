"""Hypotheses are compared at values that the judged toss has not touched."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.inference.conftest import FRICTION
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import Sample, noise_of, reduces_deviance


def test_an_effect_is_needed_where_it_is_there_and_not_where_it_is_not(slippery: Sample, stated: Hypothesis) -> None:
    both = stated.plus(EFFECTS["friction"], np.array([FRICTION])).plus(EFFECTS["cohesion"])
    made = slippery.refitted(slippery.evidence(both), both, iterations=3)
    there, not_there = (slippery.without(made, name) for name in ("friction", "cohesion"))
    assert slippery.gains(made, there).sum() > 100
    assert slippery.gains(made, not_there).sum() < 3
    first = slippery.evidence(stated)
    assert reduces_deviance(made.evidence, there.evidence, first)
    assert not reduces_deviance(made.evidence, not_there.evidence, first)


def test_the_standard_error_of_a_sum() -> None:
    assert noise_of(np.array([1.0, 3.0])) == pytest.approx(2.0)
    assert noise_of(np.array([1.0])) == np.inf
