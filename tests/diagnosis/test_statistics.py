"""Names and intervals as statistics: how often nothing gets a name, intervals cover, and an effect is found.

By simulation with fixed seeds, enough cases for the rates themselves. One case of each is in `test_explain.py`, which
holds it to its name and its interval.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from scipy.stats import binom

from tests.diagnosis.tossed import ONCE, seen
from tossid.diagnosis.explain import explain
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.result import Diagnosis
from tossid.objects import ObjectModel
from tossid.physics.effects import LIBRARY, World

pytestmark = pytest.mark.slow

EFFECTS = {effect.name: effect for effect in LIBRARY}
SOME = [EFFECTS[name] for name in ("com_offset", "gravity", "linear_drag", "friction", "rolling_resistance")]
TOSSES = 16
MANY = 40


def diagnoses(cube: ObjectModel, name: str, truth: list[float], count: int, *, first: int) -> Iterator[Diagnosis]:
    """Diagnoses of tosses with an effect in them ("" for none), each with its own seed."""
    world = World(cube)
    there = EFFECTS[name].at(world, np.array(truth)) if name else world
    for seed in range(first, first + count):
        yield explain(
            Problem(seen(there, cube, TOSSES, seed=seed), world, library=SOME, n_threads=2, seed=seed, settings=ONCE)
        )


def most(count: int, rate: float) -> int:
    """How often something of that rate happens at most, but for one time in a hundred."""
    return int(binom.ppf(0.99, count, rate))


def test_nothing_rarely_gets_a_name(cube: ObjectModel) -> None:
    named = [found.named for found in diagnoses(cube, "", [], MANY, first=100)]
    assert sum(bool(names) for names in named) <= most(MANY, 0.05)


@pytest.mark.parametrize(
    ("name", "truth"),
    [("gravity", [9.6]), ("friction", [0.25]), ("com_offset", [2e-3, -1e-3, 3e-3])],
    ids=["gravity", "friction", "com_offset"],
)
def test_intervals_cover(cube: ObjectModel, name: str, truth: list[float]) -> None:
    inside = []
    for found in diagnoses(cube, name, truth, MANY, first=200):
        assert found.named[:1] == (name,)
        intervals = found.findings[0].parameters.values()
        inside += [each.low <= value <= each.high for each, value in zip(intervals, truth, strict=True)]
    assert len(inside) - sum(inside) <= most(len(inside), 0.15)


def test_a_larger_effect_is_found_more_often(cube: ObjectModel) -> None:
    # flights of a fifth of a second in sixteen tosses know gravity to 1 cm/s²
    found = {
        g: [each.named for each in diagnoses(cube, "gravity", [g], MANY // 2, first=300)] for g in (9.809, 9.77, 9.5)
    }
    rates = [float(np.mean(["gravity" in names for names in each])) for each in found.values()]
    assert rates[0] <= 0.15
    assert rates[-1] >= 0.9
    assert rates == sorted(rates)
