"""What goes into the pose graph beside the scene, and what comes out of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tossid.vision.initial import State

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Motion:
    """How bodies move at each step, and clocks.

    twist: for each body (n or 1, 6) rotation [rad/s] and translation [m/s] in its own frame. clock: (cameras,)
    offsets [s] taken off the frames' lateness. free: (cameras,) whose offset is a variable.
    """

    twist: list[Array]
    clock: Array
    free: Bools


@dataclass(eq=False)
class Solution:
    """Optimised poses, and covariances in the tangent (rotation [rad], translation [m], of the moving frame).

    camera_cov: (cameras, 6, 6). tag_cov: (tags, 6, 6). world_cov: as `State.world`, (n or 1, 6, 6). Zero where
    exactly known, NaN where unknown. clock, clock_sigma: (cameras,) [s]. tree_cov: of each body that others hang on,
    (n, 6 + m, 6 + m) of its tangent and their m angles together, in the order of the bodies.
    """

    state: State
    camera_cov: Array
    tag_cov: Array
    world_cov: list[Array]
    clock: Array
    clock_sigma: Array
    tree_cov: dict[int, Array] = field(default_factory=dict)


def unsolved(state: State, clock: Array) -> Solution:
    """Poses as they are, without covariances."""
    return Solution(
        state.copy(),
        np.full((len(state.camera), 6, 6), np.nan),
        np.full((len(state.tag), 6, 6), np.nan),
        [np.full((len(T), 6, 6), np.nan) for T in state.world],
        clock.copy(),
        np.zeros(len(clock)),
    )
