"""Rendered images hold the truth to a small part of a pixel."""

from __future__ import annotations

import numpy as np
import pytest

from tests.vision.films import corner_errors, random_poses, true_corners
from tossid.errors import InputError, ObjectError
from tossid.objects import ObjectModel, Tag
from tossid.rotations import quat_exp, quat_mul
from tossid.settings.ingestion import DetectSettings
from tossid.settings.rendering import RenderSettings
from tossid.types import Frame
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig, look_at
from tossid.vision.detection.detect import TagFinder
from tossid.vision.rendering.render import Renderer
from tossid.vision.setup.faces import default_tags, tag_bitmap


def test_detected_corners_are_the_true_ones(tagged: ObjectModel):
    """Right ids, right order of corners, and a tenth of a pixel, under lens distortion."""
    cameras = default_rig()
    errors, cells = corner_errors(Renderer(tagged, cameras), cameras, tagged, random_poses(25))
    distance = np.linalg.norm(errors, axis=-1)
    assert len(errors) > 100
    assert np.median(distance) < 0.05
    assert np.quantile(distance[cells > 2.5], 0.95) < 0.12
    assert np.abs(errors.mean(axis=(0, 1))).max() < 0.02  # no shift of the pixel origin


def test_corners_are_true_through_a_fisheye(tagged: ObjectModel):
    T = look_at([0.5, 0.1, 0.5], [0.0, 0.0, 0.15])
    camera = Camera("eye", (640, 512), [380, 380, 320, 256], "equidistant", [-0.03, 0.01, 0.0, 0.0], T)
    poses = random_poses(12, 1) * [0.5, 0.5, 0.5, 1, 1, 1, 1] + [0, 0, 0.05, 0, 0, 0, 0]
    errors, _ = corner_errors(Renderer(tagged, [camera]), [camera], tagged, poses)
    assert len(errors) > 10
    assert np.median(np.linalg.norm(errors, axis=-1)) < 0.08


def test_blur_is_centred_on_the_middle_of_the_exposure(tagged: ObjectModel):
    cameras = default_rig(n_cameras=1)
    renderer = Renderer(tagged, cameras)
    errors = []
    for q in random_poses(12, 8):
        opened, closed = q.copy(), q.copy()
        way, turn = np.array([0.0015, -0.001, 0.0005]), np.array([0.005, 0.0, -0.005])
        opened[:3], closed[:3] = q[:3] - way, q[:3] + way
        opened[3:7], closed[3:7] = quat_mul(q[3:7], quat_exp(-turn)), quat_mul(q[3:7], quat_exp(turn))
        image = renderer.render(opened, closed, "cam0", np.random.default_rng(0))
        for detection in TagFinder(cameras[0], tagged).find(Frame("cam0", 0.0, image)):
            errors.append(detection.corners - true_corners(cameras[0], tagged, q, detection))
    assert len(errors) > 10
    assert np.median(np.linalg.norm(errors, axis=-1)) < 0.08
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.04


def test_refinement_measurably_helps(tagged: ObjectModel):
    cameras = default_rig(n_cameras=1)
    renderer = Renderer(tagged, cameras)
    size = {}
    for refine in (True, False):
        errors = []
        for q in random_poses(15, 4):
            frame = Frame("cam0", 0.0, renderer.render(q, q, "cam0", np.random.default_rng(0)))
            for detection in TagFinder(cameras[0], tagged, DetectSettings(refine=refine)).find(frame):
                errors.append(detection.corners - true_corners(cameras[0], tagged, q, detection))
        size[refine] = np.median(np.linalg.norm(errors, axis=-1))
    assert size[True] < 0.7 * size[False]


def test_a_pixel_is_the_mean_over_its_area(tagged: ObjectModel):
    """A face seen straight on covers an area of the image that geometry gives exactly."""
    bare = tagged.with_changes(tags=())
    camera = Camera("c", (200, 200), [300, 300, 100.3, 99.6], T_rig_cam=look_at([1.0, 1e-9, 0.5], [0.0, 0.0, 0.5]))
    settings = RenderSettings(blur=0.0, noise=0.0, ambient=1.0, white=250.0, samples=64)
    renderer = Renderer(bare, [camera], settings)
    image = renderer.render(np.array([0, 0, 0.5, 1, 0, 0, 0]), np.array([0, 0, 0.5, 1, 0, 0, 0]), "c", None)
    empty = renderer.render(np.array([0, 0, -9.0, 1, 0, 0, 0]), np.array([0, 0, -9.0, 1, 0, 0, 0]), "c", None)
    covered = ((image.astype(float) - empty) / (250.0 - empty)).sum()
    width = 300 * 0.1048 / (1.0 - 0.0524)
    assert covered == pytest.approx(width**2, rel=2e-3)


def test_the_nearer_link_hides_the_farther(elbow: ObjectModel):
    """With the hinge at zero the links lie side by side along y: seen along y only the first shows its tags."""
    model = elbow.with_changes(tags=default_tags(elbow))
    camera = Camera("c", (640, 512), [900, 900, 320, 256], T_rig_cam=look_at([0.0, -0.8, 0.3001], [0.0, 0.0, 0.3]))
    renderer = Renderer(model, [camera], RenderSettings(noise=0.0))
    q = np.array([0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0, 0.0])
    ids = {d.tag_id for d in TagFinder(camera, model).find(Frame("c", 0.0, renderer.render(q, q, "c", None)))}
    assert 3 in ids  # -y of the first link
    assert 9 not in ids  # -y of the second, behind it
    q[7] = np.pi / 2  # the second link turns out of the shadow of the first
    q[2] = 0.3
    image = renderer.render(q, q, "c", None)
    turned = {d.tag_id for d in TagFinder(camera, model).find(Frame("c", 0.0, image))}
    assert 3 in turned


def test_noise_comes_from_the_generator_and_has_its_size(tagged: ObjectModel):
    cameras = default_rig(n_cameras=1)
    renderer = Renderer(tagged, cameras, RenderSettings(noise=2.0))
    q = np.array([0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0])
    clean = renderer.render(q, q, "cam0", None).astype(float)
    one, same, other = (renderer.render(q, q, "cam0", np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert (one != other).mean() > 0.5
    # far from the object; rounding both images adds a little
    assert np.std(one[:60] - clean[:60]) == pytest.approx(2.0, rel=0.05)


def test_what_cannot_be_drawn_is_refused(tagged: ObjectModel):
    T = np.eye(4)
    T[:3, 3] = [0, 0, 0.2]
    with pytest.raises(ObjectError, match="no flat face"):
        Renderer(tagged.with_changes(tags=(Tag(0, 0.08, 0, T),)), default_rig())
    with pytest.raises(ObjectError, match="600"):
        tag_bitmap(600)
    with pytest.raises(InputError, match="cam7"):
        q = random_poses(1)[0]
        Renderer(tagged, default_rig()).render(q, q, "cam7", None)
