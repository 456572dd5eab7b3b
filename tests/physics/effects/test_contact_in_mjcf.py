"""Contact's edits of an MJCF model, read back from the compiled one."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tossid.objects import ObjectModel
from tossid.physics.effects import Law, World
from tossid.physics.effects.contact_in_mjcf import (
    write_compliance,
    write_friction,
    write_restitution,
    write_rigid_contact,
)
from tossid.physics.effects.mjcf_edit import Edit
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
