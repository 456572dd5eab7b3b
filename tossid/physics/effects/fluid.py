"""Effects of the air: drag, wind and Magnus's force."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.physics.effects.changes import sets_forces
from tossid.physics.effects.effect import SHARED_AMONG_LINKS, Effect, InMujoco, MjcfEdit, NotExpressible, Parameter
from tossid.physics.effects.mjcf_edit import Edit
from tossid.physics.effects.strength import Strength, between, directed, plain, signed
from tossid.physics.effects.world import World
from tossid.physics.forces import PoweredForce

Array = NDArray[np.float64]

LEAST_DRAG = 0.02
"""[N s/m] from which wind is fitted in a world without drag."""


def _wind_of_size(size: float, u: Array) -> dict[str, float]:
    # no faster than throws are: a gale in thin air is a uniform force
    return {**directed("x_ms", "y_ms")(between(1, 4, u[2]), u), "c_nspm": size}


def _box(world: World) -> Array:
    """Edges (3,) [m] of the box of MuJoCo's fluid: that of the same mass and inertia."""
    I = np.linalg.eigvalsh(world.object.inertia[0])
    m = float(world.object.mass[0])
    edges: Array = np.sqrt(np.maximum(I.sum() - 2 * I, 1e-15) * 6 / m)
    return edges


def _write_linear_drag(edit: Edit, before: World, after: World) -> None:
    d = float(_box(after).mean())
    note = f"MuJoCo's viscosity also resists spin, here by {after.forces.linear * d * d / 3:.2g} N m s"
    viscosity = after.forces.linear / (3 * np.pi * d)
    edit.set(edit.spec.option, "viscosity", viscosity, "option", exact=False, note=note)
    if (after.forces.wind_x, after.forces.wind_y) != (0.0, 0.0):
        edit.set(edit.spec.option, "wind", [after.forces.wind_x, after.forces.wind_y, 0.0], "option")


def _write_quadratic_drag(edit: Edit, before: World, after: World) -> None:
    a, b, c = _box(after)
    area = (a * b + b * c + c * a) / 3
    note = "MuJoCo's drag is of a box: as strong on average over directions; it also resists spin"
    density = after.forces.quadratic / (0.75 * 0.5 * area)
    edit.set(edit.spec.option, "density", density, "option", exact=False, note=note)


LINEAR_DRAG = Effect(
    name="linear_drag",
    family="fluid",
    says="a resistance in proportion to speed",
    parameters=(Parameter("c_nspm", 0.0, 0.0, 2.0, 5e-3),),
    apply=sets_forces(linear="c_nspm"),
    mujoco=InMujoco(),
    mjcf=MjcfEdit(_write_linear_drag, of_links=SHARED_AMONG_LINKS),
    strength=Strength(5e-3, 0.6, plain("c_nspm")),
    powered=(PoweredForce.DRAG, "speed"),
)

QUADRATIC_DRAG = Effect(
    name="quadratic_drag",
    family="fluid",
    says="a resistance in proportion to speed squared, as air's",
    parameters=(Parameter("c_ns2pm2", 0.0, 0.0, 2.0, 5e-3),),
    apply=sets_forces(quadratic="c_ns2pm2"),
    mujoco=InMujoco(),
    mjcf=MjcfEdit(_write_quadratic_drag, of_links=SHARED_AMONG_LINKS),
    strength=Strength(5e-3, 0.6, plain("c_ns2pm2")),
    powered=(PoweredForce.DRAG, "speed"),
)

SPIN_DRAG = Effect(
    name="spin_drag",
    family="fluid",
    says="a torque against spin",
    parameters=(Parameter("c_nms", 0.0, 0.0, 0.02, 2e-5),),
    apply=sets_forces(spin="c_nms"),
    mujoco=InMujoco(),
    mjcf=NotExpressible("MuJoCo's fluid resists spin only together with velocity"),
    strength=Strength(3e-5, 6e-3, plain("c_nms")),
    powered=(PoweredForce.SPIN, "spin"),
)

WIND = Effect(
    name="wind",
    family="fluid",
    says="moving air",
    parameters=(
        *(Parameter(f"{a}_ms", 0.0, -10.0, 10.0, 0.2) for a in "xy"),
        Parameter("c_nspm", None, 1e-3, 1.0, 5e-3, form=True),
    ),
    apply=sets_forces(wind_x="x_ms", wind_y="y_ms", linear="c_nspm"),
    read=lambda world: {"c_nspm": world.forces.linear or LEAST_DRAG},
    mujoco=InMujoco(),
    mjcf=MjcfEdit(_write_linear_drag, of_links=SHARED_AMONG_LINKS),
    strength=Strength(5e-3, 0.4, _wind_of_size),
    contains=("linear_drag",),
    near_nothing=True,  # without drag, wind does nothing
    powered=(PoweredForce.DRAG, "speed in the wind"),
    # a drag against moving air is one against still air, and a constant force
    made_of=frozenset({"linear_drag", "uniform_force"}),
)

MAGNUS = Effect(
    name="magnus",
    family="fluid",
    says="a sideways force of a spinning body in air",
    parameters=(Parameter("c_ns2pm", 0.0, -0.1, 0.1, 1e-3),),
    apply=sets_forces(magnus="c_ns2pm"),
    mujoco=InMujoco(),
    mjcf=NotExpressible("MuJoCo has it for ellipsoids only"),
    strength=Strength(1e-3, 0.08, signed("c_ns2pm")),
    powered=(PoweredForce.MAGNUS, "spin"),
)

EFFECTS = (LINEAR_DRAG, QUADRATIC_DRAG, SPIN_DRAG, WIND, MAGNUS)
"""The family, in the order in which its effects are fitted and drawn."""
