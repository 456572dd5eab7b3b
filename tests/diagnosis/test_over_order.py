"""What changes over the order of recording is undone where it is the recording, and said where it is not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.correction import corrected
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.order import OverOrder
from tossid.diagnosis.over_order import (
    Undone,
    changes_left,
    corrections,
    findings_over_order,
    without_changes,
)
from tossid.diagnosis.problem import Problem
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import Toss

LIBRARY = tuple(EFFECTS[name] for name in ("world_tilt", "friction", "length_scale"))
TILT = [0.03, -0.02]


def tosses_of(worlds: Sequence[World], cube: ObjectModel, frames: int = 60) -> tuple[Toss, ...]:
    made = (seen(world, cube, 1, seed=30 + k, frames=frames)[0] for k, world in enumerate(worlds))
    return tuple(replace(toss, name=f"t{k}") for k, toss in enumerate(made))


@pytest.fixture(scope="module")
def recorded(cube: ObjectModel) -> tuple[Toss, ...]:
    """Of a slippery cube with its centre of mass elsewhere; before the thirteenth the camera was tilted."""
    same = EFFECTS["com_offset"].at(with_effect(cube, "friction", [0.26]), np.array([0.004, 0.0, -0.004]))
    return tosses_of([same] * 12 + [EFFECTS["world_tilt"].at(same, np.array(TILT))] * 12, cube)


@pytest.fixture(scope="module")
def bumped(cube: ObjectModel, recorded: tuple[Toss, ...]) -> Undone:
    """Two of them, one of each session, are unseen."""
    library = (*LIBRARY, EFFECTS["uniform_force"], EFFECTS["com_offset"])
    names = tuple(toss.name for toss in recorded)
    some = Problem((*recorded[:3], *recorded[4:23]), Hypothesis(World(cube)), library=library, names=names)
    return without_changes(replace(some, unseen=(recorded[3], recorded[23]), sessions=("t12",)).in_order())


def test_a_tilt_is_undone_beside_what_all_tosses_have(
    bumped: Undone, recorded: tuple[Toss, ...], cube: ObjectModel
) -> None:
    """Fitted alone, it would take half a milliradian of what the centre of mass does."""
    (change,) = bumped.changes
    assert (change.effect.name, [s.first for s in change.stretches]) == ("world_tilt", [0, 11])
    np.testing.assert_allclose(change.values[[0, -1]], [[0.0, 0.0], TILT], atol=2e-4)
    assert set(bumped.found.hypothesis.names) == {"com_offset", "friction"}
    assert bumped.found.hypothesis.values_of("friction")[0] == pytest.approx(0.26, abs=0.01)
    assert bumped.left.changes == ()
    assert bumped.left.left is not None
    assert bumped.left.left > 0.005
    right = corrected(recorded[23], with_effect(cube, "world_tilt", TILT), World(cube))
    np.testing.assert_allclose(bumped.problem.unseen[1].q[:, :3], right.q[:, :3], atol=1e-3)


def test_what_was_undone_is_said(bumped: Undone, recorded: tuple[Toss, ...]) -> None:
    seen_ones = (*recorded[:3], *recorded[4:23])
    (finding,) = findings_over_order(bumped, seen_ones)
    assert (finding.name, finding.verdict) == ("world_tilt", "identified")
    over = finding.over_order
    assert over is not None
    assert over.undone
    assert [(s.first, s.last, s.n_tosses) for s in over.stretches] == [("t0", "t11", 11), ("t12", "t22", 11)]
    assert finding.parameters["x_rad"].value == pytest.approx(TILT[0] / 2, abs=1e-3)
    assert finding.stated == {"x_rad": 0.0, "y_rad": 0.0}
    assert finding.matters
    assert 0.0 < finding.gap_closed.value < 1.0
    assert finding.as_json()["sessions"][1]["first"] == "t12"
    assert changes_left(bumped, seen_ones) == ()
    (text,) = corrections(bumped).values()
    assert text.startswith("tosses t0 to t11: ")
    assert "; tosses t12 to t22: " in text


def test_friction_that_steps_is_left_and_said(cube: ObjectModel) -> None:
    tosses = tosses_of([World(cube)] * 8 + [with_effect(cube, "friction", [0.26])] * 8, cube)
    problem = Problem(tosses, Hypothesis(World(cube)), library=LIBRARY, sessions=("t8",)).in_order()
    undone = without_changes(problem)
    assert undone.changes == ()
    assert undone.problem is problem
    (change,) = undone.left.changes
    assert (change.effect.name, [s.first for s in change.stretches]) == ("friction", [0, 8])
    (finding,) = findings_over_order(undone, tosses)
    assert finding.over_order is not None
    assert not finding.over_order.undone
    assert finding.parameters["mu"].value == pytest.approx(0.22, abs=0.01)
    assert corrections(undone) == {}


def test_what_all_tosses_have_of_an_effect_joins_its_change(cube: ObjectModel) -> None:
    worlds = [with_effect(cube, "world_tilt", [x, 0.0]) for x in [0.005] * 8 + [0.017] * 8]
    problem = Problem(tosses_of(worlds, cube), Hypothesis(World(cube)), library=LIBRARY[:1])
    undone = without_changes(problem.in_order())
    (change,) = undone.changes
    np.testing.assert_allclose(change.values[[0, -1], 0], [0.005, 0.017], atol=5e-4)
    assert [s.values["x_rad"].value for s in change.stretches] == pytest.approx([0.005, 0.017], abs=5e-4)
    assert undone.found.hypothesis.names == ()


def test_tosses_come_in_the_order_of_their_recording_and_few_are_not_looked_at(cube: ObjectModel) -> None:
    tosses = tosses_of([World(cube)] * 6, cube, frames=40)
    a, b, c = tosses[:3]
    some = Problem((c, a), Hypothesis(World(cube)), unseen=(b,), names=("t0", "t1", "t2"))
    assert [toss.name for toss in some.in_order().tosses] == ["t0", "t2"]
    assert replace(some, names=()).in_order().names == ("t2", "t0", "t1")
    undone = without_changes(Problem(tosses, Hypothesis(World(cube)), library=LIBRARY).in_order())
    assert undone.left == OverOrder((), None, None)
    assert changes_left(undone, tosses) is None
    assert findings_over_order(undone, tosses) == ()


def test_a_tilt_between_stretches_is_no_slow_error(cube: ObjectModel) -> None:
    tilted = with_effect(cube, "world_tilt", [0.03, 0.0])
    tosses = tosses_of([World(cube)] * 10 + [tilted] * 10, cube, frames=140)
    right = (*tosses[:10], *(corrected(toss, tilted, World(cube)) for toss in tosses[10:]))
    problem = Problem(tosses, Hypothesis(World(cube))).in_order()
    whole, within = (np.abs(problem.windows_of(tosses, each).slow).max() for each in (tosses, right))
    assert within < 0.5 * whole
