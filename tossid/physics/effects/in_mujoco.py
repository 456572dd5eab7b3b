"""Worlds in MuJoCo: which effects it can express, and their simulation.

Body, gravity, ground and friction are MuJoCo's own, contact that bounces or yields is as `mujoco_contact` has it, and
otherwise as rigid as `mujoco_engine` has it. Whatever else an effect needs, its declaration states (`Effect.mujoco`).
Forces of the state, registered ones among them, are applied from outside, each held for at most `PUSH_STEP`.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.objects import ObjectModel, to_mjcf
from tossid.physics.batch import tree_batch
from tossid.physics.effects.effect import InMujoco, NotExpressible
from tossid.physics.effects.mujoco_contact import bouncing_solref, soft_contact
from tossid.physics.effects.registry import all_effects
from tossid.physics.effects.world import World
from tossid.physics.mujoco_engine import RIGID_DAMPING, RIGID_SOLIMP, RIGID_STEP, compile_scene, run_scene
from tossid.physics.registered_forces import combined, wrenches_of
from tossid.physics.system import make_system

Array = NDArray[np.float64]

DEFAULT_STEP, DEFAULT_SOLREF, DEFAULT_SOLIMP = 1e-3, (0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's contact as it is by default, and a time step [s] for it (half of its default one)."""
PUSH_STEP = 2e-4
"""Longest time [s] for which a force of the state is held."""


def inexpressible(world: World) -> tuple[str, ...]:
    """Names of the effects in a world that MuJoCo cannot express.

    Args:
        world: The world.
    """
    found = []
    for effect in all_effects():
        lack = effect.mujoco
        if isinstance(lack, NotExpressible) and lack.present is not None and lack.present(world):
            found.append(effect.name)
    return (*found, "residual") if world.k_res is not None else tuple(found)


def toss_in_mujoco(
    world: World,
    q0: Array,
    v0: Array,
    n_steps: int,
    dt: float,
    *,
    substeps: int | None = None,
    soft: bool = False,
    n_threads: int = 1,
) -> tuple[Array, Array]:
    """Toss a world's object in MuJoCo, from B true states in the ground's frame.

    Args:
        world: the simulator; how motion is recorded does not enter.
        q0: (B, nq) initial configurations.
        v0: (B, nv) initial velocities.
        n_steps: frames after the first.
        dt: between frames, true time [s].
        substeps: MuJoCo steps a frame; None for as many as keep contact near rigid, or for steps of a millisecond.
        soft: whether contact is MuJoCo's default.
        n_threads: tosses are split over this many threads.

    Returns:
        q (B, n_steps + 1, nq) and v (B, n_steps + 1, nv), true, in the ground's frame.

    Raises:
        InputError: an effect that MuJoCo cannot express, or a count or a time that is not positive.
        MotionError, DivergedError: as `run_scene`.
    """
    missing = inexpressible(world)
    if missing:
        raise InputError(f"MuJoCo cannot express {', '.join(missing)}")
    if n_steps < 1 or not dt > 0 or (substeps is not None and substeps < 1):
        raise InputError(f"{n_steps} steps of {dt} s in {substeps} substeps; expected positive numbers")
    bouncy, forced = world.object.restitution > 0, world.has_forces
    if soft and (bouncy or world.object.compliance > 0):
        raise InputError("MuJoCo's default contact neither bounces nor yields by stated numbers")
    if substeps is None:
        step = DEFAULT_STEP if soft else RIGID_STEP
        substeps = math.ceil(dt / (0.5 * step if bouncy else step))
    hold = 1
    if forced:
        pushes = min(substeps, math.ceil(dt / PUSH_STEP))
        hold = math.ceil(substeps / pushes)
        substeps = hold * pushes
    return run_scene(
        scene(world, dt / substeps, soft=soft),
        world.object,
        q0,
        v0,
        n_steps,
        substeps,
        push=pusher(world, hold * dt / substeps) if forced else None,
        hold=hold,
        n_threads=n_threads,
    )


def scene(world: World, step: float, *, soft: bool = False) -> mujoco.MjModel:
    """The world in its ground's frame, without its forces, as MuJoCo's compiled model.

    Args:
        world: the simulator.
        step: MuJoCo's time step [s].
        soft: whether contact is MuJoCo's default.
    """
    model, gravity = world.object, world.gravity_on_ground()
    if model.compliance > 0:
        compiled = _compliant(world, step).compile()
        compiled.opt.timestep, compiled.opt.gravity[:] = step, gravity
    else:
        solref, solimp = (DEFAULT_SOLREF, DEFAULT_SOLIMP) if soft else (_solref(world, step), RIGID_SOLIMP)
        compiled = compile_scene(model, gravity, step, solref, solimp)
    for form in _forms():
        if form.scene is not None:
            form.scene(compiled, world)
    return compiled


def scene_text(model: ObjectModel, *, gravity: float, step: float) -> str:
    """The object over level ground as MJCF text, with its contact as `scene` has it; numbers have six digits.

    Args:
        model: the object.
        gravity: downward [m/s²].
        step: MuJoCo's time step [s].
    """
    world = World(model, gravity=gravity)
    if model.compliance > 0:
        text: str = _compliant(world, step).to_xml()
        return text
    return to_mjcf(model, gravity=gravity, timestep=step, solref=_solref(world, step), solimp=RIGID_SOLIMP)


def _solref(world: World, step: float) -> tuple[float, float]:
    """Of contact that does not give way: near rigid, or bouncing."""
    if not world.object.restitution > 0:
        return 2 * step, RIGID_DAMPING
    return bouncing_solref(world.object.restitution, step)


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


def pusher(world: World, hold: float) -> Callable[[Array, Array], Array]:
    """The forces of a world as a function of the state.

    Forces are shared out among the bodies by mass, as in `pulls`.

    Args:
        world: the simulator.
        hold: for how long a wrench is held [s]. It is that of half this time later, as if nothing touched and no joint
            held.

    Returns:
        A function from states q (B, nq), v (B, nv) to wrenches on MuJoCo's bodies (B, 1 + n_b, 6) [N, N m], the
        ground's first.
    """
    model, gravity = world.object, world.gravity_on_ground()
    wrench, total = wrench_of_world(world), float(model.mass.sum())

    def push(q: Array, v: Array) -> Array:
        out = np.zeros((len(q), 1 + model.n_bodies, 6))
        p, u, omega = body_motions(model, q, v)
        for b in range(model.n_bodies):
            force, _ = wrench(p[:, b], u[:, b], omega[:, b])
            middle_p, middle_u = p[:, b] + 0.5 * hold * u[:, b], u[:, b] + 0.5 * hold * (gravity + force / total)
            force, torque = wrench(middle_p, middle_u, omega[:, b])
            out[:, 1 + b, :3], out[:, 1 + b, 3:] = model.mass[b] / total * force, model.mass[b] / total * torque
        return out

    return push


def wrench_of_world(world: World) -> Callable[[Array, Array, Array], tuple[Array, Array]]:
    """The forces of a world's state on a single body of the object's whole mass, gravity not among them.

    Args:
        world: the simulator.

    Returns:
        A function from the place and velocity of the body's centre of mass and its spin, (B, 3) each, to the force [N]
        there and the torque [N m], (B, 3) each; all in the ground's axes.
    """
    on_ground = world.with_changes(forces=world.forces_on_ground())
    wrenches = [form.wrench for form in _forms() if form.wrench is not None]
    registered = combined(world.registered)

    def wrench(p: Array, u: Array, omega: Array) -> tuple[Array, Array]:
        force, torque = wrenches_of(registered, p, u, omega) if world.registered else np.zeros((2, *p.shape))
        for one in wrenches:
            more, turning = one(on_ground, p, u, omega)
            force, torque = force + more, torque + turning
        return force, torque

    return wrench


def body_motions(model: ObjectModel, q: Array, v: Array) -> tuple[Array, Array, Array]:
    """Motion of the bodies, in world axes.

    Args:
        model: the object.
        q: (B, nq) configurations.
        v: (B, nv) velocities.

    Returns:
        Positions [m] and velocities [m/s] of the bodies' centres of mass, and spins [rad/s], (B, n_b, 3) each.
    """
    turned = tree_batch(make_system(model), q, v)
    spin = np.einsum("nbij,nbj->nbi", turned.R, turned.omega)
    arm = np.einsum("nbij,bj->nbi", turned.R, model.com)
    origin = np.einsum("nbij,nbjk,nk->nbi", turned.R, turned.X[:, :, 3:], v)
    return turned.x + arm, origin + np.cross(spin, arm), spin


def _forms() -> list[InMujoco]:
    """How MuJoCo simulates effects, of all that it can."""
    return [effect.mujoco for effect in all_effects() if isinstance(effect.mujoco, InMujoco)]
