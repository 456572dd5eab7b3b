"""What makes predictions of whole tosses worse is refused; what makes them better, or hardly moves them, is not."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS, hypothesis
from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.refusal import Growth, RolloutCheck, check_rollouts
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.nested import JudgingFold
from tossid.objects import ObjectModel
from tossid.physics.effects import World

RNG = np.random.default_rng(0)


def _check(found: Hypothesis, world: World, cube: ObjectModel, *, unseen: int) -> RolloutCheck | None:
    """The check of a hypothesis by unseen tosses of a world, beside eight that it was found from."""
    searched, judges = seen(world, cube, 8, seed=5, frames=70), seen(world, cube, unseen, seed=6)
    validator = CrossValidator.of(searched, cube, seed=0)
    nothing, windows = Hypothesis(World(cube)), make_windows(judges, cube)
    return check_rollouts(searched, judges, validator, nothing, found, found.names, (), windows)


def test_a_right_effect_is_refused_where_what_acts_against_it_is_missing(cube: ObjectModel) -> None:
    """Without the bounce, a cube that the ground holds on to stops too early. With the bounce, both are right."""
    both = hypothesis(cube, restitution=[0.3], adhesion=[0.5])
    alone = _check(hypothesis(cube, adhesion=[0.5]), both.world(), cube, unseen=24)
    assert alone is not None
    assert alone.whole.refused
    assert alone.refused == ("adhesion",)
    assert alone.whole.position_pct > 1.0
    together = _check(both, both.world(), cube, unseen=24)
    assert together is not None
    assert together.refused == ()
    assert together.whole.position_pct < -5.0
    assert together.whole.p_value > 0.9


def test_a_wrong_effect_beside_a_right_one_is_refused_alone(cube: ObjectModel) -> None:
    truth = hypothesis(cube, friction=[0.3])
    found = truth.plus(EFFECTS["inertia"], np.array([0.7]))
    check = _check(found, truth.world(), cube, unseen=24)
    assert check is not None
    assert check.refused == ("inertia",)
    assert not check.whole.refused
    assert check.tosses == check.unseen == 24


def test_what_hardly_moves_whole_tosses_is_not_refused(cube: ObjectModel) -> None:
    """A friction off by 0.0005 makes some tosses worse, all by less than the tolerance."""
    check = _check(hypothesis(cube, friction=[0.1805]), World(cube), cube, unseen=24)
    assert check is not None
    assert check.refused == ()
    assert abs(check.whole.position_pct) < 0.1


def test_nothing_found_is_not_judged(cube: ObjectModel) -> None:
    assert _check(Hypothesis(World(cube)), World(cube), cube, unseen=4) is None


def test_few_unseen_tosses_are_joined_by_those_of_judging_folds(cube: ObjectModel) -> None:
    """Each fold is predicted by its own hypothesis: here a wrong one where the other has none."""
    tosses = seen(World(cube), cube, 12, seed=3)
    validator = CrossValidator.of(tosses, cube, seed=0)
    nothing, wrong = Hypothesis(World(cube)), hypothesis(cube, friction=[0.4])
    held = np.arange(12) < 6
    empty = np.zeros((0, 1, 6))
    folds = [
        JudgingFold(part, theirs, empty, np.zeros(0, dtype=np.int64))
        for part, theirs in ((held, wrong), (~held, nothing))
    ]
    check = check_rollouts(tosses, (), validator, nothing, wrong, ("friction",), folds, None)
    assert check is not None
    assert (check.tosses, check.unseen) == (12, 0)
    # six tosses get worse, the six of the other fold stay: the median is between
    assert check.whole.position_pct > 0.1
    both = [JudgingFold(part, wrong, empty, folds[0].rows) for part in (held, ~held)]
    worse = check_rollouts(tosses, (), validator, nothing, wrong, ("friction",), both, None)
    assert worse is not None
    assert worse.whole.refused
    assert worse.whole.position_pct > check.whole.position_pct


@pytest.mark.parametrize(("by", "refused"), [(0.4, False), (0.8, True), (-3.0, False)])
def test_growth_counts_beyond_its_tolerance(by: float, refused: bool) -> None:
    before = RNG.uniform(5, 50, (20, 2))
    growth = Growth.of(before + by + 0.05 * RNG.normal(size=before.shape), before, 0.05)
    assert growth.refused == refused
    assert growth.position_pct == pytest.approx(by, abs=0.1)


def test_a_few_tosses_that_contact_throws_elsewhere_decide_nothing() -> None:
    """Means grow by 10 % of the width, while 17 of 20 tosses are better."""
    before = RNG.uniform(5, 10, (20, 2))
    errors = before - 1.0
    errors[:3] += 100.0
    assert (errors - before).mean() > 10.0
    growth = Growth.of(errors, before, 0.05)
    assert not growth.refused
    assert growth.position_pct == pytest.approx(-1.0)


def test_rollouts_that_diverge_are_worse_than_any(cube: ObjectModel) -> None:
    before = RNG.uniform(5, 10, (20, 2))
    errors = np.where(np.arange(20)[:, None] < 16, np.nan, before)
    assert Growth.of(errors, before, 0.05).refused
    assert not Growth.of(before, errors, 0.05).refused
    assert not Growth.of(errors, errors, 0.05).refused


def test_one_of_many_effects_is_refused_at_a_stricter_level() -> None:
    fine, worse = (Growth(x, 0.0, x, p, 0.05) for x, p in ((-5.0, 1.0), (3.0, 0.03)))
    check = RolloutCheck(20, 20, fine, (("friction", fine), ("inertia", worse)))
    assert check.refused == ("inertia",)
    assert RolloutCheck(20, 20, worse, check.effects).refused == ("friction", "inertia")
    kept = check.as_json()
    assert kept["refused"] is False
    assert [each["refused"] for each in kept["effects"]] == [False, True]


def test_a_turn_that_gets_worse_is_borne_for_a_larger_gain_in_place() -> None:
    """A ball that bounces at last is where it should be, with the wrong spin. One that only spins worse is refused."""
    before = np.column_stack([RNG.uniform(120, 150, 12), RNG.uniform(15, 25, 12)])
    bounces = np.column_stack([RNG.uniform(15, 30, 12), RNG.uniform(35, 50, 12)])
    assert not Growth.of(bounces, before, 0.05).refused
    assert Growth.of(bounces, before, 0.05).p_value < 0.05
    spins = np.column_stack([before[:, 0] - 1.0, bounces[:, 1]])
    assert Growth.of(spins, before, 0.05).refused
