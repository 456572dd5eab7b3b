"""The poses of a scene: what the set-up says of them, and what the graph found, with covariances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np
from numpy.typing import NDArray

from tossid.vision.cameras.camera import Camera
from tossid.vision.pose_graph.scene import Scene
from tossid.vision.setup.layout import Body, BodyTag

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

EXACT = 2e-6
"""Standard deviation up to which a pose is a constant [m, rad]; a smaller one would make the graph ill-conditioned."""
STEPS = 2**32
"""Time steps that the keys of a body have room for."""


@dataclass(eq=False)
class State:
    """Poses of a scene; NaN where unknown.

    Attributes:
        camera: T_rig_cam, (cameras, 4, 4).
        tag: T_body_tag, (tags, 4, 4).
        world: For each body T_world_body, (n, 4, 4) by time step if it moves, else (1, 4, 4).
        prints: By what shares each tag is wider, higher, and twisted out of its plane, (tags, 3).
        gauge: Tags that define the frame of a body none of whose tags is known.
    """

    camera: Array
    tag: Array
    world: list[Array]
    prints: Array
    gauge: list[int] = field(default_factory=list)

    def at(self, body: Ints, step: Ints) -> Array:
        """T_world_body of each row's body in its step, (d, 4, 4).

        Args:
            body: Number of the body, (d,).
            step: Time step, (d,).
        """
        return by_step(self.world, body, step)

    def copy(self) -> State:
        """A copy that can be changed."""
        return State(
            self.camera.copy(), self.tag.copy(), [T.copy() for T in self.world], self.prints.copy(), list(self.gauge)
        )


def by_step(values: Sequence[Array], body: Ints, step: Ints) -> Array:
    """What holds for each row's body in its step, (d, *k).

    Args:
        values: Of each body, (n or 1, *k) by time step, one for all steps of a static body.
        body: Number of the body, (d,).
        step: Time step, (d,).
    """
    out = np.full((len(body), *values[0].shape[1:]), np.nan)
    for b, value in enumerate(values):
        own = body == b
        out[own] = value[step[own] if len(value) > 1 else np.zeros(own.sum(), dtype=np.int64)]
    return out


def is_known(T: Array) -> Bools:
    """Which poses are known, (*b, 4, 4) to (*b,)."""
    return np.asarray(np.isfinite(T[..., 0, 0]))


def given(scene: Scene) -> State:
    """The poses that the set-up gives."""
    unknown = np.full((4, 4), np.nan)

    def stack(poses: Sequence[Array | None]) -> Array:
        return np.array([unknown if T is None else T for T in poses]).reshape(-1, 4, 4)

    world = []
    for body in scene.bodies:
        T = unknown if body.T_map_body is None else body.T_map_body
        # at least two rows, so that a moving body differs from a static one
        world.append(T[None].copy() if body.is_static else np.full((max(len(scene.t), 2), 4, 4), np.nan))
    cameras, tags = stack([c.T_rig_cam for c in scene.cameras]), stack([t.T_body_tag for t in scene.tags])
    return State(cameras, tags, world, np.zeros((len(tags), 3)))


@dataclass(frozen=True, eq=False)
class TimingModel:
    """How a pose at its time step relates to a frame at the frame's own time.

    Attributes:
        twist: For each body (n or 1, 6), its rotation [rad/s] and translation [m/s] in its own frame at each step.
        clock: Offset of each camera's clock, subtracted from the frames' delays [s], (cameras,).
        free: Whether the offset is a variable of the graph, (cameras,).
    """

    twist: list[Array]
    clock: Array
    free: Bools

    @classmethod
    def none(cls, scene: Scene) -> TimingModel:
        """Bodies that stand still within a step, and clocks that agree."""
        n = len(scene.cameras)
        return cls([np.zeros((1, 6))] * len(scene.bodies), np.zeros(n), np.zeros(n, dtype=bool))


@dataclass(eq=False)
class Solution:
    """Optimised poses with covariances in the tangent (rotation [rad], translation [m], of the moving frame).

    A covariance is zero where a pose is exactly known and NaN where it is unknown.

    Attributes:
        state: The poses.
        camera_cov: (cameras, 6, 6).
        tag_cov: (tags, 6, 6).
        world_cov: For each body (n or 1, 6, 6), as `State.world`.
        clock: Offsets of the clocks [s], (cameras,).
        clock_sigma: Their standard deviations [s], (cameras,).
        tree_cov: For each body that others hang on, (n, 6 + m, 6 + m) of its tangent and the m hinge angles, in the
            bodies' order.
    """

    state: State
    camera_cov: Array
    tag_cov: Array
    world_cov: list[Array]
    clock: Array
    clock_sigma: Array
    tree_cov: dict[int, Array] = field(default_factory=dict)


def unsolved(state: State, clock: Array) -> Solution:
    """Poses as they are, without covariances.

    Args:
        state: The poses; copied.
        clock: Offsets of the clocks [s], (cameras,).
    """
    return Solution(
        state.copy(),
        np.full((len(state.camera), 6, 6), np.nan),
        np.full((len(state.tag), 6, 6), np.nan),
        [np.full((len(T), 6, 6), np.nan) for T in state.world],
        clock.copy(),
        np.zeros(len(clock)),
    )


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of a pose before the graph.

    Attributes:
        T: (4, 4).
        cov: In the tangent (rotation [rad], translation [m]), (6, 6); None for exact.
    """

    T: Array
    cov: Array | None

    @property
    def exact(self) -> bool:
        """Whether the pose is a constant."""
        return self.cov is None or bool(np.diag(self.cov).max() <= EXACT**2)

    @classmethod
    def of_camera(cls, camera: Camera) -> Prior | None:
        """What the set-up says of T_rig_cam; None for nothing."""
        return None if camera.T_rig_cam is None else cls(camera.T_rig_cam, camera.T_rig_cam_cov)

    @classmethod
    def of_tag(cls, tag: BodyTag) -> Prior | None:
        """What the set-up says of T_body_tag; None for nothing."""
        return cls._of(tag.T_body_tag, tag.rotation_noise, tag.position_noise)

    @classmethod
    def of_body(cls, body: Body) -> Prior | None:
        """What the set-up says of a static body's T_map_body; None for nothing."""
        return cls._of(body.T_map_body, body.rotation_noise, body.position_noise)

    @classmethod
    def _of(cls, T: Array | None, rotation: Array | None, position: Array | None) -> Prior | None:
        if T is None:
            return None
        exact = rotation is None or position is None
        return cls(T, None if exact else np.diag(np.concatenate([rotation, position]) ** 2))


def priors(scene: Scene) -> dict[int, Prior]:
    """The set-up's poses of cameras, tags and static bodies, by key."""
    found = {camera_key(c): Prior.of_camera(camera) for c, camera in enumerate(scene.cameras)}
    found |= {tag_key(i): Prior.of_tag(tag) for i, tag in enumerate(scene.tags)}
    found |= {body_key(b, 0): Prior.of_body(body) for b, body in enumerate(scene.bodies)}
    return {key: prior for key, prior in found.items() if prior is not None}


def camera_key(c: int) -> int:
    """Key of T_rig_cam."""
    return int(gtsam.symbol("c", c))


def tag_key(i: int) -> int:
    """Key of T_body_tag."""
    return int(gtsam.symbol("t", i))


def body_key(b: int, step: int) -> int:
    """Key of T_world_body in a time step (0 for a static one)."""
    return int(gtsam.symbol("x", b * STEPS + step))


def joint_key(b: int, step: int) -> int:
    """Key of the angle of the hinge that a body hangs on, in a time step."""
    return int(gtsam.symbol("j", b * STEPS + step))


def print_key(i: int) -> int:
    """Key of a tag's print."""
    return int(gtsam.symbol("p", i))


def clock_key(c: int) -> int:
    """Key of a camera's clock offset."""
    return int(gtsam.symbol("o", c))
