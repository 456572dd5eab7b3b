"""The library: what objects can have, and what a user adds to it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.effects.toy import HEIGHT_PULL, registered
from tossid import code_digest as digests
from tossid.audit.strengths import strengths_for
from tossid.code_digest import code_digest
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.physics.effects import (
    BUILT_IN,
    JOINT_EFFECTS,
    LIBRARY,
    all_effects,
    effect_named,
    effects_for,
    register_effect,
    unregister_effect,
)


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


def test_a_registered_effect_is_in_the_library_and_in_digests(
    cube: ObjectModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(digests, "_outside", {})
    before = code_digest("tossid.physics.effects.registry")
    with registered() as effect:
        assert effects_for(cube)[-1] is effect
        assert effect_named("height_pull") is effect
        assert "height_pull" in strengths_for(cube)
        assert code_digest("tossid.physics.effects.registry") != before
        with pytest.raises(InputError, match="already is an effect 'height_pull'"):
            register_effect(effect)
    assert all_effects() == BUILT_IN
    with pytest.raises(InputError, match="no effect 'height_pull'"):
        effect_named("height_pull")
    with pytest.raises(InputError, match="no effect 'gravity' was registered"):
        unregister_effect("gravity")
    assert HEIGHT_PULL.name == "height_pull"


def test_the_further_power_of_a_force_is_found_by_its_name() -> None:
    law = effect_named("quadratic_drag").other_power_law
    assert law is not None
    assert effect_named(law.name) is law
    with pytest.raises(InputError, match="there is no effect 'friction's power'"):
        effect_named("friction's power")
