"""Values of contact depend on where windows begin, and intervals say so."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.inference.conftest import FRICTION
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.shifts import DEGREES, SHIFTS, variance_over_shifts
from tossid.diagnosis.problem import Problem
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def test_the_variance_over_shifts_widens_an_interval(cube: ObjectModel) -> None:
    tosses = seen(with_effect(cube, "friction", [FRICTION]), cube, 9, seed=3, frames=70)
    problem = Problem(tosses, Hypothesis(World(cube)), library=(EFFECTS["friction"],))
    found = problem.search().run()
    shifted = [problem.shifted(share) for share in SHIFTS]
    assert all(len(s.windows.toss) != len(problem.sample.windows.toss) or s.windows.first.min() > 0 for s in shifted)
    variance = variance_over_shifts(found, shifted)["friction"]
    assert variance.shape == (1,)
    assert 0 < np.sqrt(variance[0]) < 0.01
    plain, wider = found.fit.intervals("friction")["mu"], found.fit.intervals("friction", variance, DEGREES)["mu"]
    assert wider.low < plain.low < plain.value < plain.high < wider.high
    # a variance of two degrees of freedom alone has their quantile, 4.3
    alone = found.fit.intervals("friction", np.array([1e-3**2 * 1e4]), DEGREES)["mu"]
    assert alone.high - alone.value == pytest.approx(4.303 * 0.1, rel=0.02)
    assert wider.low < FRICTION < wider.high


def test_what_flight_has_determined_is_not_shifted(cube: ObjectModel) -> None:
    tosses = seen(with_effect(cube, "gravity", [9.5]), cube, 9, seed=3, frames=70)
    problem = Problem(tosses, Hypothesis(World(cube)), library=(EFFECTS["gravity"],))
    found = problem.search().run()
    assert found.flown == {"gravity"}
    assert variance_over_shifts(found, (problem.shifted(share) for share in SHIFTS)) == {}
