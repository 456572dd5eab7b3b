"""Contact in MuJoCo's numbers; edits of an MJCF model, read back from the compiled one, and the list of changes."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tossid.errors import ObjectError
from tossid.objects import ObjectModel
from tossid.physics.effects import Law, World
from tossid.physics.effects.mjcf_edit import Edit
from tossid.physics.effects.mujoco_contact import (
    SOFT_IMPEDANCE,
    bouncing_solref,
    damping_ratio,
    soft_contact,
    write_compliance,
    write_friction,
    write_restitution,
    write_rigid_contact,
)
from tossid.physics.mujoco_engine import RIGID_SOLIMP, RIGID_STEP

MODEL = """<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body name="cube"><freejoint/><geom name="own" type="box" size=".0524 .0524 .0524" mass="0.37"/></body>
  </worldbody>
</mujoco>"""


@pytest.fixture
def edit() -> Edit:
    return Edit(mujoco.MjSpec.from_string(MODEL), effect="contact")


def test_both_geoms_get_the_friction_since_mujoco_takes_the_larger(cube: ObjectModel, edit: Edit) -> None:
    after = World(cube.with_changes(friction=0.1), law=Law(torsional=0.02))
    write_friction(edit, World(cube), after)
    compiled = edit.compiled()
    np.testing.assert_allclose(compiled.geom_friction[:, :2], [[0.1, 0.02]] * 2)
    assert compiled.geom_condim.tolist() == [4, 4]


def test_a_bouncing_contact_is_near_rigid_and_less_damped_the_more_it_bounces(cube: ObjectModel) -> None:
    damping = []
    for e in (0.2, 0.8):
        edit = Edit(mujoco.MjSpec.from_string(MODEL), effect="restitution")
        write_restitution(edit, World(cube), World(cube.with_changes(restitution=e)))
        compiled = edit.compiled()
        assert compiled.opt.timestep == 2 * RIGID_STEP
        np.testing.assert_allclose(compiled.geom_solimp, [RIGID_SOLIMP] * 2)
        stiffness, resistance = -compiled.geom_solref[0]
        damping.append(resistance / (2 * np.sqrt(stiffness)))
    assert damping[0] > damping[1] > 0


def test_a_yielding_contact_gets_a_pair_and_a_step_that_resolves_it(cube: ObjectModel, edit: Edit) -> None:
    write_compliance(edit, World(cube), World(cube.with_changes(compliance=1e-5, relaxation=1e-3)))
    compiled = edit.compiled()
    assert compiled.npair == 1
    # ten times the object's mass would swing slower than this
    assert compiled.opt.timestep * np.sqrt(1e5 / 3.7) < 1
    assert (compiled.pair_solref[0] < 0).all()


def test_a_rigid_contact_has_coulomb_s_round_cone(edit: Edit) -> None:
    write_rigid_contact(edit)
    compiled = edit.compiled()
    assert compiled.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert (compiled.geom_solref[:, 0] == 2 * compiled.opt.timestep).all()
    assert all(change.effect == "contact" for change in edit.changes)


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


def of_links() -> Edit:
    return Edit(mujoco.MjSpec.from_string(LINKS), effect="friction")


def test_a_change_is_recorded_and_made_and_what_stays_is_none() -> None:
    made = of_links()
    made.set(made.spec.option, "timestep", made.spec.option.timestep, "option")
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


def test_ground_object_and_joints_are_what_collides_and_turns() -> None:
    made = of_links()
    assert [geom.name for geom in made.grounds] == ["floor"]
    assert len(made.own) == 2
    assert [joint.name for joint in made.joints] == ["hinge"]
    assert made.body.name == "a"


def test_a_model_that_does_not_compile_is_an_object_error() -> None:
    made = of_links()
    made.own[0].size = [-1.0, 0.0, 0.0]
    with pytest.raises(ObjectError, match="cannot compile the patched model"):
        made.compiled()
