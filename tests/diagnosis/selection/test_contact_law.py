"""Friction of impacts is as the tosses have it: chosen where it is clear without effects, and else with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS, hypothesis
from tests.diagnosis.tossed import seen
from tossid.diagnosis.selection.contact_law import under_other_impacts, with_contact_law
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def in_parts(world: World, parts: float) -> World:
    return replace(world, law=world.law._replace(impulse_parts=parts))


@pytest.mark.parametrize(("friction", "parts", "chosen"), [(0.18, 1.0, 1), (0.18, 64.0, 8), (0.3, 1.0, 1)])
def test_the_law_is_chosen_where_no_effect_hides_it(
    cube: ObjectModel, friction: float, parts: float, chosen: int
) -> None:
    """Where friction is not the stated one, turning slip makes up for a little of it, and is not taken."""
    truth = World(cube.with_changes(friction=friction), ground_tilt=(0.02 * (friction > 0.2), 0.0))
    validator = CrossValidator.of(seen(in_parts(truth, parts), cube, 6, seed=11), cube, seed=0)
    _, found = with_contact_law(validator, World(cube))
    assert (found.law.lifting, found.law.impulse_parts) == (0, chosen)


def test_the_law_of_impacts_is_exchanged_once_effects_show_it(cube: ObjectModel) -> None:
    """Friction and a bounce are found under the wrong law, and the tosses follow the other one; then no longer."""
    truth = EFFECTS["restitution"].at(World(cube.with_changes(friction=0.3)), np.array([0.3]))
    tosses = seen(in_parts(truth, 64.0), cube, 8, seed=3)
    validator = CrossValidator.of(tosses, cube, seed=0)
    found = hypothesis(cube, friction=[0.3], restitution=[0.3])
    other = under_other_impacts(validator, validator.evaluate(found))
    assert other is not None
    base = other.hypothesis.base
    assert (base.law.impulse_parts, base.object.friction) == (8, cube.friction)
    assert under_other_impacts(validator, validator.evaluate(other.hypothesis)) is None
