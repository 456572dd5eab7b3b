"""Effects of joints, and recorded joint angles."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.trees import flying, jointed
from tossid.errors import ObjectError
from tossid.objects import ObjectModel
from tossid.physics.effects import JOINT_EFFECTS, RecordingErrors, World, effects_for

DT = 1 / 148


def test_the_library_of_an_object_with_joints(cube: ObjectModel, elbow: ObjectModel) -> None:
    assert {e.name for e in effects_for(elbow)} - {e.name for e in effects_for(cube)} == {
        "joint_damping",
        "joint_friction",
        "joint_stiffness",
        "joint_offset",
    }
    world = World(jointed(elbow, damping=1e-3))
    q, v = flying(elbow)
    nominal = world.roll_out(q, v, n_steps=10, dt=DT, substeps=2)
    for effect in JOINT_EFFECTS:
        same = effect.at(world, effect.nominal(world))
        np.testing.assert_array_equal(same.roll_out(q, v, n_steps=10, dt=DT, substeps=2), nominal)


def test_recorded_joints_come_back(elbow: ObjectModel) -> None:
    world = World(elbow, recording=RecordingErrors(length_scale=1.1, clock_rate=0.9, joint_offset=0.3))
    q, v = flying(elbow)
    recorded_q, recorded_v = world.recorded(q, v)
    np.testing.assert_allclose(recorded_q[:, 7], q[:, 7] + 0.3)
    back = world.to_ground(recorded_q, recorded_v)
    np.testing.assert_allclose(back[0], q, atol=1e-12)
    np.testing.assert_allclose(back[1], v, atol=1e-12)


def test_a_joint_that_pushes_itself_is_refused(elbow: ObjectModel) -> None:
    with pytest.raises(ObjectError, match="damping of a joint is -1"):
        jointed(elbow, damping=-1.0)
