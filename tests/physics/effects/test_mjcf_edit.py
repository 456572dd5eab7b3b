"""Edits of a model are recorded with the values before and after."""

from __future__ import annotations

import mujoco
import pytest

from tossid.errors import ObjectError
from tossid.physics.effects.mjcf_edit import Edit

MODEL = """<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1"/>
    <geom name="wall" type="box" size="1 1 1" contype="0" conaffinity="0"/>
    <body name="a"><freejoint/><geom name="own" size=".1" mass="1"/>
      <body><joint name="hinge" type="hinge"/><geom size=".05" mass="1"/></body>
    </body>
  </worldbody>
</mujoco>"""


def edit() -> Edit:
    return Edit(mujoco.MjSpec.from_string(MODEL), effect="friction")


def test_a_change_is_recorded_and_made() -> None:
    made = edit()
    made.set(made.own[0], "friction", [0.4, 0.005, 0.0001], "geom 'own'", exact=False, note="a note")
    (change,) = made.changes
    assert change.as_json() == {
        "effect": "friction",
        "where": "geom 'own'",
        "attribute": "friction",
        "before": "1 0.005 0.0001",
        "after": "0.4 0.005 0.0001",
        "exact": False,
        "note": "a note",
    }
    compiled = made.compiled()
    assert compiled.geom_friction[compiled.geom("own").id, 0] == 0.4


def test_what_stays_as_it_is_is_no_change() -> None:
    made = edit()
    made.set(made.spec.option, "timestep", made.spec.option.timestep, "option")
    assert not made.changes


def test_ground_object_and_joints_are_what_collides_and_turns() -> None:
    made = edit()
    assert [geom.name for geom in made.grounds] == ["floor"]
    assert len(made.own) == 2
    assert [joint.name for joint in made.joints] == ["hinge"]
    assert made.body.name == "a"


def test_a_model_that_does_not_compile_is_an_object_error() -> None:
    made = edit()
    made.own[0].size = [-1.0, 0.0, 0.0]
    with pytest.raises(ObjectError, match="cannot compile the patched model"):
        made.compiled()
