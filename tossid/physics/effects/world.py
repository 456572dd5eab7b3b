"""A simulator together with the way its motion is recorded: what an effect changes.

Recorded motion and the simulator's are tied by a `RecordingErrors`: lengths, clock, the frame on the body and the
world's tilt. Ground that is tilted or not at z = 0 is handled as a change of frame too: the simulator's ground stays
z = 0, and gravity is what tilts. So there are three frames: recorded, true (z is up), and the ground's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.objects import GRAVITY, JointType, ObjectModel
from tossid.physics.contact.law import Law
from tossid.physics.effects.delay import Onward, turned_back, with_late_rotations
from tossid.physics.forces import Forces
from tossid.physics.network import LearnedAcceleration
from tossid.physics.registered_forces import RegisteredForce, combined
from tossid.physics.stepping import TOLERANCE, simulate
from tossid.physics.system import System, make_system
from tossid.rotations import quat_conj, quat_exp, quat_mul, quat_rotate

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RecordingErrors:
    """From true motion to recorded: p_recorded = length_scale R(world_tilt) (p + R(q) frame_offset).

    Attributes:
        length_scale: Recorded length per true length.
        clock_rate: Recorded time per true time.
        frame_offset: (3,) the recorded frame's origin in the body's true frame [m].
        world_tilt: (2,) what turns true coordinates into recorded ones [rad about x, y].
        joint_offset: Recorded joint positions minus true ones [rad, m]; slides are lengths too.
        rotation_delay: True time by which recorded rotations lag recorded positions [s].
    """

    length_scale: float = 1.0
    clock_rate: float = 1.0
    frame_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    world_tilt: tuple[float, float] = (0.0, 0.0)
    joint_offset: float = 0.0
    rotation_delay: float = 0.0


@dataclass(frozen=True)
class World:
    """An object, what pulls at it, what it lands on, and how that is recorded. SI units.

    Attributes:
        object: What is tossed.
        gravity: Downward [m/s²].
        forces: Of the state, in the true world; on tilted ground the wind blows along it, and the axis of vortex and
            turning is its normal.
        law: Of contact.
        ground_height: Of the ground over the true world's origin [m].
        ground_tilt: Of the ground (2,) [rad about x, y]: p = R(ground_tilt) p_ground + (0, 0, ground_height).
        recording: How recorded motion differs from true motion.
        k_res: A learned acceleration.
        registered: The user's own forces, in the ground's frame (`register_force`).
    """

    object: ObjectModel
    gravity: float = GRAVITY
    forces: Forces = field(default_factory=Forces)
    law: Law = field(default_factory=Law)
    ground_height: float = 0.0
    ground_tilt: tuple[float, float] = (0.0, 0.0)
    recording: RecordingErrors = field(default_factory=RecordingErrors)
    k_res: LearnedAcceleration | None = None
    registered: tuple[RegisteredForce, ...] = ()

    def with_force(self, force: RegisteredForce) -> World:
        """A copy with a force of a registered class, in the place of one of the same class if there is one."""
        others = tuple(other for other in self.registered if type(other) is not type(force))
        return replace(self, registered=(*others, force))

    def with_changes(self, **changes: Any) -> World:
        """A copy with fields replaced."""
        return replace(self, **changes)

    def gravity_on_ground(self) -> Array:
        """(3,) acceleration of gravity in the ground's frame [m/s²]."""
        down = np.array([0.0, 0.0, -self.gravity])
        return quat_rotate(quat_conj(_turn(self.ground_tilt)), down) if self._tilted else down

    def forces_on_ground(self) -> Forces:
        """The forces in the ground's frame."""
        if not self._tilted and self.ground_height == 0.0:
            return self.forces
        f, back = self.forces, quat_conj(_turn(self.ground_tilt))
        x, y, z = quat_rotate(back, np.array([f.x, f.y, f.z])).tolist()
        center = np.array([f.center_x, f.center_y, f.center_z - self.ground_height])
        center_x, center_y, center_z = quat_rotate(back, center).tolist()
        return f._replace(x=x, y=y, z=z, center_x=center_x, center_y=center_y, center_z=center_z)

    def system(self) -> System:
        """The simulator, in the ground's frame, the same object whenever it is asked for."""
        return self._system

    @cached_property
    def _system(self) -> System:
        system = make_system(self.object, gravity=self.gravity_on_ground(), k_res=self.k_res)
        return system._replace(
            forces=self.forces_on_ground(),
            law=self.law,
            registered=combined(self.registered),
        )

    @property
    def has_forces(self) -> bool:
        """Whether forces of the state act, beside gravity."""
        return self.forces.acts or bool(self.registered)

    def flies_like(self, other: World) -> bool:
        """Whether free motion is the same in both: they differ in contact at most, or in where contact begins."""
        if self is other:
            return True
        alike = self.gravity == other.gravity and self.forces == other.forces and self.recording == other.recording
        alike = alike and self.ground_tilt == other.ground_tilt and self.k_res is other.k_res
        alike = alike and not (self.registered or other.registered) and type(self) is type(other)
        return alike and _moves_freely_like(self.object, other.object, forced=self.has_forces)

    def lower_corners(self, stated: ObjectModel, high: Array, far: Array, spin: Array) -> Array:
        """How far below the corners of the stated object, at recorded poses, corners of this world may be [m].

        Args:
            stated: The object, with as many corners as this world's.
            high: (W,) how far from the recorded origin poses are [m], along the vertical.
            far: (W,) the same across it.
            spin: (W,) how fast the object turns [rad/s].

        Returns:
            (W,) distances.
        """
        recording, arm = self.recording, _longest(stated.corner_pos)
        moved = 0.0 if self.object is stated else _longest(self.object.corner_pos - stated.corner_pos)
        moved += math.hypot(*recording.frame_offset) + abs(recording.joint_offset) * max(1.0, 2 * arm)
        tilted = math.hypot(*recording.world_tilt) + math.hypot(*self.ground_tilt)
        longer = abs(1.0 - 1.0 / recording.length_scale)
        below: Array = moved + longer * high + tilted * far + abs(recording.rotation_delay) * spin * arm
        return below

    @property
    def by_first_states(self) -> World:
        """A world whose derivatives by first states are nearly those of this one, where others cost less."""
        return self

    @property
    def same_everywhere(self) -> bool:
        """Whether motion is the same wherever it begins along the recorded x and y.

        It is on level ground, without a force that depends on the position.
        """
        level = not self._tilted and self.recording.world_tilt == (0.0, 0.0)
        uniform = self.forces.spring == 0.0 and self.forces.vortex == 0.0 and self.k_res is None
        return level and uniform and not self.registered

    def to_ground(self, q: Array, v: Array) -> tuple[Array, Array]:
        """True states in the ground's frame, of recorded ones: q (*b, nq), v (*b, nv)."""
        if self._as_is:
            return q.copy(), v.copy()
        r = self.recording
        true, tilt = quat_conj(_turn(r.world_tilt)), quat_conj(_turn(self.ground_tilt))
        turn = quat_mul(tilt, true)
        q, v, recorded = q.copy(), v * r.clock_rate, q
        q[..., 3:7] = quat_mul(turn, recorded[..., 3:7])
        q = turned_back(q, v, -r.rotation_delay)
        arm, sweep = self._arm(q, v)
        place = quat_rotate(true, recorded[..., :3]) / r.length_scale - self._lift
        q[..., :3] = quat_rotate(tilt, place) - arm
        v[..., :3] = quat_rotate(turn, v[..., :3]) / r.length_scale - sweep
        q[..., 7:] = (q[..., 7:] - r.joint_offset) / self._joint_scale
        v[..., 6:] /= self._joint_scale
        return q, v

    def recorded_poses(self, q: Array) -> Array:
        """Recorded poses of true ones in the ground's frame, without a delay of rotations: (*b, nq)."""
        if self._as_is:
            return q.copy()
        r = self.recording
        tilt, world = _turn(self.ground_tilt), _turn(r.world_tilt)
        place = quat_rotate(tilt, q[..., :3] + quat_rotate(q[..., 3:7], np.array(r.frame_offset)))
        out = q.copy()
        out[..., :3] = quat_rotate(world, place + self._lift) * r.length_scale
        out[..., 3:7] = quat_mul(quat_mul(world, tilt), q[..., 3:7])
        out[..., 7:] = self._joint_scale * q[..., 7:] + r.joint_offset
        return out

    def recorded(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Recorded states of true ones in the ground's frame, the inverse of `to_ground`."""
        r = self.recording
        turn = quat_mul(_turn(r.world_tilt), _turn(self.ground_tilt))
        _, sweep = self._arm(q, v)
        out = v / r.clock_rate
        out[..., :3] = quat_rotate(turn, v[..., :3] + sweep) * (r.length_scale / r.clock_rate)
        out[..., 6:] *= self._joint_scale
        poses = self.recorded_poses(q)
        poses[..., 3:7] = self.recorded_poses(turned_back(q, v, r.rotation_delay))[..., 3:7]
        return poses, out

    def recorded_motions(
        self, q: Array, v: Array, *, n_steps: int | NDArray[np.int64], dt: float, onward: Onward
    ) -> Array:
        """(B, T + 1, nq) recorded poses of whole true motions in the ground's frame.

        Args:
            q: (B, T + 1, nq) configurations.
            v: (B, T + 1, nv) velocities.
            n_steps: Frames after the first, one number or one a motion (B,).
            dt: Between frames, in true time [s].
            onward: What moves them, for rotations of other times than those of frames.
        """
        if self._as_is:
            return q
        delay, poses = self.recording.rotation_delay, self.recorded_poses(q)
        if delay != 0.0:
            late = with_late_rotations(q, v, delay=delay, dt=dt, n_steps=n_steps, onward=onward)
            poses[..., 3:7] = self.recorded_poses(late)[..., 3:7]
        return poses

    def roll_out(
        self,
        q0: Array,
        v0: Array,
        *,
        n_steps: int | NDArray[np.int64],
        dt: float,
        substeps: int,
        impact_parts: int = 1,
        tolerance: float = TOLERANCE,
        near: tuple[Array, Array] | None = None,
        n_threads: int = 1,
    ) -> Array:
        """Recorded motions (B, T + 1, nq) from recorded first states (B, nq), (B, nv); NaN where one diverges.

        dt: between recorded frames, on the recording's clock [s]. near: first states (B, nq), (B, nv) that differ
        little; no motion of this world costs so much that it is found by others. The rest is as in `simulate`.
        """
        system, (q, v), true_dt = self.system(), self.to_ground(q0, v0), dt / self.recording.clock_rate

        def onward(q: Array, v: Array, n_steps: int | NDArray[np.int64], dt: float) -> tuple[Array, Array]:
            run = simulate(
                system,
                q,
                v,
                n_steps=n_steps,
                dt=dt,
                substeps=substeps,
                impact_parts=impact_parts,
                tolerance=tolerance,
                n_threads=n_threads,
            )
            if not run.finite.all():
                run.q[~run.finite], run.v[~run.finite] = np.nan, np.nan
            return run.q, run.v

        return self.recorded_motions(*onward(q, v, n_steps, true_dt), n_steps=n_steps, dt=true_dt, onward=onward)

    @property
    def _tilted(self) -> bool:
        return self.ground_tilt != (0.0, 0.0)

    @cached_property
    def _as_is(self) -> bool:
        """Whether true motion in the ground's frame is what is recorded."""
        return self.recording == RecordingErrors() and self.ground_height == 0.0 and not self._tilted

    @property
    def _joint_scale(self) -> Array:
        """Recorded joint positions over true ones (n_j,): lengths of slides are recorded as others are."""
        slides = self.object.joint_type[1:] == JointType.SLIDE
        return np.where(slides, self.recording.length_scale, 1.0)

    @property
    def _lift(self) -> Array:
        return np.array([0.0, 0.0, self.ground_height])

    def _arm(self, q: Array, v: Array) -> tuple[Array, Array]:
        """From the object's origin to the recorded frame's, and its velocity over the origin's: (*b, 3) each."""
        offset = np.array(self.recording.frame_offset)
        return quat_rotate(q[..., 3:7], offset), quat_rotate(q[..., 3:7], np.cross(v[..., 3:6], offset))


def _moves_freely_like(one: ObjectModel, other: ObjectModel, *, forced: bool) -> bool:
    """Whether two objects move alike without contact; without forces inertia counts by its ratios only."""
    if one is other:
        return True
    if (
        one.n_joints
        or other.n_joints
        or not (np.array_equal(one.mass, other.mass) and np.array_equal(one.com, other.com))
    ):
        return False
    size = 1.0 if forced else np.trace(other.inertia[0]) / np.trace(one.inertia[0])
    return bool((np.abs(size * one.inertia - other.inertia) <= 1e-12 * np.abs(other.inertia)).all())


def _longest(vectors: Array) -> float:
    """Length of the longest of vectors (n, 3); 0 of none."""
    return math.sqrt(np.square(vectors).sum(axis=-1).max(initial=0.0))


def _turn(angles: tuple[float, float]) -> Array:
    """Quaternion of the rotation vector (x, y, 0) [rad]."""
    return quat_exp(np.array([angles[0], angles[1], 0.0]))
