"""Hypotheses are compared alike: evidence wherever it lies, at first states that suit each, and fits that go on."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.likelihood.fitting import fit
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.selection.cross_validation import CrossValidator, draw_folds
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.physics.effects import World

COUNT = 6


def truth(cube: ObjectModel) -> World:
    return World(cube.with_changes(friction=0.3), ground_tilt=(0.02, 0.0))


@pytest.fixture(scope="module")
def judge(cube: ObjectModel) -> CrossValidator:
    tosses = seen(truth(cube), cube, COUNT, seed=11)
    return CrossValidator(make_windows(tosses, cube), COUNT, draw_folds(COUNT, np.random.default_rng(0)))


def test_parts_add_up(judge: CrossValidator) -> None:
    gain = np.random.default_rng(2).normal(size=len(judge.windows.toss))
    gain[judge.windows.free] = 0.0
    whole, impacts, others = judge.by_part(gain)
    np.testing.assert_allclose(impacts + others, whole)
    assert impacts.any()
    assert others.any()


def test_several_at_once_are_those_one_by_one(judge: CrossValidator, cube: ObjectModel) -> None:
    def found(mu: float) -> np.ndarray:
        return judge.evaluate(Hypothesis(World(cube.with_changes(friction=mu)))).log_likelihood

    both = replace(judge, n_threads=2).map(found, (0.2, 0.3))
    np.testing.assert_allclose(both, [found(0.2), found(0.3)], rtol=1e-9)


def test_items_within_an_item_are_made_by_its_thread(judge: CrossValidator) -> None:
    """More threads than were asked for would wait for each other."""
    several = replace(judge, n_threads=2)
    threads = several.map(lambda _: several.map(lambda _: threading.get_ident(), range(3)), range(2))
    assert [len(set(each)) for each in threads] == [1, 1]


def test_a_hypothesis_gains_nothing_over_itself(judge: CrossValidator, cube: ObjectModel) -> None:
    right = judge.evaluate(Hypothesis(truth(cube)))
    again = judge.cross_validate(right, None, right.hypothesis)
    assert abs(judge.by_toss(again.gain).sum()) < 5.0
    assert again.p_value > 0.1


def test_held_effects_keep_their_values(judge: CrossValidator, cube: ObjectModel) -> None:
    start = Hypothesis(World(cube)).plus(EFFECTS["ground_tilt"], np.array([0.01, 0.0])).plus(EFFECTS["friction"])
    begin = judge.evaluate(start)
    fitted = fit(begin.evidence, start, n_tosses=COUNT, held=frozenset({"ground_tilt"}))
    np.testing.assert_array_equal(fitted.hypothesis.values_of("ground_tilt"), [0.01, 0.0])
    assert fitted.hypothesis.values_of("friction")[0] > 0.2


def test_a_polished_fit_is_no_worse_and_nearer(judge: CrossValidator, cube: ObjectModel) -> None:
    start = Hypothesis(World(cube)).plus(EFFECTS["friction"]).plus(EFFECTS["ground_tilt"])
    once = fit(judge.evaluate(start).evidence, start, n_tosses=COUNT, iterations=2)
    polished = judge.refit(once.evidence, once.hypothesis)
    before, after = (each.evidence.log_likelihood(each.residuals, once.scales) for each in (once, polished))
    assert polished.evidence.weighted_gain(after, before) > 0
    found = polished.hypothesis
    assert found.values_of("friction")[0] == pytest.approx(0.3, abs=0.01)
    np.testing.assert_allclose(found.values_of("ground_tilt"), [0.02, 0.0], atol=1e-3)


def test_folds_are_a_partition() -> None:
    parts = draw_folds(19, np.random.default_rng(0))
    assert len(parts) == 8
    np.testing.assert_array_equal(np.sum(parts, axis=0), 1)
    assert len(draw_folds(3, np.random.default_rng(0))) == 3


def test_tosses_whose_frames_are_missing_everywhere_are_refused(cube: ObjectModel) -> None:
    rng, tosses = np.random.default_rng(0), seen(World(cube), cube, 4, seed=0)
    uneven = [replace(toss, t=toss.t[0] + np.cumsum(rng.uniform(0.002, 0.006, len(toss)))) for toss in tosses]
    with pytest.raises(InputError, match="none of 4 tosses has a stretch of 10 time steps of 4"):
        CrossValidator.of(uneven, cube, seed=0)
