"""Effects of the environment: slopes, and ground that is not at z = 0."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.physics.worlds import DT, HALF
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.rotations import quat_exp, quat_rotate

Array = NDArray[np.float64]


@pytest.mark.parametrize(("angle", "moves"), [(0.165, False), (0.195, True)])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_block_slides_on_a_slope_steeper_than_its_friction(
    cube: ObjectModel, angle: float, moves: bool, axis: int
) -> None:
    """mu = 0.18. The cube is put flat on the tilted ground, and seen in the true, level world."""
    tilt = (angle, 0.0) if axis == 0 else (0.0, angle)
    turn = quat_exp(np.array([*tilt, 0.0]))
    q = np.concatenate([quat_rotate(turn, np.array([0, 0, HALF])), turn])
    world = World(cube, ground_tilt=tilt)
    seen = world.roll_out(q[None], np.zeros((1, 6)), n_steps=60, dt=DT, substeps=2)[0]
    moved = seen[-1, :3] - seen[0, :3]
    if not moves:
        assert np.abs(moved).max() < 1e-6
        return
    # it goes down, in the direction of the slope: a turn about +x lowers -y, about +y lowers +x
    way = 0.5 * 9.81 * (np.sin(angle) - 0.18 * np.cos(angle)) * (60 * DT) ** 2
    down = np.array([0, -np.cos(angle), -np.sin(angle)] if axis == 0 else [np.cos(angle), 0, -np.sin(angle)])
    np.testing.assert_allclose(moved, way * down, atol=0.03 * way)


@pytest.mark.parametrize("height", [-0.02, 0.03])
def test_the_ground_lies_at_its_height(cube: ObjectModel, height: float) -> None:
    q = np.array([[0.0, 0, HALF + height + 0.05, 1, 0, 0, 0]])
    seen = World(cube, ground_height=height).roll_out(q, np.zeros((1, 6)), n_steps=100, dt=DT, substeps=2)
    np.testing.assert_allclose(seen[0, -1, 2], HALF + height, atol=1e-6)
