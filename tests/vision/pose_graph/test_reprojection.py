"""Reprojection of true poses: the noise and nothing else; the spread of edges is estimated and subtracted."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tests.vision.sights import filmed_tumble
from tossid.objects import ObjectModel
from tossid.rotations import transform
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.initial import State, given
from tossid.vision.pose_graph.reprojection import printed_corners, reproject
from tossid.vision.pose_graph.scene import Scene, corner_growth, observe
from tossid.vision.setup.layout import SQUARE, layout_of

SIGMA, SPREAD = 0.1, 0.8


def _true(model: ObjectModel, *, spread: float = 0.0) -> tuple[Scene, State]:
    cameras = default_rig()
    detections, q = filmed_tumble(cameras, model, np.random.default_rng(0), n=80, sigma=SIGMA)
    detections = [replace(d, corners=d.corners + spread * corner_growth(d.corners[None])[0]) for d in detections]
    scene = observe(detections, cameras, layout_of(model), dropped=Counter())
    state = given(scene)
    b = next(i for i, body in enumerate(scene.bodies) if not body.is_static)
    state.world[b][:] = transform(q[:, :3], q[:, 3:7])
    return scene, state


def test_true_poses_leave_the_noise(tagged: ObjectModel) -> None:
    scene, state = _true(tagged)
    errors = reproject(scene, state)
    assert np.sqrt(np.mean(errors.pixels**2)) == pytest.approx(SIGMA * 2**0.5, rel=0.03)
    assert np.sqrt(np.mean(errors.whitened**2)) == pytest.approx(1.0, rel=0.03)
    np.testing.assert_allclose(errors.expected_pixels, SIGMA * 2**0.5, rtol=1e-6)
    np.testing.assert_array_equal(errors.pixels, errors.raw_pixels)


def test_a_spread_of_edges_is_estimated_and_subtracted(tagged: ObjectModel) -> None:
    scene, state = _true(tagged, spread=SPREAD)
    errors = reproject(scene, state, spread_sigma=SPREAD)
    assert np.median(errors.spread) == pytest.approx(SPREAD, rel=0.02)
    assert np.sqrt(np.mean(errors.pixels**2)) < 1.05 * SIGMA * 2**0.5 < np.sqrt(np.mean(errors.raw_pixels**2))


def test_an_unknown_pose_has_no_reprojection(tagged: ObjectModel) -> None:
    scene, state = _true(tagged)
    state.tag[0] = np.nan
    np.testing.assert_array_equal(np.isnan(reproject(scene, state).pixels), scene.tag == 0)


def test_prints_stretch_and_twist_corners() -> None:
    np.testing.assert_array_equal(printed_corners(np.zeros(3)), SQUARE)
    corners = printed_corners(np.array([0.02, -0.01, 0.03]))
    np.testing.assert_allclose(corners[2], [1.02, 0.99, 0.03])
    np.testing.assert_allclose(corners[3], [-1.02, 0.99, -0.03])
