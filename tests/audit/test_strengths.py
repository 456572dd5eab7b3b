"""Worlds with effects, and the strengths that an object's effects have."""

from __future__ import annotations

import numpy as np

from tossid.audit.strengths import strengths_for, world_with
from tossid.objects import ObjectModel
from tossid.physics.effects import JOINT_EFFECTS, LIBRARY, World


def test_joints_have_theirs_only_where_there_are_joints(cube: ObjectModel, elbow: ObjectModel) -> None:
    of_all = [effect.name for effect in LIBRARY if effect.name != "rotation_delay"]
    assert list(strengths_for(cube)) == of_all
    assert list(strengths_for(elbow)) == [*of_all, *(effect.name for effect in JOINT_EFFECTS)]


def test_a_world_gets_effects_with_their_other_parameters_nominal(cube: ObjectModel) -> None:
    world = world_with(World(cube), {"friction": {"mu": 0.4}, "com_offset": {"y_m": 0.003}})
    assert world.object.friction == 0.4
    np.testing.assert_allclose(world.object.com[0] - cube.com[0], [0, 0.003, 0])
