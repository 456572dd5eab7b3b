"""Rendered images hold the truth to a small part of a pixel; the optics; what hides tags and what is no tag."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from tests.vision.films import corner_errors, corner_rms, film_of, random_poses, shot
from tossid.errors import InputError, ObjectError
from tossid.objects import ObjectModel, Tag
from tossid.settings.rendering import RenderSettings
from tossid.synthesis.timeline import Filming, Timeline
from tossid.types import Frame
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig, look_at
from tossid.vision.cameras.shutter import Shutter
from tossid.vision.detection.detect import TagFinder, detect_frames
from tossid.vision.rendering.backdrop import KINDS, scatter
from tossid.vision.rendering.hand import hand_poses
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


def test_a_pixel_is_the_mean_over_its_area(tagged: ObjectModel):
    """A face seen straight on covers an area of the image that geometry gives exactly."""
    bare = tagged.with_changes(tags=())
    camera = Camera("c", (200, 200), [300, 300, 100.3, 99.6], T_rig_cam=look_at([1.0, 1e-9, 0.5], [0.0, 0.0, 0.5]))
    settings = RenderSettings(blur=0.0, noise=0.0, ambient=1.0, white=250.0, samples=64)
    renderer = Renderer(bare, [camera], settings)
    image, empty = (shot(renderer, np.array([0, 0, z, 1, 0, 0, 0])) for z in (0.5, -9.0))
    covered = ((image.astype(float) - empty) / (250.0 - empty)).sum()
    width = 300 * 0.1048 / (1.0 - 0.0524)
    assert covered == pytest.approx(width**2, rel=2e-3)


def test_what_cannot_be_drawn_is_refused(tagged: ObjectModel):
    T = np.eye(4)
    T[:3, 3] = [0, 0, 0.2]
    with pytest.raises(ObjectError, match="no flat face"):
        Renderer(tagged.with_changes(tags=(Tag(0, 0.08, 0, T),)), default_rig())
    with pytest.raises(ObjectError, match="600"):
        tag_bitmap(600)
    with pytest.raises(InputError, match="cam7"):
        shot(Renderer(tagged, default_rig()), random_poses(1)[0], "cam7")


DT = 1 / 148


def _facing(width: int = 300, height: int = 240) -> Camera:
    """A camera that looks along -x at the height 0.5 m, one metre from the origin's axis."""
    T = look_at([1.0, 1e-9, 0.5], [0.0, 0.0, 0.5])
    return Camera("c", (width, height), [400, 400, (width - 1) / 2, (height - 1) / 2], T_rig_cam=T)


def test_defocus_widens_an_edge_as_a_thin_lens_does(cube: ObjectModel):
    """The line spread of a disc of diameter c is half an ellipse, whose standard deviation is c/4."""
    camera, focus = _facing(), 0.6
    q = np.array([0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0])
    for aperture in (0.0, 0.01, 0.02):
        settings = RenderSettings(blur=0.0, noise=0.0, ambient=1.0, samples=256, aperture_m=aperture, focus_m=focus)
        renderer = Renderer(cube, [camera], settings)
        level = shot(renderer, q)[100:140, 150:].astype(float).mean(axis=0)
        spread = -np.diff(level[:60])
        columns = np.arange(len(spread))
        keep = np.abs(columns - np.argmax(spread)) < 12
        spread, columns = np.clip(spread[keep], 0, None), columns[keep]
        middle = np.average(columns, weights=spread)
        variance = np.average((columns - middle) ** 2, weights=spread)
        disc = aperture * 400 * abs(1 / (1 - 0.0524) - 1 / focus)
        # a pixel's own width, once by its area and once by the difference
        assert variance == pytest.approx(disc**2 / 16 + 2 / 12, abs=0.05 + 0.04 * disc**2 / 16)
    assert disc > 4


def test_clutter_gives_no_false_tag(tagged: ObjectModel, timeline: Timeline, rig, tmp_path: Path):
    own = frozenset(tag.id for tag in tagged.tags)
    litter = scatter(24, np.random.default_rng(1), area=1.0, own_ids=own)
    assert {thing.kind for thing in litter} == set(KINDS)
    assert own.isdisjoint({thing.tag_id for thing in litter if thing.tag_id is not None})
    settings = RenderSettings(samples=8, texture=25.0, litter=litter)
    part = Timeline(timeline.t[::4], timeline.q[::4], (), np.zeros(0), np.zeros(0))
    recording, _ = film_of(part, tagged, rig, tmp_path / "r", Filming(), settings)
    tally: Counter[str] = Counter()
    found = list(detect_frames(recording, tagged, tally=tally))
    assert {d.tag_id for d in found} <= own
    assert max(corner_rms(d, recording, tagged, part) for d in found) < 2.0
    assert tally["rejected: id not on the object"] > 0
    everything = list(detect_frames(recording, None))
    strange = {thing.tag_id for thing in litter if thing.kind == "tag"}
    assert len(strange & {d.tag_id for d in everything}) >= 2  # they can be read


def test_the_nearer_link_hides_the_farther(elbow: ObjectModel) -> None:
    """With the hinge at zero the links lie side by side along y: seen along y only the first shows its tags."""
    model = elbow.with_changes(tags=default_tags(elbow))
    camera = Camera("c", (640, 512), [900, 900, 320, 256], T_rig_cam=look_at([0.0, -0.8, 0.3001], [0.0, 0.0, 0.3]))
    renderer = Renderer(model, [camera], RenderSettings(noise=0.0))
    q = np.array([0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0, 0.0])
    aside = q + np.array([camera.T_world_cam[0, 3] + 0.8 * 320 / 900, 0, 0, 0, 0, 0, 0, 0])  # on the image's edge
    shares, beside = (
        dict(zip([tag.id for tag in model.tags], renderer.visible(exposure, "c"), strict=True))
        for exposure in (Shutter().expose(np.array([0.0, DT]), np.stack([at, at]), 0, 512, 16) for at in (q, aside))
    )
    ids = {d.tag_id for d in TagFinder(camera, model).find(Frame("c", 0.0, shot(renderer, q)))}
    assert (3 in ids, 9 in ids) == (True, False)  # -y of the first link, and of the second, behind it
    assert (shares[3], shares[9]) == (1.0, 0.0)
    assert 0.2 < beside[3] < 0.8


def test_what_a_hand_hides_is_not_found_and_nothing_is_found_wrong(
    tagged: ObjectModel, timeline: Timeline, rig, tmp_path: Path
):
    hand, reaches = hand_poses(
        timeline.t,
        timeline.q,
        lift=timeline.lift,
        release=timeline.release,
        rest=timeline.rest,
        holds=True,
        sweeps=1.0,
        cameras=rig,
        rng=np.random.default_rng(2),
    )
    assert {reach.kind for reach in reaches} == {"holds", "sweeps"}
    release = timeline.t[timeline.release[0]]
    assert all(np.isfinite(hand[(timeline.t >= r.t0) & (timeline.t <= r.t1)]).all() for r in reaches)
    recording, truth = film_of(timeline, tagged, rig, tmp_path / "r", Filming(hand=hand))
    renderer = Renderer(tagged, rig)
    held = np.flatnonzero((timeline.t > release - 0.2) & (timeline.t < release))
    clear = np.array(
        [[renderer.visible(Shutter().expose(timeline.t, timeline.q, i, 384, 8), c.name) for c in rig] for i in held]
    )
    # it is held, not wrapped up
    assert 0.2 * clear.sum() < truth.visible[held].sum() < 0.8 * clear.sum()
    index = {(camera.name, round(t * 1e9)): (i, c) for c, camera in enumerate(rig) for i, t in enumerate(timeline.t)}
    detections = list(detect_frames(recording, tagged))
    shares = []
    for d in detections:
        i, c = index[d.camera, round(d.t * 1e9)]
        shares.append(truth.visible[i, c, d.tag_id])
        assert corner_rms(d, recording, tagged, timeline) < 2.0
    assert min(shares) > 0.6  # a tag can spare a little of its edge
