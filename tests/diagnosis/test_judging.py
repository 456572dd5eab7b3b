"""Hypotheses are compared alike: evidence wherever it lies, at first states that suit each, and fits that go on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tests.models.conftest import cube
from tossid.diagnosis.evidence import Hypothesis, gains
from tossid.diagnosis.fitting import fit
from tossid.diagnosis.judging import Judge, anywhere, folds
from tossid.diagnosis.windows import make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import LIBRARY, World

__all__ = ["cube"]

NAMES = {effect.name: effect for effect in LIBRARY}
COUNT = 6


def truth(cube: ObjectModel) -> World:
    return World(cube.with_changes(friction=0.3), ground_tilt=(0.02, 0.0))


@pytest.fixture(scope="module")
def judge(cube: ObjectModel) -> Judge:
    tosses = seen(truth(cube), cube, COUNT, seed=11)
    return Judge(make_windows(tosses, cube), COUNT, folds(COUNT, np.random.default_rng(0)))


def test_evidence_in_one_part_is_seen_beside_noise_in_the_other() -> None:
    rng = np.random.default_rng(0)
    quiet, loud = rng.normal(2, 1, 30), rng.normal(-5, 50, 30)
    parts = np.stack([quiet + loud, loud, quiet])
    assert anywhere(parts[:1]) > 0.05
    assert anywhere(parts) < 1e-5


def test_nothing_shows_nowhere_too_seldom() -> None:
    """Under the null, p below 0.05 in at most 5 % (four standard errors of 400)."""
    rng = np.random.default_rng(1)
    low = sum(anywhere(rng.normal(size=(3, 25)) * [[1], [3], [10]]) < 0.05 for _ in range(400))
    assert low <= 400 * 0.05 + 4 * np.sqrt(400 * 0.05 * 0.95)


def test_parts_add_up(judge: Judge) -> None:
    gain = np.random.default_rng(2).normal(size=len(judge.windows.toss))
    gain[judge.windows.free] = 0.0
    whole, impacts, others = judge.parts(gain)
    np.testing.assert_allclose(impacts + others, whole)
    assert impacts.any()
    assert others.any()


def test_several_at_once_are_those_one_by_one(judge: Judge, cube: ObjectModel) -> None:
    def found(mu: float) -> np.ndarray:
        return judge.start(Hypothesis(World(cube.with_changes(friction=mu)))).log_likelihood

    both = replace(judge, n_threads=2).each(found, (0.2, 0.3))
    np.testing.assert_allclose(both, [found(0.2), found(0.3)], rtol=1e-9)


def test_a_hypothesis_gains_nothing_over_itself(judge: Judge, cube: ObjectModel) -> None:
    right = judge.start(Hypothesis(truth(cube)))
    again = judge.judged(right, None, right.hypothesis)
    assert abs(judge.of_tosses(again.gain).sum()) < 5.0
    assert again.p_value > 0.1


def test_held_effects_keep_their_values(judge: Judge, cube: ObjectModel) -> None:
    start = Hypothesis(World(cube)).plus(NAMES["ground_tilt"], np.array([0.01, 0.0])).plus(NAMES["friction"])
    begin = judge.start(start)
    fitted = fit(begin.evidence, start, n_tosses=COUNT, held=frozenset({"ground_tilt"}))
    np.testing.assert_array_equal(fitted.hypothesis.values_of("ground_tilt"), [0.01, 0.0])
    assert fitted.hypothesis.values_of("friction")[0] > 0.2


def test_a_polished_fit_is_no_worse_and_nearer(judge: Judge, cube: ObjectModel) -> None:
    start = Hypothesis(World(cube)).plus(NAMES["friction"]).plus(NAMES["ground_tilt"])
    once = fit(judge.start(start).evidence, start, n_tosses=COUNT, iterations=2)
    polished = judge.polished(once.evidence, once.hypothesis)
    before, after = (each.evidence.log_likelihood(each.residual, once.scales) for each in (once, polished))
    assert gains(after, before) @ judge.windows.weights > 0
    found = polished.hypothesis
    assert found.values_of("friction")[0] == pytest.approx(0.3, abs=0.01)
    np.testing.assert_allclose(found.values_of("ground_tilt"), [0.02, 0.0], atol=1e-3)
