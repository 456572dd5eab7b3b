"""The painted ground: flat levels without texture, prints where they lie, the wall above the horizon."""

from __future__ import annotations

import numpy as np

from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import look_at
from tossid.vision.rendering._ground_texture import Items, Levels, paint_ground

CAMERA = Camera("c", (120, 90), [100, 100, 59.5, 44.5], T_rig_cam=look_at([0.0, -1.0, 0.6], [0.0, 0.0, 0.2]))
CENTRES = np.array([[0.5, 0.5, 0.5, 0.5, 0.0]])


def _painted(levels: Levels, items: Items) -> np.ndarray:
    canvas = np.empty((90, 120), dtype=np.float32)
    paint_ground(canvas, CAMERA.rays, CENTRES, CAMERA.T_world_cam, (0.0, 1.0), levels, items)
    return canvas


def _items(*rows: list[float]) -> Items:
    half = np.array(rows, dtype=float).reshape(-1, 5)
    bitmaps = np.tile(np.array([[1, 0], [0, 0]], dtype=np.uint8), (len(half), 1, 1))
    return Items(half, np.full(len(half), 2, dtype=np.int64), bitmaps)


def test_the_wall_begins_at_the_horizon() -> None:
    canvas = _painted(Levels(100.0, 40.0, 0.0, 220.0, 10.0), _items())
    rays = CAMERA.rays[:-1, :-1] + 0.5 * (CAMERA.rays[1:, 1:] - CAMERA.rays[:-1, :-1])
    down = np.concatenate([rays, np.ones((90, 120, 1))], axis=-1) @ CAMERA.T_world_cam[2, :3]
    np.testing.assert_array_equal(canvas == 40.0, down >= 0)


def test_a_prints_cells_lie_where_it_lies() -> None:
    canvas = _painted(Levels(100.0, 40.0, 0.0, 220.0, 10.0), _items([0.0, 0.0, 1.0, 0.0, 0.2]))
    for (x, y), level in {(-0.1, 0.1): 220.0, (0.1, 0.1): 10.0, (-0.1, -0.1): 10.0}.items():
        column, row = np.round(CAMERA.project(np.array([[x, y, 0.0]]))[0]).astype(int)
        assert canvas[row, column] == level


def test_texture_has_the_contrast_that_is_asked_for() -> None:
    levels = Levels(100.0, 40.0, 0.0, 220.0, 10.0)
    plain, rough = (_painted(levels._replace(texture=texture), _items()) for texture in (0.0, 20.0))
    ground = plain != 40.0
    assert 10.0 < (rough - plain)[ground].std() < 30.0
    assert abs((rough - plain)[ground].mean()) < 6.0
