"""Worlds in MuJoCo: which effects it can express, and how.

Forces of the state are applied from outside, each held for at most `PUSH_STEP`. Contact is as
rigid as `mujoco_engine` has it, unless the world says otherwise:

restitution e: solref (-w², -2 z w), a spring and a damper in acceleration's units. Of their oscillation the contact
    keeps what is no pull, which makes e a function of z (Schwager and Poeschel, "Coefficient of restitution and linear
    dashpot model revisited", Granular Matter 2007). w is a share of the time step's rate: the softer, the deeper.
compliance k [N/m] and damping d [N s/m] of a corner: MuJoCo's force is (a_ref - a) / R with a_ref = -B v - K D r,
    so that (K, B) = R (k / D, d) makes it k r + d v, but for an added mass 1 / R at the corner. The impedance D
    keeps that to 0.2 % of the object's mass. Friction has a reference of its own, which knows no compliance. The law's
    added mass is just that 1 / R, and its damping acts on friction too.
torsional friction and rolling resistance: MuJoCo's own, of 4 or 6 dimensions of contact. There they share one cone
    with friction, so that a sliding contact resists turning less than a resting one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from tossid.errors import InputError
from tossid.objects import ObjectModel, to_mjcf
from tossid.physics.batch import tree_batch
from tossid.physics.effects.world import World
from tossid.physics.forces import DRAG, LEAST, MAGNUS, SPIN, SPRING, TURNING, VORTEX, Forces
from tossid.physics.mujoco_engine import RIGID_DAMPING, RIGID_SOLIMP, RIGID_STEP, compile_scene, run_scene
from tossid.physics.system import make_system

Array = NDArray[np.float64]

PUSH_STEP = 2e-4
"""Longest time [s] for which a force of the state is held."""
SOFT_IMPEDANCE = 0.002
"""Impedance of a compliant contact: its added mass, over the object's."""
BOUNCE_RATE = 0.125
"""A bouncing contact's frequency w times the time step."""


def inexpressible(world: World) -> tuple[str, ...]:
    """The effects in a world that MuJoCo cannot express, by name."""
    law = world.law
    found = {
        "velocity_friction": law.static_rel != 1.0,
        "anisotropic_friction": law.y_rel != 1.0,
        "adhesion": law.adhesion != 0.0,
        "cohesion": world.object.cohesion != 0.0,
        "rounded_corners": law.rounding != 0.0,
        "residual": world.residual is not None,
    }
    return tuple(name for name, there in found.items() if there)


def toss_in_mujoco(
    world: World,
    q0: Array,
    v0: Array,
    n_steps: int,
    dt: float,
    *,
    substeps: int | None = None,
    n_threads: int = 1,
) -> tuple[Array, Array]:
    """Toss a world's object in MuJoCo, from B true states in the ground's frame.

    Args:
        q0: (B, nq). v0: (B, nv).
        n_steps: frames after the first. dt: between frames, true time [s].
        substeps: MuJoCo steps a frame; None for as many as keep contact near rigid.

    Returns:
        q (B, n_steps + 1, nq) and v (B, n_steps + 1, nv), true, in the ground's frame.

    Raises:
        InputError: an effect that MuJoCo cannot express.
        MotionError, DivergedError: as `simulate_mujoco`.
    """
    missing = inexpressible(world)
    if missing:
        raise InputError(f"MuJoCo cannot express {', '.join(missing)}")
    if n_steps < 1 or not dt > 0 or (substeps is not None and substeps < 1):
        raise InputError(f"{n_steps} steps of {dt} s in {substeps} substeps; expected positive numbers")
    bouncy, forced = world.object.restitution > 0, world.forces.acts
    if substeps is None:
        substeps = math.ceil(dt / (0.5 * RIGID_STEP if bouncy else RIGID_STEP))
    hold = 1
    if forced:
        pushes = min(substeps, math.ceil(dt / PUSH_STEP))
        hold = math.ceil(substeps / pushes)
        substeps = hold * pushes
    return run_scene(
        scene(world, dt / substeps),
        world.object,
        q0,
        v0,
        n_steps,
        substeps,
        push=pusher(world, hold * dt / substeps) if forced else None,
        hold=hold,
        n_threads=n_threads,
    )


def scene(world: World, step: float) -> mujoco.MjModel:
    """The world's ground frame, but for its forces, in MuJoCo at time steps of `step` [s]."""
    model, law, gravity = world.object, world.law, world.gravity_on_ground()
    if model.compliance > 0:
        compiled = _compliant(world, step).compile()
        compiled.opt.timestep, compiled.opt.gravity[:] = step, gravity
    else:
        compiled = compile_scene(model, gravity, step, _solref(world, step), RIGID_SOLIMP)
    if law.torsional > 0 or law.rolling > 0:
        dimensions = 6 if law.rolling > 0 else 4
        compiled.geom_condim[:], compiled.pair_dim[:] = dimensions, dimensions
        compiled.geom_friction[:, 1:] = law.torsional, law.rolling
        compiled.pair_friction[:, 2], compiled.pair_friction[:, 3:] = law.torsional, law.rolling
    return compiled


def scene_text(model: ObjectModel, *, gravity: float, step: float) -> str:
    """The object over level ground as MJCF text, with its contact as `scene` has it; numbers have six digits."""
    world = World(model, gravity=gravity)
    if model.compliance > 0:
        text: str = _compliant(world, step).to_xml()
        return text
    return to_mjcf(model, gravity=gravity, timestep=step, solref=_solref(world, step), solimp=RIGID_SOLIMP)


def _solref(world: World, step: float) -> tuple[float, float]:
    """Of contact that does not give way: near rigid, or bouncing."""
    if not world.object.restitution > 0:
        return 2 * step, RIGID_DAMPING
    ratio = damping_ratio(world.object.restitution)
    rate = min(BOUNCE_RATE, 0.5 / ratio) / step
    return -(rate**2), -2 * ratio * rate


def damping_ratio(restitution: float) -> float:
    """Damping ratio z of a contact that bounces with `restitution` e, 0 < e <= 1, and does not pull."""

    def excess(z: float) -> float:
        w = math.sqrt(abs(1 - z * z))
        angle = math.pi - math.atan2(2 * z * w, 1 - 2 * z * z) if z < 1 else 2 * math.log(z + w)
        return (math.exp(-z / w * angle) if w > 0 else math.exp(-2)) - restitution

    return float(brentq(excess, 1e-9, 1e4)) if excess(1e-9) > 0 else 1e-9


def _compliant(world: World, step: float) -> mujoco.MjSpec:
    model = world.object
    spec = mujoco.MjSpec.from_string(to_mjcf(model, gravity=world.gravity, timestep=step))
    for body in range(model.n_bodies):
        if (model.corner_body == body).any():
            spec.add_pair(
                name=f"contact_{body}",
                geomname1="ground",
                geomname2=f"hull_{body}",
                condim=3,
                friction=[model.friction, model.friction, 0.0, 0.0, 0.0],
            )
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = 0, 0
    compiled = spec.compile()
    for at, pair in enumerate(spec.pairs):
        inverse = compiled.body_invweight0[compiled.geom_bodyid[compiled.pair_geom2[at]], 0]
        soft = soft_contact(world, inverse)
        pair.solimp, pair.solref = soft.solimp, soft.solref
        if world.law.added_mass == 0:
            pair.solreffriction = soft.solreffriction(step)
        spec.option.impratio = max(spec.option.impratio, soft.impratio)
    return spec


class SoftContact(NamedTuple):
    """A contact that yields, in MuJoCo's numbers; friction is a hundred times as stiff as what would creep."""

    impedance: float
    solref: list[float]
    solimp: list[float]
    impratio: float

    def solreffriction(self, step: float) -> list[float]:
        """Of friction that stops in a few time steps [s], whatever the contact's damping."""
        return [-1e-9, -0.5 * self.impedance / step]


def soft_contact(world: World, inverse: float) -> SoftContact:
    """MuJoCo's contact of a world whose corners yield.

    Args:
        inverse: MuJoCo's estimate of a corner's inverse mass [1/kg], from which it makes R = (1 - D) / D of it.
    """
    o, added = world.object, world.law.added_mass * inverse
    d = max(SOFT_IMPEDANCE, float(added / (1 + added)))
    spring = (1 - d) * inverse / o.compliance
    solref = [-spring, -max(o.relaxation * spring, 1e-9)]
    return SoftContact(d, solref, [d, d, 0.001, 0.5, 2.0], max(1.0, 100 * (1 - d) / d))


def pusher(world: World, hold: float) -> Callable[[Array, Array], Array]:
    """From states q (B, nq), v (B, nv) to the wrenches on MuJoCo's bodies (B, 1 + n_b, 6), the ground's first.

    Forces are shared out among the bodies by mass, as `pulls` has it.
    hold: for how long [s] it is held; it is the wrench at half that time, as if nothing touched and no joint held.
    """
    forces, model, gravity = world.forces_on_ground(), world.object, world.gravity_on_ground()
    total = float(model.mass.sum())

    def push(q: Array, v: Array) -> Array:
        out = np.zeros((len(q), 1 + model.n_bodies, 6))
        p, u, omega = body_motions(model, q, v)
        for b in range(model.n_bodies):
            force, _ = wrench(forces, total, p[:, b], u[:, b], omega[:, b])
            middle_p, middle_u = p[:, b] + 0.5 * hold * u[:, b], u[:, b] + 0.5 * hold * (gravity + force / total)
            force, torque = wrench(forces, total, middle_p, middle_u, omega[:, b])
            out[:, 1 + b, :3], out[:, 1 + b, 3:] = model.mass[b] / total * force, model.mass[b] / total * torque
        return out

    return push


def body_motions(model: ObjectModel, q: Array, v: Array) -> tuple[Array, Array, Array]:
    """Places and velocities of the bodies' centres of mass, and spins, in the world: (B, n_b, 3) each."""
    turned = tree_batch(make_system(model), q, v)
    spin = np.einsum("nbij,nbj->nbi", turned.R, turned.omega)
    arm = np.einsum("nbij,bj->nbi", turned.R, model.com)
    origin = np.einsum("nbij,nbjk,nk->nbi", turned.R, turned.X[:, :, 3:], v)
    return turned.x + arm, origin + np.cross(spin, arm), spin


def wrench(f: Forces, mass: float, p: Array, u: Array, omega: Array) -> tuple[Array, Array]:
    """Force [N] at the centre of mass and torque [N m] on a single body, world axes, (*b, 3) each.

    p, u, omega (*b, 3): place and velocity of the centre of mass, and spin, world axes.
    """
    up, away = np.array([0.0, 0.0, 1.0]), np.array([f.center_x, f.center_y, f.center_z]) - p
    air = u - [f.wind_x, f.wind_y, 0.0]
    drag = (f.linear + f.quadratic * np.linalg.norm(air, axis=-1, keepdims=True)) * _grown(f, DRAG, air)
    force = -drag * air + f.magnus * _grown(f, MAGNUS, omega) * np.cross(omega, air) + [f.x, f.y, f.z]
    force += f.spring * _grown(f, SPRING, away) * away
    force += f.vortex * _grown(f, VORTEX, p[..., :2]) * np.cross(up, p)
    force += mass * f.turning * _grown(f, TURNING, u) * np.cross(up, u)
    return force, -f.spin * _grown(f, SPIN, omega) * omega


def _grown(f: Forces, which: int, state: Array) -> Array:
    """(*b, 1) `forces.grown` of states (*b, n)."""
    size: Array = np.maximum(np.linalg.norm(state, axis=-1, keepdims=True), LEAST)
    return size**f.power if f.powered == which else np.ones_like(size)
