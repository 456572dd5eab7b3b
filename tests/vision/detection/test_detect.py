"""Detection in recordings: prediction, false tags, files between the stages."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tests.vision.conftest import Filmed
from tests.vision.detection.test_search import poster
from tests.vision.films import shot
from tossid.objects import ObjectModel
from tossid.rotations import transform, transform_points
from tossid.settings.ingestion import DetectSettings
from tossid.types import Frame
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig
from tossid.vision.detection import detect
from tossid.vision.detection.detect import UNREFINED_SIGMA, TagFinder, detect_frames, tag_detector
from tossid.vision.rendering.render import Renderer
from tossid.vision.setup.faces import tag_corners
from tossid.vision.setup.layout import Body, BodyTag, TagLayout

TILTED = np.array([0.9, 0.1, 0.3, 0.3])


def _image(model: ObjectModel, camera, position=(0.0, 0.1, 0.2)) -> np.ndarray:
    q = np.array([*position, *(TILTED / np.linalg.norm(TILTED))])
    return shot(Renderer(model, [camera]), q, camera.name)


def test_prediction_finds_what_a_whole_search_finds(filmed: Filmed, tagged: ObjectModel):
    recording = filmed.recording
    camera = recording.cameras[0]
    files = recording.frames["cam0"][70:130]
    whole, near = Counter(), Counter()
    finders = (
        (TagFinder(camera, tagged, DetectSettings(predict=False)), whole),
        (TagFinder(camera, tagged), near),
    )
    for file in files:
        frame = recording.read(file)
        for finder, seen in finders:
            seen.update(d.tag_id for d in finder.find(frame))
    assert sum(near.values()) >= 0.99 * sum(whole.values())
    assert finders[1][0].tally["searched where predicted"] >= 58


def test_threads_change_nothing(filmed: Filmed, tagged: ObjectModel):
    files = filmed.recording.frames.items()
    part = replace(filmed.recording, frames={name: own[:230] for name, own in files})
    one = list(detect_frames(part, tagged, threads=1))
    done: list[int] = []
    tally: Counter[str] = Counter()
    two = list(detect_frames(part, tagged, threads=2, tally=tally, progress=done.append))
    assert sum(done) == part.n_frames == 690
    assert len(one) == len(two) == tally["tags"]
    key = lambda d: (d.t, d.camera, d.tag_id)  # noqa: E731
    for a, b in zip(sorted(one, key=key), sorted(two, key=key), strict=True):
        assert key(a) == key(b)
        np.testing.assert_array_equal(a.corners, b.corners)


def test_a_lost_object_is_found_again(tagged: ObjectModel):
    (camera,) = default_rig(n_cameras=1)
    finder = TagFinder(camera, tagged)
    empty = _image(tagged, camera, (0, 0, -5.0))
    here, there = _image(tagged, camera, (-0.3, 0, 0.2)), _image(tagged, camera, (0.3, 0.2, 0.2))
    seen = [bool(finder.find(Frame("cam0", float(i), image))) for i, image in enumerate((here, empty, there, here))]
    assert seen == [True, False, True, True]


def test_a_tag_cut_by_the_edge_is_not_extrapolated(tagged: ObjectModel):
    """As the object leaves the image, what is found of it is right to a pixel, or is rejected and counted."""
    camera = default_rig(resolution=(480, 384))[0]
    finder = TagFinder(camera, tagged, DetectSettings(predict=False))
    away = camera.T_world_cam[:3, 0]
    for step in np.linspace(0.7, 0.75, 30):
        q = np.array([*(step * away), *(TILTED / np.linalg.norm(TILTED))])
        image = shot(Renderer(tagged, [camera]), q, camera.name)
        for found in finder.find(Frame(camera.name, float(step), image)):
            tag = next(tag for tag in tagged.tags if tag.id == found.tag_id)
            true = camera.project(transform_points(transform(q[:3], q[3:7]), tag_corners(tag)))
            off = np.linalg.norm(found.corners - true, axis=1)
            assert off.max() < max(1.0, 4 * np.sqrt(np.trace(found.corner_cov, axis1=1, axis2=2).max()))
    assert finder.tally["rejected: cut by the image's edge"] > 0


def test_corners_that_cannot_be_refined_say_so(tagged: ObjectModel, monkeypatch: pytest.MonkeyPatch):
    camera = default_rig(resolution=(480, 384))[0]
    monkeypatch.setattr(detect, "refine_corners", lambda image, camera, corners, **_: (corners, None, False))
    sigma = {}
    for refine in (True, False):
        finder = TagFinder(camera, tagged, DetectSettings(predict=False, refine=refine))
        (found, *_) = finder.find(Frame(camera.name, 0.0, _image(tagged, camera)))
        sigma[refine] = float(np.sqrt(found.corner_cov[0, 0, 0]))
    assert sigma[False] == UNREFINED_SIGMA
    assert sigma[True] > 1.0  # steep, half hidden, or against a bright face


@pytest.mark.parametrize("pale", [1.0, 0.15])
def test_the_library_finds_what_it_finds_by_its_own_threshold(tagged: ObjectModel, pale: float):
    """tossid's detector passes over places with less contrast than a wanted tag has."""
    (camera,) = default_rig(n_cameras=1)
    rng, least, margins = np.random.default_rng(0), DetectSettings().min_margin, []
    families = ("tag36h11",)
    with tag_detector(families, 1.0, 0.0) as usual, tag_detector(families, 1.0, least) as ours:
        for x in np.linspace(-0.3, 0.3, 7):
            bright = _image(tagged, camera, (x, 0.1, 0.2)).astype(float)
            level = 100 + pale * (bright - 100) + rng.normal(0, 4, bright.shape)
            image = np.clip(np.round(level), 0, 255).astype(np.uint8)
            wanted, found = (
                {(tag.tag_id, *tag.corners.flat): tag.decision_margin for tag in each.detect(image)
                 if tag.decision_margin >= least}
                for each in (usual, ours)
            )  # fmt: skip
            assert found.keys() == wanted.keys()
            margins += found.values()
    assert len(margins) >= 5
    assert pale > 0.15 or min(margins) < 1.3 * least


def test_tags_that_are_none_of_the_objects_or_seen_twice_are_rejected(tagged: ObjectModel):
    (camera,) = default_rig(n_cameras=1)
    one, two = _image(tagged, camera, (-0.3, -0.2, 0.2)), _image(tagged, camera, (0.3, 0.2, 0.2))
    both = np.where(np.abs(two.astype(int) - _image(tagged, camera, (0, 0, -5.0))) > 12, two, one)
    finder = TagFinder(camera, tagged, DetectSettings(predict=False))
    ids = [d.tag_id for d in finder.find(Frame("cam0", 0.0, both))]
    assert finder.tally["rejected: id seen twice in a frame"] >= 2
    assert len(ids) == len(set(ids))
    all_ids = {d.tag_id for d in TagFinder(camera, tagged).find(Frame("cam0", 0.0, one))}
    gone = min(all_ids)
    fewer = tagged.with_changes(tags=tuple(tag for tag in tagged.tags if tag.id != gone))
    finder = TagFinder(camera, fewer, DetectSettings(predict=False))
    assert {d.tag_id for d in finder.find(Frame("cam0", 0.0, one))} == all_ids - {gone}
    assert finder.tally["rejected: id not on the object"] == 1


def _poster_finder(image: np.ndarray, *listed: BodyTag) -> TagFinder:
    height, width = image.shape
    camera = Camera("c", (width, height), [800, 800, width / 2, height / 2])
    return TagFinder(camera, None, layout=TagLayout((Body("poster", True, tags=listed),)))


def test_tags_of_several_families_are_found_together_and_an_id_of_another_is_rejected():
    tags = {7: "tag36h11", 3: "tag25h9", 12: "tag16h5"}
    image = poster(tags)
    finder = _poster_finder(image, *(BodyTag(tag_id, 0.1, None, family=family) for tag_id, family in tags.items()))
    found = {d.tag_id: d for d in finder.find(Frame("c", 0.0, image))}
    assert set(found) == set(tags)
    for k, tag_id in enumerate(tags):
        low, high = np.array([60 + 240 * k, 100]) - 0.5, np.array([220 + 240 * k, 260]) - 0.5
        np.testing.assert_allclose(found[tag_id].corners.min(axis=0), low, atol=0.05)
        np.testing.assert_allclose(found[tag_id].corners.max(axis=0), high, atol=0.05)
    image = poster({7: "tag36h11", 3: "tag25h9"})
    listed = BodyTag(7, 0.1, None), BodyTag(3, 0.1, None), BodyTag(11, 0.1, None, family="tag25h9")
    finder = _poster_finder(image, *listed)
    assert [d.tag_id for d in finder.find(Frame("c", 0.0, image))] == [7]
    assert finder.tally["rejected: id of another family"] == 1
