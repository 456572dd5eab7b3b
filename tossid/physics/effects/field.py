"""Effects of fields: forces that depend on the place or the velocity, and are the same for every object."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.physics.effects.changes import sets_forces
from tossid.physics.effects.effect import SHARED_AMONG_LINKS, Effect, InMujoco, MjcfEdit, NotExpressible, Parameter
from tossid.physics.effects.environment import GROUP_OF_TILTS
from tossid.physics.effects.mjcf_edit import Edit, write_acceleration
from tossid.physics.effects.strength import Strength, directed, signed
from tossid.physics.effects.world import World
from tossid.physics.forces import PoweredForce

Array = NDArray[np.float64]

_NO_SUCH_FORCE = NotExpressible("MJCF has no force of this form")


def _pull_of_size(size: float, u: Array) -> dict[str, float]:
    # no farther than throws are: a weak pull from afar is a uniform force
    return {"k_npm": size, "x_m": 0.4 * float(u[0]), "y_m": 0.4 * float(u[1]), "z_m": 0.3 + 0.3 * float(u[2])}


def _write_spring(edit: Edit, before: World, after: World) -> None:
    f = after.forces
    center = [f.center_x, f.center_y, f.center_z]
    edit.body.add_site(name="pulled", pos=after.object.com[0])
    edit.spec.worldbody.add_site(name="puller", pos=center)
    tendon = edit.spec.add_tendon(name="pull", stiffness=f.spring, springlength=[0.0, 0.0])
    tendon.wrap_site("pulled")
    tendon.wrap_site("puller")
    where = "tendon 'pull' from the body's site 'pulled' to the world's site 'puller'"
    edit.changed(where, "stiffness", 0, f.spring)
    edit.changed("site 'puller'", "pos", "", center)


UNIFORM_FORCE = Effect(
    name="uniform_force",
    family="field",
    says="a constant force",
    parameters=tuple(Parameter(f"{a}_n", 0.0, -5.0, 5.0, 0.02) for a in "xyz"),
    apply=sets_forces(x="x_n", y="y_n", z="z_n"),
    mujoco=InMujoco(),
    mjcf=MjcfEdit(write_acceleration),
    strength=Strength(0.01, 2.0, directed("x_n", "y_n", "z_n")),
    contains=("gravity",),
    one_of_group=GROUP_OF_TILTS,
)

POSITION_FORCE = Effect(
    name="position_force",
    family="field",
    says="a pull towards a point, as of a spring or a magnet",
    parameters=(
        Parameter("k_npm", 0.0, 0.0, 50.0, 0.1),
        *(Parameter(f"{a}_m", 0.0, -2.0, 2.0, 0.05, form=True) for a in "xyz"),
    ),
    apply=sets_forces(spring="k_npm", center_x="x_m", center_y="y_m", center_z="z_m"),
    mujoco=InMujoco(),
    mjcf=MjcfEdit(_write_spring, of_links=SHARED_AMONG_LINKS),
    strength=Strength(0.05, 15.0, _pull_of_size),
    contains=("uniform_force", "gravity"),
    starts=({"k_npm": 0.05}, {"k_npm": 0.5}, {"k_npm": 5.0}),
    powered=(PoweredForce.SPRING, "distance"),
)

VORTEX = Effect(
    name="vortex",
    family="field",
    says="a force around the world's vertical axis, in proportion to the distance from it",
    parameters=(Parameter("c_npm", 0.0, -20.0, 20.0, 0.05),),
    apply=sets_forces(vortex="c_npm"),
    mujoco=InMujoco(),
    mjcf=_NO_SUCH_FORCE,
    strength=Strength(0.1, 15.0, signed("c_npm")),
    powered=(PoweredForce.VORTEX, "distance from the axis"),
)

TURNING_FRAME = Effect(
    name="turning_frame",
    family="field",
    says="a sideways acceleration in proportion to velocity, as in a turning frame",
    parameters=(Parameter("rate_ps", 0.0, -5.0, 5.0, 0.02),),
    apply=sets_forces(turning="rate_ps"),
    mujoco=InMujoco(),
    mjcf=_NO_SUCH_FORCE,
    strength=Strength(0.03, 3.0, signed("rate_ps")),
    powered=(PoweredForce.TURNING, "speed"),
)

EFFECTS = (UNIFORM_FORCE, POSITION_FORCE, VORTEX, TURNING_FRAME)
"""The family, in the order in which its effects are fitted and drawn."""
