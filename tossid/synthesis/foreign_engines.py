"""Engines that tossid did not write, beside MuJoCo: Drake and Bullet (`pip install 'tossid[engines]'`).

What a world has and an engine has too is the engine's own: gravity, mass, inertia, friction. Forces of the state are
applied from outside, each held for a step: Bullet's own damping is neither linear nor quadratic drag. Contact is as
these engines have it, which is what an audit wants of them: Drake's is regularised, with spheres at the corners;
Bullet's is a box on a plane, by sequential impulses.
"""

from __future__ import annotations

import importlib
import importlib.util
from abc import ABC, abstractmethod
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

MODULES = {"drake": "pydrake", "bullet": "pybullet"}
"""What is imported for each engine."""
FAR_ABOVE = [0.0, 0.0, 1e3]
"""[m], where nothing touches the ground."""


def check_installed(name: str, key: str) -> None:
    """See that an engine's package is there; others than these two need nothing.

    Args:
        name: Of the engine.
        key: The setting that asks for it.

    Raises:
        ConfigError: It is not.
    """
    if name in MODULES and importlib.util.find_spec(MODULES[name]) is None:
        raise ConfigError(key, f"{name} is not installed here; pip install 'tossid[engines]' gets it.")


def lacks_in_bullet(world: World) -> tuple[str, ...]:
    """Names of what a world has and Bullet has not.

    Its restitution is none of Newton's: contact that it foresees brakes a body first, and a cube that falls flat at
    1.7 m/s with a coefficient of 0.5 rises with 0.24 of its speed. Its rolling and spinning friction are as unlike.
    """
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
    return tuple(name for name, has in present.items() if has)


def lacks_in_drake(world: World) -> tuple[str, ...]:
    """Names of what a world has and Drake has not: what Bullet has not, but for rounded corners, which are spheres."""
    return tuple(name for name in lacks_in_bullet(world) if name != "rounded_corners")


def box_of(model: ObjectModel) -> tuple[Array, Array]:
    """Middle and half sides (3,) of an object that is a box along its axes.

    Raises:
        InputError: It is none.
    """
    low, high = model.corner_pos.min(axis=0), model.corner_pos.max(axis=0)
    at_ends = np.isclose(model.corner_pos, low) | np.isclose(model.corner_pos, high)
    if len(model.corner_pos) != 8 or not at_ends.all() or len(np.unique(model.corner_pos.round(9), axis=0)) != 8:
        raise InputError(f"object '{model.name}' is no box along its axes, as engines drake and bullet need")
    return 0.5 * (low + high), 0.5 * (high - low)


class Scene(ABC):
    """A world's box above the ground in an engine, which tosses it many times; `close` ends it.

    Args:
        engine: Settings of the engine.
        world: The simulator; how motion is recorded does not enter.
    """

    def __init__(self, engine: Any, world: World) -> None:
        self.engine, self.world = engine, world

    def toss(self, q0: Array, v0: Array, *, n_steps: int, dt: float) -> tuple[Array, Array]:
        """q (B, n_steps + 1, 7) and v (B, n_steps + 1, 6), true, in the ground's frame.

        Args:
            q0: (B, 7) first poses.
            v0: (B, 6) first velocities.
            n_steps: Frames after the first.
            dt: Between frames, true time [s].
        """
        substeps = self.engine.substeps
        push = pusher(self.world, dt / substeps) if self.world.has_forces else None
        self._set_step(dt / substeps)
        states = np.empty((len(q0), n_steps + 1, 13))
        states[:, 0] = self._from_true(q0, v0)
        for row in states:
            self._put(row[0])
            for frame in range(1, n_steps + 1):
                if push is None:
                    self._advance(substeps)
                else:
                    for _ in range(substeps):
                        q, v = self._to_true(self._state())
                        wrench = push(q[None], v[None])[0, 1]
                        self._apply(wrench[:3], wrench[3:])
                        self._advance(1)
                row[frame] = self._state()
        q, v = self._to_true(states)
        q[:, 0], v[:, 0] = q0, v0
        return q, v

    def close(self) -> None:  # noqa: B027 (not abstract: Drake holds nothing)
        """Free what the engine holds."""

    @abstractmethod
    def _set_step(self, step: float) -> None:
        """Take time steps so long [s]."""

    @abstractmethod
    def _from_true(self, q: Array, v: Array) -> Array:
        """The engine's states (..., 13) of poses (..., 7) and velocities (..., 6)."""

    @abstractmethod
    def _to_true(self, state: Array) -> tuple[Array, Array]:
        """Its inverse."""

    @abstractmethod
    def _put(self, state: Array) -> None:
        """Begin a motion at a state (13,)."""

    @abstractmethod
    def _state(self) -> Array:
        """The present state (13,)."""

    @abstractmethod
    def _apply(self, force: Array, torque: Array) -> None:
        """Push at the centre of mass in the next step, by a force [N] and a torque [N m] along the world's axes."""

    @abstractmethod
    def _advance(self, count: int) -> None:
        """Take so many time steps."""


class DrakeScene(Scene):
    """Drake's: a plant is made for a length of time steps, and kept for the same.

    Its states are quaternion, place, spin in the world and velocity.
    """

    def __init__(self, engine: DrakeEngine, world: World) -> None:
        super().__init__(engine, world)
        self._drake: Any = importlib.import_module("pydrake.all")
        self._step, self._done = 0.0, 0
        self._plant: Any = None
        self._box: Any = None
        self._simulator: Any = None

    def _set_step(self, step: float) -> None:
        if step == self._step:
            return
        drake, model = self._drake, self.world.object
        builder = drake.DiagramBuilder()
        plant, _ = drake.AddMultibodyPlantSceneGraph(builder, time_step=step)
        I = model.inertia[0]
        rotational = drake.RotationalInertia(I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2])
        about_origin = drake.SpatialInertia.MakeFromCentralInertia(float(model.mass[0]), model.com[0], rotational)
        box = plant.AddRigidBody("box", about_origin)
        friction = drake.CoulombFriction(model.friction, model.friction)
        radius = max(self.engine.radius, self.world.law.rounding)
        middle, half = box_of(model)
        for i, corner in enumerate(model.corner_pos):
            inner = drake.RigidTransform(middle + np.sign(corner - middle) * (half - radius))
            plant.RegisterCollisionGeometry(box, inner, drake.Sphere(radius), f"corner {i}", friction)
        ground = plant.world_body()
        plant.RegisterCollisionGeometry(ground, drake.RigidTransform(), drake.HalfSpace(), "ground", friction)
        plant.mutable_gravity_field().set_gravity_vector(self.world.gravity_on_ground())
        approximation = f"k{self.engine.approximation.capitalize()}"
        plant.set_discrete_contact_approximation(getattr(drake.DiscreteContactApproximation, approximation))
        plant.Finalize()
        self._step, self._plant, self._box, self._simulator = step, plant, box, drake.Simulator(builder.Build())

    @property
    def _context(self) -> Any:
        return self._plant.GetMyMutableContextFromRoot(self._simulator.get_mutable_context())

    def _from_true(self, q: Array, v: Array) -> Array:
        return np.concatenate([q[..., 3:], q[..., :3], quat_rotate(q[..., 3:], v[..., 3:]), v[..., :3]], axis=-1)

    def _to_true(self, state: Array) -> tuple[Array, Array]:
        turn, place, spin, velocity = np.split(state, [4, 7, 10], axis=-1)
        turn = quat_normalize(turn)  # Drake leaves them more than 0.1 % too long after half a second in coarse steps
        return np.concatenate([place, turn], -1), np.concatenate([velocity, quat_rotate(quat_conj(turn), spin)], -1)

    def _put(self, state: Array) -> None:
        self._done = 0
        self._simulator.get_mutable_context().SetTime(0.0)
        self._plant.SetPositionsAndVelocities(self._context, state)
        self._simulator.Initialize()

    def _state(self) -> Array:
        return np.asarray(self._plant.GetPositionsAndVelocities(self._context))

    def _apply(self, force: Array, torque: Array) -> None:
        applied = self._drake.ExternallyAppliedSpatialForce()
        applied.body_index, applied.p_BoBq_B = self._box.index(), self.world.object.com[0]
        applied.F_Bq_W = self._drake.SpatialForce(torque, force)
        self._plant.get_applied_spatial_force_input_port().FixValue(self._context, [applied])

    def _advance(self, count: int) -> None:
        self._done += count
        self._simulator.AdvanceTo(self._done * self._step)


class BulletScene(Scene):
    """Bullet's, in a server of its own. To make one takes 6 ms, a toss's frame 0.03 ms.

    Its states are place of the centre of mass, quaternion xyzw, velocity there and spin, all in the world.

    Raises:
        InputError: The object is no box along its axes, or has products of inertia.
    """

    def __init__(self, engine: BulletEngine, world: World) -> None:
        super().__init__(engine, world)
        model = world.object
        moments = np.diag(model.inertia[0])
        if np.abs(model.inertia[0] - np.diag(moments)).max() > 1e-9 * moments.max():
            raise InputError(f"object '{model.name}': Bullet gets moments of inertia, not products of it")
        middle, half = box_of(model)
        self._bullet: Any = importlib.import_module("pybullet")
        bullet, self._client = self._bullet, {"physicsClientId": self._bullet.connect(self._bullet.DIRECT)}
        bullet.setGravity(*world.gravity_on_ground(), **self._client)
        place = {"halfExtents": half.tolist(), "collisionFramePosition": middle.tolist()}
        shape = bullet.createCollisionShape(bullet.GEOM_BOX, **place, **self._client)
        plane = bullet.createCollisionShape(bullet.GEOM_PLANE, **self._client)
        ground = bullet.createMultiBody(0.0, plane, **self._client)
        com = {"baseInertialFramePosition": model.com[0].tolist()}
        self._box = bullet.createMultiBody(float(model.mass[0]), shape, **com, **self._client)
        # coefficients of both bodies are multiplied
        bullet.changeDynamics(ground, -1, lateralFriction=1.0, restitution=0.0, **self._client)
        own = {"lateralFriction": model.friction, "restitution": 0.0, "linearDamping": 0.0, "angularDamping": 0.0}
        bullet.changeDynamics(self._box, -1, localInertiaDiagonal=moments.tolist(), **own, **self._client)

    def close(self) -> None:
        """End the server."""
        self._bullet.disconnect(**self._client)

    def _set_step(self, step: float) -> None:
        self._bullet.setTimeStep(step, **self._client)

    def _from_true(self, q: Array, v: Array) -> Array:
        arm, spin = quat_rotate(q[..., 3:7], self.world.object.com[0]), quat_rotate(q[..., 3:7], v[..., 3:])
        velocity = v[..., :3] + np.cross(spin, arm)
        return np.concatenate([q[..., :3] + arm, np.roll(q[..., 3:7], -1, axis=-1), velocity, spin], axis=-1)

    def _to_true(self, state: Array) -> tuple[Array, Array]:
        place, turn, velocity, spin = np.split(state, [3, 7, 10], axis=-1)
        turn = np.roll(turn, 1, axis=-1)
        arm = quat_rotate(turn, self.world.object.com[0])
        linear = velocity - np.cross(spin, arm)
        return np.concatenate([place - arm, turn], -1), np.concatenate([linear, quat_rotate(quat_conj(turn), spin)], -1)

    def _put(self, state: Array) -> None:
        # from far above, so that no points of contact are left that Bullet keeps from the motion before
        bullet, numbers = self._bullet, state.tolist()
        bullet.resetBasePositionAndOrientation(self._box, FAR_ABOVE, numbers[3:7], **self._client)
        bullet.performCollisionDetection(**self._client)
        bullet.resetBasePositionAndOrientation(self._box, numbers[:3], numbers[3:7], **self._client)
        bullet.resetBaseVelocity(self._box, numbers[7:10], numbers[10:], **self._client)

    def _state(self) -> Array:
        pose = self._bullet.getBasePositionAndOrientation(self._box, **self._client)
        return np.concatenate([*pose, *self._bullet.getBaseVelocity(self._box, **self._client)])

    def _apply(self, force: Array, torque: Array) -> None:
        bullet, frame = self._bullet, self._bullet.WORLD_FRAME
        bullet.applyExternalForce(self._box, -1, force, self._state()[:3], frame, **self._client)
        bullet.applyExternalTorque(self._box, -1, torque, frame, **self._client)

    def _advance(self, count: int) -> None:
        for _ in range(count):
            self._bullet.stepSimulation(**self._client)


SCENES: dict[str, type[Scene]] = {"drake": DrakeScene, "bullet": BulletScene}
"""What tosses one world's box many times: of settings of the engine and a world, by the engine's name."""


def toss_in(
    engine: DrakeEngine | BulletEngine, world: World, q0: Array, v0: Array, **steps: Any
) -> tuple[Array, Array]:
    """Toss a world's box in Drake or Bullet once; other arguments and the result are those of `Scene.toss`.

    Raises:
        ConfigError: The engine is not installed.
        InputError: The object is not one that the engine can take.
    """
    check_installed(engine.name, "engine")
    scene = SCENES[engine.name](engine, world)
    try:
        return scene.toss(q0, v0, **steps)
    finally:
        scene.close()
