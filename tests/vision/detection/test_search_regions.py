"""The predicted region is small and holds the object."""

from __future__ import annotations

import numpy as np
import pytest

from tests.vision.conftest import Filmed
from tests.vision.sights import alike
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, transform, transform_points
from tossid.types import Detection
from tossid.vision.cameras.rig import default_rig
from tossid.vision.detection.detect import TagFinder
from tossid.vision.detection.search_regions import Predictor, tag_spheres
from tossid.vision.pose_graph.resect import SQUARE
from tossid.vision.setup.faces import default_tags, tag_corners


def test_spheres_are_the_objects_geometry(tagged: ObjectModel, elbow: ObjectModel):
    # from the middle of the cube to a tag's corner: half its width across, half a tag's edge along
    middle, own, whole = tag_spheres(tagged)
    np.testing.assert_allclose(middle, 0, atol=1e-12)
    assert own[0] == whole[0] == pytest.approx(np.linalg.norm([0.0524, 0.04, 0.04]))
    _, own, whole = tag_spheres(elbow.with_changes(tags=default_tags(elbow)))
    assert (whole > own + 0.02).all()  # where only one link is seen, the other may be anywhere about it


def test_prediction_is_near_and_holds_the_object_through_the_toss(filmed: Filmed, tagged: ObjectModel):
    """In a toss with its impacts every true corner is in the box, which is a small part of the image."""
    recording, timeline = filmed.recording, filmed.timeline
    camera = recording.cameras[0]
    finder, predictor = TagFinder(camera, tagged), Predictor(camera, tagged)
    corners = np.concatenate([tag_corners(tag) for tag in tagged.tags])
    area, boxes = [], 0
    for file in recording.frames["cam0"][60:200]:
        frame = recording.read(file)
        box = predictor.box(frame.t)
        q = timeline.q[int(np.argmin(np.abs(timeline.t - frame.t)))]
        true = camera.project(transform_points(transform(q[:3], q[3:7]), corners))
        true = np.clip(true, 0, np.array(camera.resolution) - 1)
        found = finder.find(frame)
        if box is not None:
            boxes += 1
            assert (true >= box[:2]).all()
            assert (true <= box[2:]).all()
            area.append((box[2] - box[0]) * (box[3] - box[1]) / np.prod(camera.resolution))
        predictor.see(frame.t, found)
    assert boxes > 130
    assert np.median(area) < 0.15


def test_a_lone_tags_two_poses_are_both_looked_at(tagged: ObjectModel):
    """Nearly straight on, a lone tag is told from its mirrored tilt by noise alone."""
    (camera,) = default_rig(n_cameras=1)
    (tag,) = tagged.tags[:1]
    rng, ways = np.random.default_rng(0), []
    for _ in range(40):
        T = camera.T_world_cam @ transform([0.0, 0.0, 1.4], [0.0, 1.0, 0.0, 0.0])  # facing the camera
        T = T @ transform(np.zeros(3), quat_exp(rng.uniform(-0.2, 0.2, 3)))
        pixels = camera.project(transform_points(T, tag.size / 2 * SQUARE)) + 0.2 * rng.normal(size=(4, 2))
        predictor = Predictor(camera, tagged)
        predictor.see(0.0, [Detection(camera.name, 0.0, tag.id, pixels, alike(0.2))])
        box = predictor.box(0.0)
        assert box is not None
        center = camera.project(transform_points(T @ np.linalg.inv(tag.T_body_tag), np.zeros((1, 3))))[0]
        ways.append(np.abs(center - (np.array(box[:2]) + box[2:]) / 2).max())
        corners = transform_points(
            T @ np.linalg.inv(tag.T_body_tag), np.concatenate([tag_corners(t) for t in tagged.tags])
        )
        true = camera.project(corners)
        assert (true >= box[:2]).all()
        assert (true <= box[2:]).all()
    assert np.max(ways) > 1
