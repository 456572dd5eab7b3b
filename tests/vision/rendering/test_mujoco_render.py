"""MuJoCo's renderer draws what ours draws."""

from __future__ import annotations

import numpy as np
import pytest

from tests.vision.films import corner_errors, random_poses
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.vision.cameras.rig import default_rig
from tossid.vision.rendering.mujoco_render import MujocoRenderer, gl_context


def test_mujocos_renderer_agrees(tagged: ObjectModel):
    try:
        gl_context(8, 8)
    except InputError as error:
        pytest.skip(str(error))
    cameras = default_rig(n_cameras=2)
    errors, cells = corner_errors(MujocoRenderer(tagged, cameras), cameras, tagged, random_poses(6))
    assert len(errors) > 15
    assert np.median(np.linalg.norm(errors[cells > 2.5], axis=-1)) < 0.06


def test_mujocos_renderer_says_what_it_lacks(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setenv("PYOPENGL_PLATFORM", "none")
    import sys

    monkeypatch.setitem(sys.modules, "mujoco.osmesa", None)  # an import that fails
    with pytest.raises(InputError, match=r"needs EGL or OSMesa.*osmesa"):
        gl_context(8, 8)
