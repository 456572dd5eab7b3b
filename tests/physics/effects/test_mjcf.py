"""Contact in MuJoCo's numbers, and edits of an MJCF model; what whole patches do is in tests/diagnosis/patch."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tossid.errors import ObjectError
from tossid.objects import ObjectModel
from tossid.physics.effects import Law, World
from tossid.physics.effects.mjcf_edit import Edit
from tossid.physics.effects.mujoco_contact import SOFT_IMPEDANCE, bouncing_solref, damping_ratio, soft_contact


def test_the_damping_ratio_of_no_bounce_and_of_all() -> None:
    assert damping_ratio(0.999) < 1e-3
    assert damping_ratio(np.exp(-2.0)) == pytest.approx(1.0)  # critical damping
    assert damping_ratio(0.02) > 2.0


@pytest.mark.parametrize("e", [0.1, 0.5, 0.9])
def test_a_bouncing_contact_leaves_with_its_share_of_the_speed(e: float) -> None:
    """The oscillator x'' = -k x - d x' from x = 0, until its force would become a pull."""
    k, d = (-number for number in bouncing_solref(e, 1e-3))
    x, v, h = 0.0, -1.0, 1e-6
    while -k * x - d * v > 0:
        v += h * (-k * x - d * v)
        x += h * v
    assert v == pytest.approx(e, abs=5e-3)
    assert np.sqrt(k) * 1e-3 <= 0.5  # the time step resolves it


def test_a_yielding_contact_has_its_stiffness_damping_and_added_mass(cube: ObjectModel) -> None:
    inverse, stiffness, relaxation = 5.0, 2e4, 3e-3
    body = cube.with_changes(compliance=1 / stiffness, relaxation=relaxation)
    plain, held = (soft_contact(World(body, law=Law(added_mass=mass)), inverse) for mass in (0.0, 0.8))
    assert plain.impedance == SOFT_IMPEDANCE
    assert held.impedance / (1 - held.impedance) == pytest.approx(0.8 * inverse)
    for soft in (plain, held):
        D, R = soft.impedance, (1 - soft.impedance) / soft.impedance * inverse
        K, B = -soft.solref[0] / D**2, -soft.solref[1] / D  # as MuJoCo scales them
        assert pytest.approx(stiffness) == K * D / R
        assert pytest.approx(relaxation * stiffness) == B / R


LINKS = """<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1"/>
    <geom name="wall" type="box" size="1 1 1" contype="0" conaffinity="0"/>
    <body name="a"><freejoint/><geom name="own" size=".1" mass="1"/>
      <body><joint name="hinge" type="hinge"/><geom size=".05" mass="1"/></body>
    </body>
  </worldbody>
</mujoco>"""


def test_an_edit_is_made_and_recorded_of_what_collides_and_turns() -> None:
    made = Edit(mujoco.MjSpec.from_string(LINKS), effect="friction")
    assert [geom.name for geom in made.grounds] == ["floor"]
    assert (len(made.own), [joint.name for joint in made.joints], made.body.name) == (2, ["hinge"], "a")
    made.set(made.spec.option, "timestep", made.spec.option.timestep, "option")  # what stays is no change
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
    made.own[0].size = [-1.0, 0.0, 0.0]
    with pytest.raises(ObjectError, match="cannot compile the patched model"):
        made.compiled()
