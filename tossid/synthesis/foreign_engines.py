"""Engines that tossid did not write, beside MuJoCo: Drake and Bullet (`pip install 'tossid[engines]'`).

What a world has and an engine has too is the engine's own: gravity, mass, inertia, friction. Forces of the state are
applied from outside, each held for a step: Bullet's own damping is neither linear nor quadratic drag. Contact is as
these engines have it, which is what an audit wants of them: Drake's is regularised, with spheres at the corners;
Bullet's is a box on a plane, by sequential impulses.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.errors import ConfigError, InputError
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.physics.effects.in_mujoco import pusher
from tossid.rotations import quat_conj, quat_normalize, quat_rotate
from tossid.settings.synthesis import BulletEngine, DrakeEngine

Array = NDArray[np.float64]
Push = Callable[[Array, Array], tuple[Array, Array]]
"""Force [N] and torque [N m] at the centre of mass of a state q (7,), v (6,), (3,) each in the world."""

MODULES = {"drake": "pydrake", "bullet": "pybullet"}
"""What is imported for each engine."""
_FAR_ABOVE = [0.0, 0.0, 1e3]
"""[m], where nothing touches the ground."""


def check_installed(name: str, key: str) -> None:
    """See that an engine's package is there.

    Args:
        name: Of the engine; others than these two need nothing.
        key: The setting that asks for it.

    Raises:
        ConfigError: It is not.
    """
    if name in MODULES and importlib.util.find_spec(MODULES[name]) is None:
        raise ConfigError(key, f"{name} is not installed here; pip install 'tossid[engines]' gets it.")


def lacks_in_drake(world: World) -> tuple[str, ...]:
    """Names of what a world has and Drake has not.

    Args:
        world: The world.
    """
    return _lacking(world, "rounded_corners")


def lacks_in_bullet(world: World) -> tuple[str, ...]:
    """Names of what a world has and Bullet has not.

    Its restitution is none of Newton's: contact that it foresees brakes a body first, and a cube that falls flat at
    1.7 m/s with a coefficient of 0.5 rises with 0.24 of its speed. Its rolling and spinning friction are as unlike.

    Args:
        world: The world.
    """
    return _lacking(world)


def _lacking(world: World, *own: str) -> tuple[str, ...]:
    law, model = world.law, world.object
    present = {
        "velocity_friction": law.static_rel != 1.0,
        "anisotropic_friction": law.y_rel != 1.0,
        "torsional_friction": law.torsional > 0,
        "rolling_resistance": law.rolling > 0,
        "adhesion": law.adhesion > 0,
        "rounded_corners": law.rounding > 0,
        "restitution": model.restitution > 0,
        "compliance": model.compliance > 0,
        "cohesion": model.cohesion > 0,
        "joints": model.n_joints > 0,
        "residual": world.k_res is not None,
    }
    return tuple(name for name, there in present.items() if there and name not in own)


def toss_in_drake(
    engine: DrakeEngine, world: World, q0: Array, v0: Array, *, n_steps: int, dt: float
) -> tuple[Array, Array]:
    """Toss a world's box in Drake, from true states in the ground's frame.

    Args:
        engine: Its settings.
        world: The simulator; how motion is recorded does not enter.
        q0: (B, 7) first poses.
        v0: (B, 6) first velocities.
        n_steps: Frames after the first.
        dt: Between frames, true time [s].

    Returns:
        q (B, n_steps + 1, 7) and v (B, n_steps + 1, 6), true, in the ground's frame.
    """
    return DrakeScene(engine, world).toss(q0, v0, n_steps=n_steps, dt=dt)


class DrakeScene:
    """A world's box above the ground in Drake. It is made for a length of time steps, and kept for the same."""

    def __init__(self, engine: DrakeEngine, world: World) -> None:
        """Nothing is made yet.

        Args:
            engine: Its settings.
            world: The simulator; how motion is recorded does not enter.
        """
        self.engine, self.world = engine, world
        self._drake: Any = importlib.import_module("pydrake.all")
        self._step = 0.0
        self._plant: Any = None
        self._box: Any = None
        self._simulator: Any = None

    def toss(self, q0: Array, v0: Array, *, n_steps: int, dt: float) -> tuple[Array, Array]:
        """q (B, n_steps + 1, 7) and v (B, n_steps + 1, 6), true, in the ground's frame.

        Args:
            q0: (B, 7) first poses.
            v0: (B, 6) first velocities.
            n_steps: Frames after the first.
            dt: Between frames, true time [s].
        """
        drake, step, com = self._drake, dt / self.engine.substeps, self.world.object.com[0]
        if step != self._step:
            self._make(step)
        plant, simulator, push = self._plant, self._simulator, _push(self.world, step)
        root = simulator.get_mutable_context()
        context = plant.GetMyMutableContextFromRoot(root)
        first = np.concatenate([q0[:, 3:7], q0[:, :3], quat_rotate(q0[:, 3:7], v0[:, 3:]), v0[:, :3]], axis=1)
        runs = np.empty((len(q0), n_steps + 1, 13))
        runs[:, 0] = first
        for row, one in enumerate(first):
            root.SetTime(0.0)
            plant.SetPositionsAndVelocities(context, one)
            simulator.Initialize()
            for frame in range(1, n_steps + 1):
                if push is None:
                    simulator.AdvanceTo(frame * dt)
                else:
                    for part in range(1, self.engine.substeps + 1):
                        force, torque = push(*_from_drake(plant.GetPositionsAndVelocities(context)))
                        applied = drake.ExternallyAppliedSpatialForce()
                        applied.body_index, applied.p_BoBq_B = self._box.index(), com
                        applied.F_Bq_W = drake.SpatialForce(torque, force)
                        plant.get_applied_spatial_force_input_port().FixValue(context, [applied])
                        simulator.AdvanceTo((frame - 1) * dt + part * step)
                runs[row, frame] = plant.GetPositionsAndVelocities(context)
        q, v = _from_drake(runs)
        q[:, 0], v[:, 0] = q0, v0
        return q, v

    def _make(self, step: float) -> None:
        """The plant with time steps so long [s]."""
        drake, model = self._drake, self.world.object
        builder = drake.DiagramBuilder()
        plant, _ = drake.AddMultibodyPlantSceneGraph(builder, time_step=step)
        about_origin = drake.SpatialInertia.MakeFromCentralInertia(
            float(model.mass[0]), model.com[0], _rotational(drake, model.inertia[0])
        )
        box = plant.AddRigidBody("box", about_origin)
        friction = drake.CoulombFriction(model.friction, model.friction)
        radius = max(self.engine.radius, self.world.law.rounding)
        middle, half = box_of(model)
        for corner in model.corner_pos:
            inner = middle + np.sign(corner - middle) * (half - radius)
            name = f"corner {len(plant.GetCollisionGeometriesForBody(box))}"
            plant.RegisterCollisionGeometry(box, drake.RigidTransform(inner), drake.Sphere(radius), name, friction)
        ground = plant.world_body()
        plant.RegisterCollisionGeometry(ground, drake.RigidTransform(), drake.HalfSpace(), "ground", friction)
        plant.mutable_gravity_field().set_gravity_vector(self.world.gravity_on_ground())
        approximation = f"k{self.engine.approximation.capitalize()}"
        plant.set_discrete_contact_approximation(getattr(drake.DiscreteContactApproximation, approximation))
        plant.Finalize()
        self._step, self._plant, self._box, self._simulator = step, plant, box, drake.Simulator(builder.Build())


def _rotational(drake: Any, inertia: Array) -> Any:
    return drake.RotationalInertia(
        inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]
    )


def _from_drake(state: Array) -> tuple[Array, Array]:
    """q (..., 7) and v (..., 6) in our order: Drake has quaternions first, and spin in the world before velocity.

    Drake leaves quaternions as integration makes them, more than 0.1 % too long after half a second in coarse steps.
    """
    turn, place, spin, velocity = np.split(state, [4, 7, 10], axis=-1)
    turn = quat_normalize(turn)
    return np.concatenate([place, turn], -1), np.concatenate([velocity, quat_rotate(quat_conj(turn), spin)], -1)


def toss_in_bullet(
    engine: BulletEngine, world: World, q0: Array, v0: Array, *, n_steps: int, dt: float
) -> tuple[Array, Array]:
    """Toss a world's box in Bullet; arguments and result are those of `toss_in_drake`.

    Args:
        engine: Its settings.
        world: The simulator.
        q0: (B, 7) first poses.
        v0: (B, 6) first velocities.
        n_steps: Frames after the first.
        dt: Between frames, true time [s].
    """
    scene = BulletScene(engine, world)
    try:
        return scene.toss(q0, v0, n_steps=n_steps, dt=dt)
    finally:
        scene.close()


class BulletScene:
    """A world's box above the ground in a server of Bullet's own. To make one takes 6 ms, a toss's frame 0.03 ms."""

    def __init__(self, engine: BulletEngine, world: World) -> None:
        """Make the server, which is there until `close` is called.

        Args:
            engine: Its settings.
            world: The simulator; how motion is recorded does not enter.

        Raises:
            InputError: The object is no box along its axes, or has products of inertia.
        """
        self.engine, self.world = engine, world
        model = world.object
        moments = np.diag(model.inertia[0])
        if np.abs(model.inertia[0] - np.diag(moments)).max() > 1e-9 * moments.max():
            raise InputError(f"object '{model.name}': Bullet gets moments of inertia, not products of it")
        middle, half = box_of(model)
        self._bullet: Any = importlib.import_module("pybullet")
        bullet, self._client = self._bullet, {"physicsClientId": self._bullet.connect(self._bullet.DIRECT)}
        bullet.setGravity(*world.gravity_on_ground(), **self._client)
        shape = bullet.createCollisionShape(
            bullet.GEOM_BOX, halfExtents=half.tolist(), collisionFramePosition=middle.tolist(), **self._client
        )
        ground = bullet.createMultiBody(
            0.0, bullet.createCollisionShape(bullet.GEOM_PLANE, **self._client), **self._client
        )
        self._box = bullet.createMultiBody(
            float(model.mass[0]), shape, baseInertialFramePosition=model.com[0].tolist(), **self._client
        )
        # coefficients of both bodies are multiplied
        bullet.changeDynamics(ground, -1, lateralFriction=1.0, restitution=0.0, **self._client)
        bullet.changeDynamics(
            self._box,
            -1,
            lateralFriction=model.friction,
            restitution=0.0,
            localInertiaDiagonal=moments.tolist(),
            linearDamping=0.0,
            angularDamping=0.0,
            **self._client,
        )

    def toss(self, q0: Array, v0: Array, *, n_steps: int, dt: float) -> tuple[Array, Array]:
        """q (B, n_steps + 1, 7) and v (B, n_steps + 1, 6), true, in the ground's frame.

        Args:
            q0: (B, 7) first poses.
            v0: (B, 6) first velocities.
            n_steps: Frames after the first.
            dt: Between frames, true time [s].
        """
        bullet, step, com = self._bullet, dt / self.engine.substeps, self.world.object.com[0]
        push = _push(self.world, step)
        bullet.setTimeStep(step, **self._client)
        runs = np.empty((len(q0), n_steps + 1, 13))
        runs[:, 0] = _to_bullet(q0, v0, com)
        for row, one in enumerate(runs[:, 0].tolist()):
            self._put(one)
            for frame in range(1, n_steps + 1):
                for _ in range(self.engine.substeps):
                    if push is not None:
                        there = np.array(self._state())
                        force, torque = push(*_from_bullet(there, com))
                        flag = bullet.WORLD_FRAME
                        bullet.applyExternalForce(self._box, -1, force, there[:3], flag, **self._client)
                        bullet.applyExternalTorque(self._box, -1, torque, flag, **self._client)
                    bullet.stepSimulation(**self._client)
                runs[row, frame] = self._state()
        q, v = _from_bullet(runs, com)
        q[:, 0], v[:, 0] = q0, v0
        return q, v

    def close(self) -> None:
        """End the server."""
        self._bullet.disconnect(**self._client)

    def _put(self, state: list[float]) -> None:
        """Put the box where a motion begins, without the points of contact that Bullet keeps from the motion before."""
        bullet = self._bullet
        bullet.resetBasePositionAndOrientation(self._box, _FAR_ABOVE, state[3:7], **self._client)
        bullet.performCollisionDetection(**self._client)
        bullet.resetBasePositionAndOrientation(self._box, state[:3], state[3:7], **self._client)
        bullet.resetBaseVelocity(self._box, state[7:10], state[10:], **self._client)

    def _state(self) -> list[float]:
        """Place of the centre of mass, quaternion xyzw, velocity and spin, all in the world."""
        place, turn = self._bullet.getBasePositionAndOrientation(self._box, **self._client)
        velocity, spin = self._bullet.getBaseVelocity(self._box, **self._client)
        return [*place, *turn, *velocity, *spin]


SCENES: dict[str, Callable[..., Any]] = {"drake": DrakeScene, "bullet": BulletScene}
"""What tosses one world's box many times: of settings of the engine and a world, by the engine's name."""


def _to_bullet(q: Array, v: Array, com: Array) -> Array:
    """(..., 13) place of the centre of mass, quaternion xyzw, velocity there and spin, all in the world."""
    arm, spin = quat_rotate(q[..., 3:7], com), quat_rotate(q[..., 3:7], v[..., 3:])
    velocity = v[..., :3] + np.cross(spin, arm)
    return np.concatenate([q[..., :3] + arm, np.roll(q[..., 3:7], -1, axis=-1), velocity, spin], axis=-1)


def _from_bullet(state: Array, com: Array) -> tuple[Array, Array]:
    """q (..., 7) and v (..., 6) of such a state."""
    place, turn, velocity, spin = np.split(state, [3, 7, 10], axis=-1)
    turn = np.roll(turn, 1, axis=-1)
    arm = quat_rotate(turn, com)
    linear = velocity - np.cross(spin, arm)
    return np.concatenate([place - arm, turn], -1), np.concatenate([linear, quat_rotate(quat_conj(turn), spin)], -1)


def _push(world: World, step: float) -> Push | None:
    if not world.has_forces:
        return None
    batch = pusher(world, step)

    def push(q: Array, v: Array) -> tuple[Array, Array]:
        wrench = batch(q[None], v[None])[0, 1]
        return wrench[:3], wrench[3:]

    return push


def box_of(model: ObjectModel) -> tuple[Array, Array]:
    """Middle and half sides (3,) of an object that is a box along its axes.

    Args:
        model: The object.

    Raises:
        InputError: It is none.
    """
    low, high = model.corner_pos.min(axis=0), model.corner_pos.max(axis=0)
    at_ends = np.isclose(model.corner_pos, low) | np.isclose(model.corner_pos, high)
    if len(model.corner_pos) != 8 or not at_ends.all() or len(np.unique(model.corner_pos.round(9), axis=0)) != 8:
        raise InputError(f"object '{model.name}' is no box along its axes, as engines drake and bullet need")
    return 0.5 * (low + high), 0.5 * (high - low)
