"""MuJoCo's renderer draws what ours draws."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.rotations import quat_normalize, transform, transform_points
from tossid.types import Detection, Frame
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig
from tossid.vision.detection.detect import TagFinder
from tossid.vision.rendering.mujoco_render import MujocoRenderer, gl_context
from tossid.vision.setup.faces import tag_corners


def _poses(n: int, seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.array(
        [[*rng.uniform([-0.3, -0.3, 0.06], [0.3, 0.3, 0.4]), *quat_normalize(rng.normal(size=4))] for _ in range(n)]
    )


def _true_corners(camera: Camera, model: ObjectModel, q: np.ndarray, detection: Detection) -> np.ndarray:
    tag = next(tag for tag in model.tags if tag.id == detection.tag_id)
    return camera.project(transform_points(transform(q[:3], q[3:7]), tag_corners(tag)))


def _errors(source, cameras, model: ObjectModel, poses: np.ndarray) -> np.ndarray:
    """Detected minus true corners, and the width of a tag's cell [px], of every tag found. (n, 4, 2), (n,)."""
    errors, cells = [], []
    for q in poses:
        for camera in cameras:
            image = source.render(q, q, camera.name, None)
            for detection in TagFinder(camera, model).find(Frame(camera.name, 0.0, image)):
                true = _true_corners(camera, model, q, detection)
                errors.append(detection.corners - true)
                (ax, ay), (bx, by) = true[2] - true[0], true[3] - true[1]
                longest = np.linalg.norm(np.roll(true, -1, axis=0) - true, axis=1).max()
                cells.append(abs(ax * by - ay * bx) / 2 / longest / 8)
    return np.array(errors), np.array(cells)


def test_mujocos_renderer_agrees(tagged: ObjectModel):
    try:
        gl_context(8, 8)
    except InputError as error:
        pytest.skip(str(error))
    cameras = default_rig(n_cameras=2)
    errors, cells = _errors(MujocoRenderer(tagged, cameras), cameras, tagged, _poses(6))
    assert len(errors) > 15
    assert np.median(np.linalg.norm(errors[cells > 2.5], axis=-1)) < 0.06


def test_mujocos_renderer_says_what_it_lacks(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setenv("PYOPENGL_PLATFORM", "none")
    import sys

    monkeypatch.setitem(sys.modules, "mujoco.osmesa", None)  # an import that fails
    with pytest.raises(InputError, match=r"needs EGL or OSMesa.*osmesa"):
        gl_context(8, 8)
