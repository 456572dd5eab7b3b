"""A change of the recording is found and undone, and values of other tosses follow their place in the order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.sessions.changes import effect_over_order
from tossid.diagnosis.sessions.looking import TossOrder, tell_gap_of_first, undo_changes
from tossid.diagnosis.sessions.values import witnesses_of
from tossid.diagnosis.under_way import UnderWay
from tossid.motion.sessions.change_points import Change
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effect_named
from tossid.settings.diagnosis.order import OrderSettings
from tossid.types import Toss

FEW = [EFFECTS[name] for name in ("world_tilt", "friction")]


def tilted_from(cube: ObjectModel, at: int, n: int) -> tuple[Toss, ...]:
    """Tosses of which those from one on stand in a tilted world."""
    level = seen(World(cube), cube, at, seed=3, frames=60)
    tilted = seen(with_effect(cube, "world_tilt", [0.012, -0.006]), cube, n - at, seed=4, frames=60)
    return tuple(replace(toss, name=str(i)) for i, toss in enumerate([*level, *tilted]))


def test_a_tilt_is_found_and_undone(cube: ObjectModel) -> None:
    tosses = tilted_from(cube, 9, 20)
    # the dataset says that a session begins one toss earlier
    problem = Problem(tosses, World(cube), FEW, sessions=(tosses[8].name,)).in_order()
    first, last, found = undo_changes(problem)
    ((each, looked),) = found.undone
    assert looked is first
    assert each.effect.name == "world_tilt"
    assert each.edges in ((0, 8, 20), (0, 9, 20))
    np.testing.assert_allclose(each.values[-1], [0.012, -0.006], atol=1e-3)
    assert np.abs(each.values[0]).max() < 2e-3
    assert last.effect is None
    assert last.changes == ()


def test_the_gap_of_the_first_tosses_is_told_where_there_are_many(cube: ObjectModel) -> None:
    tosses = seen(World(cube.with_changes(friction=0.3)), cube, 25, seed=3, frames=60)
    for count, shown in ((11, 0), (12, 4), (25, 8)):
        told: list[str] = []
        under_way = UnderWay(news=told.append)
        tell_gap_of_first(Problem(tosses[:count], World(cube), FEW, under_way=under_way).in_order())
        assert len(told) == (shown > 0)
        if shown:
            assert f"(of the first {shown} of {count} tosses)" in told[0]
            assert under_way.so_far is not None
            assert len(under_way.so_far.tosses) == shown
    undo_changes(Problem(tosses, World(cube), FEW, under_way=under_way).in_order())
    assert len(told) == 2
    assert "tosses" not in told[-1]
    assert under_way.so_far is not None
    assert len(under_way.so_far.tosses) == 25


def test_first_tosses_that_are_too_short_are_no_error(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 24, seed=3, frames=60)
    short = [*(toss.frames(slice(5)) for toss in tosses[:8]), *tosses[8:]]
    told: list[str] = []
    tell_gap_of_first(Problem(short, World(cube), FEW, under_way=UnderWay(news=told.append)).in_order())
    assert told == []
    undo_changes(Problem(short, World(cube), FEW, under_way=UnderWay(news=told.append)).in_order())
    assert len(told) == 1


def test_a_tilt_that_grows_from_toss_to_toss_drifts(cube: ObjectModel) -> None:
    made = []
    for i in range(28):
        at = with_effect(cube, "world_tilt", [1e-3 * i, 0.0])
        made.append(replace(seen(at, cube, 1, seed=30 + i, frames=60)[0], name=str(i)))
    # ingest may divide a drift into sessions
    first, _, _ = undo_changes(Problem(made, World(cube), FEW, sessions=("14",)).in_order())
    assert first.effect is not None
    assert (first.effect.effect.name, first.effect.form) == ("world_tilt", "drift")
    assert first.effect.rate["x_rad"].value == pytest.approx(1e-3, rel=0.15)


def test_a_height_that_changes_is_no_slow_error_of_the_tracker(cube: ObjectModel) -> None:
    """With nearly half of the tosses raised, heights scatter as a tracker's that is off by as much would."""
    level = seen(World(cube), cube, 12, seed=3, frames=150)
    raised = seen(with_effect(cube, "ground_height", [3e-3]), cube, 9, seed=4, frames=150)
    tosses = tuple(replace(toss, name=str(i)) for i, toss in enumerate([*level, *raised]))
    library = [EFFECTS[name] for name in ("ground_height", "friction")]
    _, last, found = undo_changes(Problem(tosses, World(cube), library).in_order())
    ((each, _),) = found.undone
    assert (each.effect.name, each.edges) == ("ground_height", (0, 12, 21))
    np.testing.assert_allclose(each.values[[0, -1], 0], [0.0, 3e-3], atol=1e-4)
    assert last.changes == ()


def test_a_ground_that_rises_out_of_reach_is_found_though_another_effect_explains_some(cube: ObjectModel) -> None:
    """Objects that rest 10 mm above the stated ground do not feel it; a delay of rotations gains half as much."""
    level = seen(World(cube), cube, 12, seed=7, frames=150)
    raised = seen(with_effect(cube, "ground_height", [0.01]), cube, 9, seed=8, frames=150)
    tosses = tuple(replace(toss, name=str(i)) for i, toss in enumerate([*level, *raised]))
    library = [effect_named(name) for name in ("ground_height", "rotation_delay")]
    validator = Problem(tosses, World(cube), library).validator(over_order=True)
    present = validator.evaluate(Hypothesis(World(cube)))
    seen_over_order = witnesses_of(present, library, validator, np.zeros((21, 2)), np.zeros(21))
    changes = (Change(12, {"rotation_delay": 1e-3}),)
    found = effect_over_order(present, validator, library, seen_over_order, changes, OrderSettings())
    assert found is not None
    assert (found.effect.name, found.edges) == ("ground_height", (0, 12, 21))
    np.testing.assert_allclose(found.values[[0, -1], 0], [0.0, 0.01], atol=1e-4)


def test_noise_that_changes_is_no_effect(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 24, seed=5, frames=60)
    rng, noisy = np.random.default_rng(0), []
    for i, toss in enumerate(tosses):
        q = toss.q.copy()
        q[:, :3] += 6e-4 * (i >= 12) * rng.normal(size=(len(q), 3))
        noisy.append(replace(toss, q=q, name=str(i), q_measured=None, q_measured_cov=None))
    first, _, found = undo_changes(Problem(noisy, World(cube), [*FEW, EFFECTS["ground_height"]]).in_order())
    assert [change.at for change in first.changes] == pytest.approx([12], abs=3)
    assert first.effect is None
    assert found.undone == ()


def test_unseen_tosses_have_the_values_of_their_neighbours(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 4, seed=1, frames=8)
    tosses = [replace(toss, name=name) for toss, name in zip(tosses, ("0", "2", "4", "3"), strict=True)]
    names = ("0", "1", "2", "3", "4", "5")
    problem = Problem(tosses[:3], World(cube), unseen=tosses[3:], names=names, sessions=("4",))
    order = TossOrder.of(problem)
    assert order.boundaries == (2,)
    np.testing.assert_allclose(order.of_unseen(np.array([[0.0], [1.0], [3.0]])), [[2.0]])


def test_a_tilt_that_changes_is_named_beside_a_force_that_does_not(cube: ObjectModel) -> None:
    """In flight both fit alike. The force gains more on the whole, by what is the same in both sessions."""
    made = []
    for seed, tilt in ((3, [0.0, 0.0]), (4, [0.02, -0.01])):
        pushed = with_effect(cube, "uniform_force", [0.0, 0.0, 0.06])
        made += seen(EFFECTS["world_tilt"].at(pushed, np.array(tilt)), cube, 8, seed=seed, frames=22)
    library = [EFFECTS[name] for name in ("world_tilt", "uniform_force")]
    validator = Problem(made, World(cube), library).validator(over_order=True)
    present = validator.evaluate(Hypothesis(World(cube)))
    seen_over_order = witnesses_of(present, library, validator, np.zeros((16, 2)), np.zeros(16))
    changes = (Change(8, dict.fromkeys(("world_tilt", "uniform_force"), 1e-3)),)
    found = effect_over_order(present, validator, library, seen_over_order, changes, OrderSettings())
    assert found is not None
    assert (found.effect.name, found.edges) == ("world_tilt", (0, 8, 16))
    np.testing.assert_allclose(found.values[-1] - found.values[0], [0.02, -0.01], atol=4e-3)
