"""What goes into the pose graph beside the scene, and what comes out of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tossid.vision.pose_graph.initial import State

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


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
