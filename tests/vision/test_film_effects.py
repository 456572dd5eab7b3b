"""Each effect of the synthetic film does what it says, by as much as it says; none of it fools the tracker."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from tests.vision.tosses import thrown
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.rotations import geodesic_angle, quat_exp, transform, transform_points
from tossid.types import Detection, Frame
from tossid.vision.backdrop import KINDS, scatter
from tossid.vision.camera import Camera
from tossid.vision.detect import TagFinder, detect_frames
from tossid.vision.faces import default_tags, tag_corners
from tossid.vision.hand import hand_poses
from tossid.vision.layout import layout_of
from tossid.vision.recording import Recording, RecordingWriter, read_recording
from tossid.vision.render import Renderer, RenderSettings
from tossid.vision.rig import default_rig, look_at
from tossid.vision.shutter import Shutter, poses_at
from tossid.vision.timeline import Filming, FilmTruth, Timeline, make_timeline, render_timeline
from tossid.vision.track import track

DT = 1 / 148
IMAGES = RenderSettings(samples=8)
UNSEEN = np.array([0.0, 0.0, -9.0, 1.0, 0.0, 0.0, 0.0])


def _filmed(
    timeline: Timeline,
    model: ObjectModel,
    cameras: tuple[Camera, ...],
    folder: Path,
    filming: Filming,
    settings: RenderSettings = IMAGES,
) -> tuple[Recording, FilmTruth]:
    with RecordingWriter(folder, cameras, layout_of(model), quality=90) as writer:
        rng = np.random.default_rng(7)
        truth = render_timeline(timeline, model, cameras, writer, rng, settings=settings, filming=filming)
    return read_recording(folder), truth


def _wrongness(detection: Detection, recording: Recording, model: ObjectModel, timeline: Timeline) -> float:
    """Rms distance of a detection's corners from the true ones [px]."""
    q = poses_at(timeline.t, timeline.q, np.array([detection.t]))[0]
    tag = next(tag for tag in model.tags if tag.id == detection.tag_id)
    true = recording.camera(detection.camera).project(transform_points(transform(q[:3], q[3:7]), tag_corners(tag)))
    return float(np.sqrt(np.mean(np.sum((detection.corners - true) ** 2, axis=-1))))


@pytest.fixture(scope="module")
def timeline(tagged: ObjectModel) -> Timeline:
    rng = np.random.default_rng(3)
    return make_timeline([thrown(tagged, rng, longest=0.8)], tagged, rng, start=2.0)


@pytest.fixture(scope="module")
def cameras() -> tuple[Camera, ...]:
    return default_rig(resolution=(480, 384))


def _facing(width: int = 300, height: int = 240) -> Camera:
    """A camera that looks along -x at the height 0.5 m, one metre from the origin's axis."""
    T = look_at([1.0, 1e-9, 0.5], [0.0, 0.0, 0.5])
    return Camera("c", (width, height), [400, 400, (width - 1) / 2, (height - 1) / 2], T_rig_cam=T)


def test_a_rolling_shutter_shifts_rows_by_speed_times_line_time(cube: ObjectModel):
    camera, speed, line = _facing(), 2.0, 2e-5
    renderer = Renderer(cube, [camera], RenderSettings(blur=0.0, noise=0.0, ambient=1.0, samples=64))
    t = np.arange(5) * DT
    q = np.column_stack([np.zeros(5), speed * (t - t[2]), np.full(5, 0.5), np.ones(5), np.zeros((5, 3))])
    rows = np.arange(100, 140)
    empty = renderer.render(UNSEEN, UNSEEN, "c", None).astype(float)
    where = {}
    for shutter in (Shutter(0.0005), Shutter(0.0005, line)):
        image = renderer.draw(shutter.expose(t, q, 2, 240, 64), "c", None).astype(float)
        share = (image - empty) / (225.0 - empty)
        columns = np.arange(300)
        where[shutter.line] = np.array([np.average(columns, weights=share[row]) for row in rows])
    pixels_a_second = 400 * speed / (1 - 0.0524)  # the world's y is the image's x
    expected = pixels_a_second * line * (rows - 119.5)
    shift = where[line] - where[0.0]
    np.testing.assert_allclose(shift, expected, atol=0.15)  # a row's rays are few
    assert np.polyfit(rows, shift, 1)[0] == pytest.approx(pixels_a_second * line, rel=0.05)


def test_tags_lie_where_each_rows_time_puts_them(tagged: ObjectModel, timeline: Timeline, cameras, tmp_path: Path):
    """Corners at the pose of their own row's time are right to a tenth of a pixel; at the frame's they are not."""
    line = 1.4e-5
    flight = slice(timeline.release[0], timeline.release[0] + 40)
    flown = Timeline(timeline.t[flight], timeline.q[flight], (), np.zeros(0), np.zeros(0))
    recording, _ = _filmed(flown, tagged, cameras[:2], tmp_path / "r", Filming(Shutter(0.0005, line)))
    frame, row = [], []
    for d in detect_frames(recording, tagged):
        times = d.t + line * (d.corners[:, 1] - (384 - 1) / 2)
        if times.min() < flown.t[0] or times.max() > flown.t[-1]:
            continue
        frame.append(_wrongness(d, recording, tagged, flown))
        q = poses_at(flown.t, flown.q, times)
        tag = next(tag for tag in tagged.tags if tag.id == d.tag_id)
        world = transform_points(transform(q[:, :3], q[:, 3:7]), tag_corners(tag)[:, None])[:, 0]
        row.append(np.sqrt(np.mean(np.sum((d.corners - recording.camera(d.camera).project(world)) ** 2, axis=-1))))
    fast = np.array(frame) > 0.2
    assert fast.sum() > 8
    assert np.median(np.array(row)[fast]) < 0.12
    assert np.median(np.array(row)) < 0.1
    assert np.median(np.array(frame)[fast]) > 2 * np.median(np.array(row)[fast])


def test_defocus_widens_an_edge_as_a_thin_lens_does(cube: ObjectModel):
    """The line spread of a disc of diameter c is half an ellipse, whose standard deviation is c/4."""
    camera, focus = _facing(), 0.6
    q = np.array([0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0])
    for aperture in (0.0, 0.01, 0.02):
        settings = RenderSettings(blur=0.0, noise=0.0, ambient=1.0, samples=256, aperture=aperture, focus=focus)
        renderer = Renderer(cube, [camera], settings)
        level = renderer.render(q, q, "c", None)[100:140, 150:].astype(float).mean(axis=0)
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


def test_the_plane_in_focus_stays_sharp(tagged: ObjectModel):
    camera = _facing()
    q = np.array([0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0])
    sharp, focused = (
        Renderer(tagged, [camera], RenderSettings(noise=0.0, aperture=a, focus=1 - 0.0524)).render(q, q, "c", None)
        for a in (0.0, 0.03)
    )
    face = (slice(100, 140), slice(130, 170))
    assert np.abs(sharp[face].astype(int) - focused[face]).max() <= 2


def test_glare_lies_where_a_mirror_would_show_the_lamp(tagged: ObjectModel):
    camera = default_rig(n_cameras=1)[0]
    settings = RenderSettings(noise=0.0, blur=0.0, glare=1.0, gloss=3000.0, samples=32)
    lamp = settings.lamp * np.array(settings.light) / np.linalg.norm(settings.light)
    eye = camera.T_world_cam[:3, 3]
    at = np.array([0.0, 0.0, 0.2])
    for _ in range(20):  # the face whose mirror image of the lamp is in its middle
        normal = (lamp - at) / np.linalg.norm(lamp - at) + (eye - at) / np.linalg.norm(eye - at)
        normal /= np.linalg.norm(normal)
        at = np.array([0.02, 0.01, 0.2])
    turn = np.cross([0.0, 0.0, 1.0], normal)
    quat = quat_exp(turn / np.linalg.norm(turn) * np.arcsin(np.linalg.norm(turn)))
    q = np.array([*(at - 0.0524 * normal), *quat])
    plain = Renderer(tagged, [camera], RenderSettings(noise=0.0, blur=0.0, samples=32)).render(q, q, "cam0", None)
    shiny = Renderer(tagged, [camera], settings).render(q, q, "cam0", None)
    added = shiny.astype(float) - plain
    dark = plain < 60  # where nothing saturates
    rows, columns = np.nonzero(dark & (added > 0.5 * added[dark].max()))
    middle = np.average(np.column_stack([columns, rows]), axis=0, weights=added[rows, columns])
    np.testing.assert_allclose(middle, camera.project(at[None])[0], atol=6.0)
    assert added[dark].max() > 100
    found = {d.tag_id for d in TagFinder(camera, tagged).find(Frame("cam0", 0.0, shiny))}
    before = {d.tag_id for d in TagFinder(camera, tagged).find(Frame("cam0", 0.0, plain))}
    assert found <= before


def test_an_offset_clock_is_found_and_reported(tagged: ObjectModel, timeline: Timeline, cameras, tmp_path: Path):
    cameras = cameras[:2]
    recording, _ = _filmed(timeline, tagged, cameras, tmp_path / "r", Filming(clocks={"cam1": 0.012}))
    assert recording.frames["cam1"][0].t_ns == recording.frames["cam0"][0].t_ns + 12_000_000
    poses, report = track(list(detect_frames(recording, tagged)), recording.cameras, tagged)
    assert report.clocks.keys() == {"cam1"}
    assert report.clocks["cam1"][0] == pytest.approx(0.012, abs=2e-4)
    assert np.median(np.linalg.norm(poses.q[:, :3] - poses_at(timeline.t, timeline.q, poses.t)[:, :3], axis=1)) < 3e-4


def test_dropped_frames_are_gone_and_the_others_as_they_were(
    tagged: ObjectModel, timeline: Timeline, cameras, tmp_path: Path
):
    whole, everything = _filmed(timeline, tagged, cameras[:2], tmp_path / "a", Filming())
    part, truth = _filmed(timeline, tagged, cameras[:2], tmp_path / "b", Filming(dropped=0.3))
    assert everything.kept.all()
    assert truth.kept.mean() == pytest.approx(0.7, abs=0.06)
    assert part.n_frames == truth.kept.sum() == truth.n_images
    for c, camera in enumerate(part.cameras):
        stamps = np.array([file.t_ns for file in part.frames[camera.name]]) * 1e-9
        np.testing.assert_allclose(stamps, timeline.t[truth.kept[:, c]], atol=1e-9)
    for file in part.frames["cam1"][:20]:
        twin = next(other for other in whole.frames["cam1"] if other.t_ns == file.t_ns)
        assert file.path.read_bytes() == twin.path.read_bytes()


def test_what_a_hand_hides_is_not_found_and_nothing_is_found_wrong(
    tagged: ObjectModel, timeline: Timeline, cameras, tmp_path: Path
):
    hand, reaches = hand_poses(
        timeline.t,
        timeline.q,
        lift=timeline.lift,
        release=timeline.release,
        rest=timeline.rest,
        holds=True,
        sweeps=1.0,
        cameras=cameras,
        rng=np.random.default_rng(2),
    )
    assert {reach.kind for reach in reaches} == {"holds", "sweeps"}
    release = timeline.t[timeline.release[0]]
    assert all(np.isfinite(hand[(timeline.t >= r.t0) & (timeline.t <= r.t1)]).all() for r in reaches)
    recording, truth = _filmed(timeline, tagged, cameras, tmp_path / "r", Filming(hand=hand))
    renderer = Renderer(tagged, cameras)
    held = np.flatnonzero((timeline.t > release - 0.2) & (timeline.t < release))
    clear = np.array(
        [[renderer.visible(Shutter().expose(timeline.t, timeline.q, i, 384, 8), c.name) for c in cameras] for i in held]
    )
    # it is held, not wrapped up
    assert 0.2 * clear.sum() < truth.visible[held].sum() < 0.8 * clear.sum()
    index = {
        (camera.name, round(t * 1e9)): (i, c) for c, camera in enumerate(cameras) for i, t in enumerate(timeline.t)
    }
    detections = list(detect_frames(recording, tagged))
    shares = []
    for d in detections:
        i, c = index[d.camera, round(d.t * 1e9)]
        shares.append(truth.visible[i, c, d.tag_id])
        assert _wrongness(d, recording, tagged, timeline) < 2.0
    assert min(shares) > 0.6  # a tag can spare a little of its edge
    poses, _ = track(detections, recording.cameras, tagged)
    true = poses_at(timeline.t, timeline.q, poses.t)
    off = poses.q[:, :3] - true[:, :3]
    assert np.linalg.norm(off, axis=1).max() < 0.01
    nees = np.einsum("ni,nij,nj->n", off, np.linalg.inv(poses.q_cov[:, :3, :3]), off) / 3
    assert nees.max() < 12.0  # a pose that is less sure says so
    assert nees.mean() < 1.6
    assert np.rad2deg(geodesic_angle(poses.q[:, 3:7], true[:, 3:7])).max() < 4.0


def test_clutter_gives_no_false_tag(tagged: ObjectModel, timeline: Timeline, cameras, tmp_path: Path):
    own = frozenset(tag.id for tag in tagged.tags)
    litter = scatter(24, np.random.default_rng(1), area=1.0, own_ids=own)
    assert {thing.kind for thing in litter} == set(KINDS)
    assert own.isdisjoint({thing.tag_id for thing in litter if thing.tag_id is not None})
    settings = RenderSettings(samples=8, texture=25.0, litter=litter)
    part = Timeline(timeline.t[::4], timeline.q[::4], (), np.zeros(0), np.zeros(0))
    recording, _ = _filmed(part, tagged, cameras, tmp_path / "r", Filming(), settings)
    tally: Counter[str] = Counter()
    found = list(detect_frames(recording, tagged, tally=tally))
    assert {d.tag_id for d in found} <= own
    assert max(_wrongness(d, recording, tagged, part) for d in found) < 2.0
    assert tally["rejected: id not on the object"] > 0
    everything = list(detect_frames(recording, None))
    strange = {thing.tag_id for thing in litter if thing.kind == "tag"}
    assert len(strange & {d.tag_id for d in everything}) >= 2  # they can be read


def test_visible_shares_are_those_of_the_picture(elbow: ObjectModel):
    """Seen along y with the hinge at zero, the second link's near face is hidden and the first one's is not."""
    model = elbow.with_changes(tags=default_tags(elbow))
    camera = Camera("c", (640, 512), [900, 900, 320, 256], T_rig_cam=look_at([0.0, -0.8, 0.3001], [0.0, 0.0, 0.3]))
    renderer = Renderer(model, [camera])
    q = np.array([0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0, 0.0])
    exposure = Shutter().expose(np.array([0.0, DT]), np.stack([q, q]), 0, 512, 16)
    shares = dict(zip([tag.id for tag in model.tags], renderer.visible(exposure, "c"), strict=True))
    assert shares[3] == 1.0
    assert shares[9] == 0.0
    assert all(0 <= share <= 1 for share in shares.values())
    aside = q + np.array([camera.T_world_cam[0, 3] + 0.8 * 320 / 900, 0, 0, 0, 0, 0, 0, 0])  # on the image's edge
    exposure = Shutter().expose(np.array([0.0, DT]), np.stack([aside, aside]), 0, 512, 16)
    assert 0.2 < renderer.visible(exposure, "c")[3] < 0.8


def test_what_cannot_be_filmed_is_refused(tagged: ObjectModel, timeline: Timeline, cameras, tmp_path: Path):
    class Flat:
        def render(self, q0, q1, camera, rng):
            return np.zeros((384, 480), dtype=np.uint8)

    with pytest.raises(InputError, match="384 rows follow each other"):
        _filmed(timeline, tagged, cameras, tmp_path / "r", Filming(Shutter(0.001, 1e-4)))
    with pytest.raises(InputError, match="before zero"):
        _filmed(timeline, tagged, cameras, tmp_path / "r", Filming(clocks={"cam0": -3.0}))
    writer, shutter = RecordingWriter(tmp_path / "w", cameras, layout_of(tagged)), Filming(Shutter(0.001, 1e-6))
    with writer, pytest.raises(InputError, match="neither a rolling shutter nor a hand"):
        rng = np.random.default_rng(0)
        render_timeline(timeline, tagged, cameras, writer, rng, renderer=Flat(), filming=shutter)
    with pytest.raises(InputError, match="focus"):
        RenderSettings(focus=0.0)
