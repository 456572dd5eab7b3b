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
from tossid.physics.effects.effect import InMujoco, NotExpressible
from tossid.physics.effects.mujoco_contact import bouncing_solref, soft_contact
from tossid.physics.effects.registry import all_effects
from tossid.physics.effects.world import World
from tossid.physics.effects.wrenches import body_motions, wrench_of_world
from tossid.physics.mujoco_engine import RIGID_DAMPING, RIGID_SOLIMP, RIGID_STEP, run_scene

Array = NDArray[np.float64]

DEFAULT_STEP, DEFAULT_SOLREF, DEFAULT_SOLIMP = 1e-3, (0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's contact as it is by default, and a time step [s] for it (half of its default one)."""
PUSH_STEP = 2e-4
"""Longest time [s] for which a force of the state is held."""


def inexpressible(world: World) -> tuple[str, ...]:
    """Names of the effects in a world that MuJoCo cannot express."""
    lacking = [(effect.name, effect.mujoco) for effect in all_effects()]
    found = [
        name for name, form in lacking if isinstance(form, NotExpressible) and form.present and form.present(world)
    ]
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
    bouncy = world.object.restitution > 0
    if soft and (bouncy or world.object.compliance > 0):
        raise InputError("MuJoCo's default contact neither bounces nor yields by stated numbers")
    if substeps is None:
        step = DEFAULT_STEP if soft else RIGID_STEP
        substeps = math.ceil(dt / (0.5 * step if bouncy else step))
    hold, push = 1, None
    if world.has_forces:
        pushes = min(substeps, math.ceil(dt / PUSH_STEP))
        hold = math.ceil(substeps / pushes)
        substeps = hold * pushes
        push = pusher(world, hold * dt / substeps)
    compiled = scene(world, dt / substeps, soft=soft)
    return run_scene(compiled, world.object, q0, v0, n_steps, substeps, push=push, hold=hold, n_threads=n_threads)


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
    else:
        solref, solimp = (DEFAULT_SOLREF, DEFAULT_SOLIMP) if soft else (_solref(world, step), RIGID_SOLIMP)
        compiled = mujoco.MjModel.from_xml_string(to_mjcf(model, timestep=step, solref=solref, solimp=solimp))
    compiled.opt.timestep, compiled.opt.gravity[:] = step, gravity  # which MJCF text rounds; frames fall on their times
    size = mujoco.mj_stateSize(compiled, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    if size != 1 + model.nq + model.nv:
        raise InputError(f"MuJoCo's state of '{model.name}' has {size} numbers, expected {1 + model.nq + model.nv}")
    for effect in all_effects():
        if isinstance(effect.mujoco, InMujoco) and effect.mujoco.scene is not None:
            effect.mujoco.scene(compiled, world)
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
        return str(_compliant(world, step).to_xml())
    return to_mjcf(model, gravity=gravity, timestep=step, solref=_solref(world, step), solimp=RIGID_SOLIMP)


def _solref(world: World, step: float) -> tuple[float, float]:
    """Of contact that does not give way: near rigid, or bouncing."""
    restitution = world.object.restitution
    return bouncing_solref(restitution, step) if restitution > 0 else (2 * step, RIGID_DAMPING)


def _compliant(world: World, step: float) -> mujoco.MjSpec:
    """The scene with a contact pair for each body, in place of contacts of all with all."""
    model, mu = world.object, world.object.friction
    spec = mujoco.MjSpec.from_string(to_mjcf(model, gravity=world.gravity, timestep=step))
    for body in np.unique(model.corner_body):
        pair = spec.add_pair(name=f"contact_{body}", geomname1="ground", geomname2=f"hull_{body}")
        pair.condim, pair.friction = 3, [mu, mu, 0.0, 0.0, 0.0]
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
            out[:, 1 + b] = model.mass[b] / total * np.concatenate(wrench(middle_p, middle_u, omega[:, b]), axis=1)
        return out

    return push
