"""The library: what an effect states, what objects can have, what a user adds, and what several effects share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.models.made import DT, thrown
from tests.physics.effects.toy import registered
from tests.physics.trees import jointed
from tossid import code_digest as digests
from tossid.audit.strengths import strengths_for
from tossid.code_digest import code_digest
from tossid.errors import InputError, ObjectError
from tossid.objects import ObjectModel
from tossid.physics.effects import (
    BUILT_IN,
    JOINT_EFFECTS,
    LIBRARY,
    Effect,
    InMujoco,
    NotExpressible,
    Strength,
    World,
    all_effects,
    effect_named,
    effects_for,
    register_effect,
    unregister_effect,
)
from tossid.physics.forces import PoweredForce

FRICTION = effect_named("friction")


@pytest.mark.parametrize("effect", BUILT_IN, ids=lambda effect: effect.name)
def test_a_world_has_an_effect_that_mujoco_lacks_exactly_when_it_was_applied(cube: ObjectModel, effect: Effect) -> None:
    if isinstance(effect.mujoco, InMujoco):
        return
    world = World(cube)
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
    assert law is effect_named("vortex").other_power_law
    assert effect_named(law.name) is law
    forces = law.at(World(cube), np.array([1.5])).forces
    assert (forces.powered, forces.power) == (PoweredForce.VORTEX, 1.5)
    with pytest.raises(InputError, match="there is no effect 'friction's power'"):
        effect_named("friction's power")


@pytest.mark.parametrize("effect", BUILT_IN, ids=lambda effect: effect.name)
def test_an_effect_at_its_nominal_values_changes_nothing(cube: ObjectModel, elbow: ObjectModel, effect: Effect) -> None:
    if effect.near_nothing and effect not in JOINT_EFFECTS:
        return
    world = World(jointed(elbow, damping=1e-3) if effect in JOINT_EFFECTS else cube)
    q, v = thrown(np.random.default_rng(0), 20, world.object.n_joints)
    nominal, same = (
        each.roll_out(q, v, n_steps=60, dt=DT, substeps=2) for each in (world, effect.at(world, effect.nominal(world)))
    )
    np.testing.assert_array_equal(same, nominal)


def test_names_are_unique_and_effects_refer_to_each_other_by_them() -> None:
    names = [effect.name for effect in BUILT_IN]
    assert len(set(names)) == len(names)
    for effect in BUILT_IN:
        assert {*effect.contains, *effect.made_of, *effect.one_of_group} <= set(names)
        for other in effect.one_of_group:
            assert effect_named(other).one_of_group == effect.one_of_group
        for start in effect.starts:
            assert set(start) <= {p.name for p in effect.parameters}


def test_objects_with_joints_have_more_effects(cube: ObjectModel, elbow: ObjectModel) -> None:
    of_cube = effects_for(cube)
    assert [effect.name for effect in of_cube] == [effect.name for effect in LIBRARY]
    # no patch of contact is wider than the object
    (radius,) = next(effect for effect in of_cube if effect.name == "torsional_friction").parameters
    assert radius.high == pytest.approx(0.5 * np.sqrt(3) * 0.1048)
    of_links = effects_for(elbow)
    assert [effect.name for effect in of_links] == [effect.name for effect in (*LIBRARY, *JOINT_EFFECTS)]
    assert len(next(effect for effect in of_links if effect.name == "inertia").parameters) == 3
    with pytest.raises(ObjectError, match="damping of a joint is -1"):
        jointed(elbow, damping=-1.0)


def test_a_registered_effect_is_in_the_library_and_in_digests(
    cube: ObjectModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(digests, "_outside", {})
    before = code_digest()
    with registered() as effect:
        assert effects_for(cube)[-1] is effect
        assert effect_named("height_pull") is effect
        assert "height_pull" in strengths_for(cube)
        assert code_digest() != before
        with pytest.raises(InputError, match="already is an effect 'height_pull'"):
            register_effect(effect)
    assert all_effects() == BUILT_IN
    with pytest.raises(InputError, match="no effect 'height_pull'"):
        effect_named("height_pull")
    with pytest.raises(InputError, match="no effect 'gravity' was registered"):
        unregister_effect("gravity")


@pytest.mark.parametrize("effect", BUILT_IN, ids=lambda effect: effect.name)
def test_an_effect_s_strengths_are_within_the_ranges_of_its_parameters(effect: Effect) -> None:
    if effect.name == "rotation_delay":  # moves no position, by which an audit measures strengths
        assert isinstance(effect.strength, NotExpressible)
        return
    assert isinstance(effect.strength, Strength)
    known = {p.name: p for p in effect.parameters}
    rng = np.random.default_rng(0)
    for size in (effect.strength.low, effect.strength.high):
        for _ in range(5):
            for key, value in effect.strength.values(size, rng.uniform(-1, 1, 8)).items():
                assert known[key].low <= value <= known[key].high, (key, value)


@pytest.mark.parametrize("field", ["mujoco", "mjcf", "strength"])
def test_an_effect_without_a_form_or_the_reason_is_refused(field: str) -> None:
    with pytest.raises(InputError, match=f"effect 'friction' states no {field}"):
        replace(FRICTION, **{field: None})
    with pytest.raises(InputError, match="states why"):
        NotExpressible(" ")
    with pytest.raises(InputError, match="which worlds have it"):
        replace(FRICTION, mujoco=NotExpressible("MuJoCo has no friction"))
