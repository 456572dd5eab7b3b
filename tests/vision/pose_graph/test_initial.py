"""First poses: near the truth from one known camera outward, and the choice between a flat tag's two poses."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tests.vision.sights import filmed_tumble
from tossid.objects import ObjectModel
from tossid.rotations import geodesic_angle, matrix_to_quat, transform, transform_from_rotvec
from tossid.settings.tracking import TrackSettings
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.initial import choose, initialise, noise_scale
from tossid.vision.pose_graph.resect import Resection
from tossid.vision.pose_graph.scene import observe
from tossid.vision.setup.layout import layout_of


def test_unknown_cameras_are_placed_by_what_a_known_one_sees(tagged: ObjectModel) -> None:
    true = default_rig()
    detections, q = filmed_tumble(true, tagged, np.random.default_rng(0), n=60)
    cameras = (true[0], *(replace(camera, T_rig_cam=None) for camera in true[1:]))
    state = initialise(observe(detections, cameras, layout_of(tagged), dropped=Counter()))
    for c, camera in enumerate(true):
        assert np.linalg.norm(state.camera[c][:3, 3] - camera.T_rig_cam[:3, 3]) < 0.01
    T = state.world[-1]
    known = np.isfinite(T[:, 0, 0])
    assert known.mean() > 0.95
    angle = geodesic_angle(matrix_to_quat(T[known, :3, :3]), q[known, 3:7])
    assert np.quantile(angle, 0.95) < np.deg2rad(3.0)
    assert np.median(np.linalg.norm(T[known, :3, 3] - transform(q[known, :3], q[known, 3:7])[:, :3, 3], axis=1)) < 2e-3


def _two(angles: np.ndarray, flipped: np.ndarray, certain: np.ndarray) -> Resection:
    """A slow turn about x; where `flipped`, the pose with the smaller cost is the reflected one."""
    n = len(angles)
    true, other = (
        transform_from_rotvec(np.zeros((n, 3)), np.stack([a, 0 * a, 0 * a], axis=1)) for a in (angles, -angles)
    )
    first = np.where(flipped[:, None, None], other, true)
    second = np.where(flipped[:, None, None], true, other)
    cost = np.full(n, 2.0 * 8 - 6)
    information = np.tile(np.eye(6), (n, 1, 1))
    gain = np.where(certain, 1000.0, 1.0)
    return Resection(
        first, information, cost, np.ones(n, bool), second, information, cost + gain, np.ones(n, bool), np.full(n, 2)
    )


def test_certain_neighbours_decide_between_two_poses() -> None:
    t, angles = np.arange(20) / 148, np.linspace(0.6, 0.8, 20)
    flipped = np.arange(20) % 3 == 1
    certain = ~flipped & (np.arange(20) % 3 == 0)
    T, sure = choose(_two(angles, flipped, certain), t, TrackSettings())
    assert sure.all()
    np.testing.assert_allclose(np.arctan2(T[:, 2, 1], T[:, 1, 1]), angles, atol=1e-9)
    _, sure = choose(_two(angles, flipped, certain), 10 * t, TrackSettings())  # too far apart in time
    np.testing.assert_array_equal(sure, certain)


@pytest.mark.parametrize("scale", [0.5, 3.0])
def test_the_noises_scale_is_that_of_the_residuals(scale: float) -> None:
    rng, n = np.random.default_rng(1), 4000
    eye, cov = np.tile(np.eye(4), (n, 1, 1)), np.tile(np.eye(6), (n, 1, 1))
    cost = scale**2 * rng.chisquare(18, n)
    found = Resection(eye, cov, cost, np.ones(n, bool), eye, cov, cost, np.zeros(n, bool), np.full(n, 3))
    assert noise_scale(found) == pytest.approx(scale, rel=0.02)
