"""What changes over the order of recording is undone where it is the recording, and said where it is not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis import over_order
from tossid.diagnosis.correction import corrected
from tossid.diagnosis.inference.designs import steps_at
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.order import OverOrder
from tossid.diagnosis.inference.stretches import Change
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
TILT = [0.012, -0.006]


def tosses_of(worlds: Sequence[World], cube: ObjectModel, frames: int = 60) -> tuple[Toss, ...]:
    made = (seen(world, cube, 1, seed=30 + k, frames=frames)[0] for k, world in enumerate(worlds))
    return tuple(replace(toss, name=f"t{k}") for k, toss in enumerate(made))


@pytest.fixture(scope="module")
def bumped(cube: ObjectModel) -> Undone:
    """Slippery tosses; before the eleventh the camera was tilted. Two of them, one of each session, are unseen."""
    slippery = with_effect(cube, "friction", [0.26])
    tilted = EFFECTS["world_tilt"].at(slippery, np.array(TILT))
    tosses = tosses_of([slippery] * 10 + [tilted] * 12, cube)
    names = tuple(toss.name for toss in tosses)
    problem = Problem(
        (*tosses[:3], *tosses[4:21]),
        Hypothesis(World(cube)),
        library=LIBRARY,
        unseen=(tosses[3], tosses[21]),
        names=names,
        sessions=("t10",),
    )
    return without_changes(problem.in_order())


def test_a_tilt_is_undone_and_what_is_in_all_tosses_is_found(bumped: Undone, cube: ObjectModel) -> None:
    (change,) = bumped.changes
    assert (change.effect.name, [s.first for s in change.stretches]) == ("world_tilt", [0, 9])
    np.testing.assert_allclose(change.values[-1], TILT, atol=1e-3)
    assert bumped.found.hypothesis.names == ("friction",)
    assert bumped.found.hypothesis.values_of("friction")[0] == pytest.approx(0.26, abs=0.01)
    assert bumped.left.changes == ()
    assert bumped.left.left is not None
    assert bumped.left.left > 0.005
    last = bumped.problem.unseen[1]
    tilted = EFFECTS["world_tilt"].at(World(cube), np.array(TILT))
    (recorded,) = seen(
        EFFECTS["world_tilt"].at(with_effect(cube, "friction", [0.26]), np.array(TILT)), cube, 1, seed=51, frames=60
    )
    np.testing.assert_allclose(last.q[:, :3], corrected(recorded, tilted, World(cube)).q[:, :3], atol=1e-3)


def test_what_was_undone_is_said(bumped: Undone, cube: ObjectModel) -> None:
    slippery = with_effect(cube, "friction", [0.26])
    tilted = EFFECTS["world_tilt"].at(slippery, np.array(TILT))
    recorded = tosses_of([slippery] * 10 + [tilted] * 12, cube)
    recorded = (*recorded[:3], *recorded[4:21])
    (finding,) = findings_over_order(bumped, recorded)
    assert (finding.name, finding.verdict) == ("world_tilt", "identified")
    over = finding.over_order
    assert over is not None
    assert over.undone
    assert [(s.first, s.last, s.n_tosses) for s in over.stretches] == [("t0", "t9", 9), ("t10", "t20", 11)]
    assert finding.parameters["x_rad"].value == pytest.approx(TILT[0] * 11 / 20, abs=1e-3)
    assert finding.stated == {"x_rad": 0.0, "y_rad": 0.0}
    assert finding.matters
    assert 0.0 < finding.gap_closed.value < 1.0
    assert finding.as_json()["sessions"][1]["first"] == "t10"
    assert changes_left(bumped, recorded) == ()
    (text,) = corrections(bumped).values()
    assert text.startswith("tosses t0 to t9: ")
    assert "; tosses t10 to t20: " in text


def test_a_step_is_fitted_beside_what_all_tosses_have(cube: ObjectModel) -> None:
    """Fitted alone, it would take half a milliradian of what the centre of mass does."""
    same = EFFECTS["com_offset"].at(with_effect(cube, "friction", [0.26]), np.array([0.004, 0.0, -0.004]))
    tilted = EFFECTS["world_tilt"].at(same, np.array([0.03, -0.02]))
    library = tuple(EFFECTS[name] for name in ("world_tilt", "friction", "length_scale", "uniform_force", "com_offset"))
    tosses = tosses_of([same] * 12 + [tilted] * 12, cube)
    undone = without_changes(Problem(tosses, Hypothesis(World(cube)), library=library, sessions=("t12",)).in_order())
    (change,) = undone.changes
    assert set(undone.found.hypothesis.names) == {"com_offset", "friction"}
    np.testing.assert_allclose(change.values[0], 0.0, atol=2e-4)
    np.testing.assert_allclose(change.values[-1], [0.03, -0.02], atol=2e-4)


def test_friction_that_steps_is_left_and_said(cube: ObjectModel) -> None:
    tosses = tosses_of([World(cube)] * 7 + [with_effect(cube, "friction", [0.26])] * 7, cube)
    problem = Problem(tosses, Hypothesis(World(cube)), library=LIBRARY, sessions=("t7",)).in_order()
    undone = without_changes(problem)
    assert undone.changes == ()
    assert undone.problem is problem
    (change,) = undone.left.changes
    assert (change.effect.name, [s.first for s in change.stretches]) == ("friction", [0, 7])
    (finding,) = findings_over_order(undone, tosses)
    assert finding.over_order is not None
    assert not finding.over_order.undone
    assert finding.parameters["mu"].value == pytest.approx(0.22, abs=0.01)
    assert corrections(undone) == {}


def test_what_all_tosses_have_of_an_effect_joins_its_change(cube: ObjectModel, monkeypatch: pytest.MonkeyPatch) -> None:
    worlds = [with_effect(cube, "world_tilt", [x, 0.0]) for x in [0.005] * 6 + [0.017] * 6]
    edges, B = (0, 6, 12), np.array([[-0.006, 0.0], [0.006, 0.0]])
    seen_first = Change(EFFECTS["world_tilt"], edges, 0.001, 50.0, steps_at(edges), B, 1e-8 * np.eye(4))
    p_values = iter([0.001])
    monkeypatch.setattr(over_order, "_p_value", lambda *_: next(p_values, 0.5))
    monkeypatch.setattr(over_order, "_changes_beside", lambda *_: OverOrder((seen_first,), None, None))
    problem = Problem(tosses_of(worlds, cube, frames=40), Hypothesis(World(cube)), library=LIBRARY[:1])
    undone = without_changes(problem.in_order())
    (change,) = undone.changes
    np.testing.assert_allclose(change.values[[0, -1], 0], [0.005, 0.017], atol=5e-4)
    assert [s.values["x_rad"].value for s in change.stretches] == pytest.approx([0.005, 0.017], abs=5e-4)
    assert undone.found.hypothesis.names == ()


def test_tosses_come_in_the_order_of_their_recording(cube: ObjectModel) -> None:
    a, b, c = tosses_of([World(cube)] * 3, cube, frames=8)
    problem = Problem((c, a), Hypothesis(World(cube)), unseen=(b,), names=("t0", "t1", "t2")).in_order()
    assert [toss.name for toss in problem.tosses] == ["t0", "t2"]
    assert Problem((c, a), Hypothesis(World(cube)), unseen=(b,)).in_order().names == ("t2", "t0", "t1")


def test_nothing_is_looked_at_where_tosses_are_few(cube: ObjectModel) -> None:
    tosses = tosses_of([World(cube)] * 6, cube, frames=40)
    undone = without_changes(Problem(tosses, Hypothesis(World(cube)), library=LIBRARY).in_order())
    assert undone.left == OverOrder((), None, None)
    assert changes_left(undone, tosses) is None
    assert findings_over_order(undone, tosses) == ()


def test_a_tilt_between_stretches_is_no_slow_error(cube: ObjectModel) -> None:
    tosses = tosses_of([World(cube)] * 10 + [with_effect(cube, "world_tilt", [0.03, 0.0])] * 10, cube, frames=140)
    edges, B = (0, 10, 20), np.array([[0.0, 0.0], [0.03, 0.0]])
    change = Change(EFFECTS["world_tilt"], edges, 0.001, 50.0, steps_at(edges), B, np.zeros((4, 4)))
    problem = Problem(tosses, Hypothesis(World(cube))).in_order()
    right = over_order._corrected(problem, (change,)).tosses
    whole, within = (np.abs(problem.windows_of(tosses, each).slow).max() for each in (tosses, right))
    assert within < 0.5 * whole
