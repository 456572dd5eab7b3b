"""Prior knowledge of poses from the set-up, by their keys in the graph."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from tossid.vision.pose_graph.scene import Scene

Array = NDArray[np.float64]

EXACT = 2e-6
"""Standard deviation up to which a pose is a constant [m, rad]; a smaller one would make the graph ill-conditioned."""
STEPS = 2**32
"""Time steps that the keys of a body have room for."""


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


def priors(scene: Scene) -> dict[int, Prior]:
    """The set-up's poses of cameras, tags and static bodies, by key."""
    found = {}
    for c, camera in enumerate(scene.cameras):
        if camera.T_rig_cam is not None:
            found[camera_key(c)] = Prior(camera.T_rig_cam, camera.T_rig_cam_cov)
    for i, tag in enumerate(scene.tags):
        if tag.T_body_tag is not None:
            found[tag_key(i)] = Prior(tag.T_body_tag, _cov(tag.rotation_noise, tag.position_noise))
    for b, body in enumerate(scene.bodies):
        if body.T_map_body is not None:
            found[body_key(b, 0)] = Prior(body.T_map_body, _cov(body.rotation_noise, body.position_noise))
    return found


def _cov(rotation: Array | None, position: Array | None) -> Array | None:
    if rotation is None or position is None:
        return None
    return np.diag(np.concatenate([rotation, position]) ** 2)


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


def calibrates(scene: Scene, known: dict[int, Prior]) -> bool:
    """Whether time steps share unknowns: something static is not exactly known, or stillness connects them.

    Args:
        scene: The set-up.
        known: Prior knowledge by key.
    """
    keys = [camera_key(c) for c in range(len(scene.cameras))] + [tag_key(i) for i in range(len(scene.tags))]
    keys += [body_key(b, 0) for b, body in enumerate(scene.bodies) if body.is_static]
    still = any(body.stillness is not None for body in scene.bodies)
    return still or not all(key in known and known[key].exact for key in keys)
