"""Changes of one frame: scaled by their contact, brought to touch where theirs does, and no contact in the air."""

from __future__ import annotations

import numpy as np
import pytest

from tests.models.made import DT
from tossid.diagnosis.likelihood.step_changes import Contact, State, StepChanges, motions
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effect_named

HOW = {"substeps": 4, "impact_parts": 8}
HALF = 0.0524
SPEED = 0.8


def sliding(height: float) -> State:
    """A cube that slides along x, so high over the ground."""
    return State(np.array([[0.0, 0, HALF + height, 1, 0, 0, 0]]), np.array([[SPEED, 0, 0, 0, 0, 0]]))


def slower(cube: ObjectModel, at: State, theirs: State, contact: Contact = Contact()) -> float:
    """Change of velocity along x by friction of 0.28 in place of 0.18."""
    world = effect_named("friction").at(World(cube), np.array([0.28]))
    change: float = StepChanges(world, World(cube), DT, HOW, contact)(at, theirs)[0, 6]
    return change


@pytest.mark.parametrize("share", [0.5, 1.0, 1.5])
def test_friction_changes_with_the_load_that_theirs_carries(cube: ObjectModel, share: float) -> None:
    at = sliding(0.0)
    theirs = State(at.q, at.v + np.array([0, 0, (share - 1) * 9.81 * DT, 0, 0, 0]))
    assert slower(cube, at, theirs) == pytest.approx(-0.1 * 9.81 * DT * share, rel=0.02)


def test_theirs_touches_at_some_height(cube: ObjectModel) -> None:
    at = sliding(1e-3)
    assert slower(cube, at, at) == pytest.approx(-0.1 * 9.81 * DT, rel=0.05)


def test_what_else_holds_theirs_in_the_air_is_no_contact(cube: ObjectModel) -> None:
    at = sliding(0.02)
    assert slower(cube, at, at) == 0.0


def test_gravity_changes_flight_whole_and_rest_not(cube: ObjectModel) -> None:
    heavier = StepChanges(effect_named("gravity").at(World(cube), np.array([10.81])), World(cube), DT, HOW)
    above, below = sliding(0.1), State(sliding(0.0).q, np.zeros((1, 6)))
    fallen = State(above.q, above.v - np.array([0, 0, 9.81 * DT, 0, 0, 0]))
    assert heavier(above, fallen)[0, 8] == pytest.approx(-DT)
    assert heavier(below, below)[0, 8] == pytest.approx(0.0, abs=1e-4)


def test_an_effect_of_bounce_is_relative_to_rigid_contact(cube: ObjectModel) -> None:
    soft = Contact(compliance=1e-4, relaxation=0.02, step_count=4)
    bouncing = StepChanges(effect_named("restitution").at(World(cube), np.array([0.5])), World(cube), DT, HOW, soft)
    assert bouncing.plain.compliance == 0.0
    rubbing = StepChanges(effect_named("friction").at(World(cube), np.array([0.5])), World(cube), DT, HOW, soft)
    assert rubbing.plain.compliance == rubbing.changed.compliance == 1e-4


def test_impulses_are_those_of_contact(cube: ObjectModel) -> None:
    _, impulse = motions(World(cube).system(), sliding(0.0), 10, DT, HOW)
    assert impulse[0] == pytest.approx(float(cube.mass.sum()) * 9.81 * 10 * DT, rel=1e-3)
