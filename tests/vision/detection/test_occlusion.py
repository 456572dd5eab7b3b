"""What lies against a tag moves its corners: that is seen, and the corners' covariances say so."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, transform, transform_points
from tossid.settings.rendering import RenderSettings
from tossid.types import Frame
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import look_at
from tossid.vision.detection.detect import BESIDE_HIDDEN, HIDDEN_SIGMA, TagFinder
from tossid.vision.detection.occlusion import hidden_edges
from tossid.vision.rendering.render import Renderer
from tossid.vision.setup.faces import tag_corners

CAMERA = Camera("c", (320, 256), [420, 420, 159.5, 127.5], T_rig_cam=look_at([1.0, 1e-9, 0.5], [0.0, 0.0, 0.5]))
CELL = 420 * 0.01 / (1 - 0.0524)
"""A cell of the tag that faces the camera [px]."""


def _seen(tagged: ObjectModel, turn: float, *, level: float | None, over: float) -> tuple[np.ndarray, np.ndarray]:
    """An image of tag 0 with a grey thing over the right margin and `over` cells of the border, and true corners."""
    q = np.array([0.0, 0.0, 0.5, *quat_exp([0.0, 0.0, turn])])
    image = Renderer(tagged, [CAMERA], RenderSettings(samples=64)).render(q, q, "c", np.random.default_rng(1))
    tag = next(tag for tag in tagged.tags if tag.id == 0)
    true = CAMERA.project(transform_points(transform(q[:3], q[3:7]), tag_corners(tag)))
    if level is not None:
        right = round(true[1:3, 0].min() - over * CELL)
        image[:, right : right + 30] = level
    return image, true


@pytest.mark.parametrize("turn", [0.0, 0.3])
@pytest.mark.parametrize("level", [90.0, 115.0])
def test_an_occluder_at_an_edge_is_detected(tagged: ObjectModel, turn: float, level: float) -> None:
    image, true = _seen(tagged, turn, level=level, over=0.3)
    finder = TagFinder(CAMERA, tagged)
    (found,) = (d for d in finder.find(Frame("c", 0.0, image)) if d.tag_id == 0)
    hidden, cell = hidden_edges(image, found.corners, 8)
    np.testing.assert_array_equal(hidden, [False, True, False, False])  # bottom, right, top, left
    assert cell == pytest.approx(CELL, rel=0.12)
    assert finder.tally["edges that may not be the tag's"] > 0
    error = np.linalg.norm(found.corners - true, axis=1)
    sigma = np.sqrt(np.trace(found.corner_cov, axis1=1, axis2=2) / 2)
    assert error[1:3].max() > 0.3
    np.testing.assert_allclose(sigma[1:3], HIDDEN_SIGMA * cell, rtol=0.05)
    np.testing.assert_allclose(sigma[[0, 3]], BESIDE_HIDDEN * HIDDEN_SIGMA * cell, rtol=0.05)
    assert (error < 2 * sigma).all()


@pytest.mark.parametrize("turn", [0.0, 0.3, 0.7, 1.0])
def test_a_tag_surrounded_by_paper_is_not_occluded(tagged: ObjectModel, turn: float) -> None:
    image, true = _seen(tagged, turn, level=None, over=0.0)
    hidden, _ = hidden_edges(image, true, 8)
    assert not hidden.any()
