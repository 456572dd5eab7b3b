"""An effect states all that is needed to use it, or it cannot be made."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.physics.effects import BUILT_IN, LIBRARY, Effect, InMujoco, NotExpressible, World, effect_named
from tossid.physics.forces import PoweredForce

FRICTION = effect_named("friction")


@pytest.mark.parametrize("field", ["mujoco", "mjcf", "strength"])
def test_an_effect_without_a_form_or_the_reason_is_refused(field: str) -> None:
    with pytest.raises(InputError, match=f"effect 'friction' states no {field}"):
        replace(FRICTION, **{field: None})
    given = {each.name: getattr(FRICTION, each.name) for each in fields(FRICTION) if each.name != field}
    with pytest.raises(TypeError, match=field):
        Effect(**given)


def test_a_reason_says_something_and_which_worlds_mujoco_must_refuse() -> None:
    with pytest.raises(InputError, match="states why"):
        NotExpressible(" ")
    with pytest.raises(InputError, match="which worlds have it"):
        replace(FRICTION, mujoco=NotExpressible("MuJoCo has no friction"))
    assert replace(FRICTION, strength=NotExpressible("no audit")).name == "friction"


@pytest.mark.parametrize("effect", BUILT_IN, ids=lambda effect: effect.name)
def test_a_world_has_an_effect_that_mujoco_lacks_exactly_when_it_was_applied(cube: ObjectModel, effect: Effect) -> None:
    if isinstance(effect.mujoco, InMujoco):
        return
    world = World(cube)
    assert effect.mujoco.present is not None
    assert not effect.mujoco.present(effect.at(world, effect.nominal(world)))
    values = np.array([p.low + 0.3 * k * (p.high - p.low) for k, p in enumerate(effect.parameters, start=1)])
    assert effect.mujoco.present(effect.at(world, values))


def test_values_are_clipped_to_their_ranges_and_named(cube: ObjectModel) -> None:
    assert FRICTION.at(World(cube), np.array([7.0])).object.friction == FRICTION.parameters[0].high
    assert FRICTION.named(np.array([0.3])) == {"mu": 0.3}
    assert FRICTION.nominal(World(cube)) == pytest.approx([cube.friction])


def test_a_force_may_grow_with_another_power(cube: ObjectModel) -> None:
    assert FRICTION.other_power_law is None
    law = effect_named("vortex").other_power_law
    assert law is not None
    assert law is effect_named("vortex").other_power_law
    forces = law.at(World(cube), np.array([1.5])).forces
    assert (forces.powered, forces.power) == (PoweredForce.VORTEX, 1.5)


@pytest.mark.parametrize("name", [effect.name for effect in LIBRARY if not effect.near_nothing])
def test_an_effect_at_its_nominal_values_changes_nothing(cube: ObjectModel, name: str) -> None:
    world = World(cube)
    effect = effect_named(name)
    same = effect.at(world, effect.nominal(world))
    rng = np.random.default_rng(0)
    q = np.concatenate([rng.uniform([-0.1, -0.1, 0.1], [0.1, 0.1, 0.2], (20, 3)), rng.normal(size=(20, 4))], axis=1)
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    v = rng.normal(size=(20, 6)) * [1, 1, 1, 5, 5, 5]
    nominal = world.roll_out(q, v, n_steps=60, dt=1 / 148, substeps=2)
    np.testing.assert_array_equal(same.roll_out(q, v, n_steps=60, dt=1 / 148, substeps=2), nominal)
