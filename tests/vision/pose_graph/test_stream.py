"""Tracking piece by piece: the same as in one go, in memory that does not grow with the recording."""

from __future__ import annotations

import tempfile
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from tests.vision.sights import nees, sights, tangent, tumble
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.settings.tracking import StreamSettings, TrackSettings
from tossid.types import PoseTrack
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.stream import track_stream
from tossid.vision.pose_graph.track import track_scene
from tossid.vision.recordings.disk_buffer import DetectionSpool
from tossid.vision.setup.layout import layout_of

SHORT = StreamSettings(piece=0.8, disorder=0.2, border=0.1)
PIECES = TrackSettings(stream=SHORT)
"""Of short pieces."""
STRETCHES = TrackSettings(stream=replace(SHORT, whole_frames=200, stretches=4, stretch_frames=50))
"""And of recordings that are soon long."""


def test_pieces_give_what_the_whole_gives(tagged: ObjectModel) -> None:
    rng, cameras, layout = np.random.default_rng(0), default_rig(), layout_of(tagged)
    t, q = tumble(300, rng)
    detections = list(sights(cameras, tagged, t, q, rng))
    late = sorted(detections, key=lambda d: d.t + 0.05 * rng.random())  # not quite in order
    whole, pieces = track_scene(detections, cameras, layout), track_stream(late, cameras, layout, settings=PIECES)
    a, b = whole.tracks["cube"], pieces.tracks["cube"]
    np.testing.assert_array_equal(a.t, b.t)
    np.testing.assert_allclose(a.q, b.q, atol=1e-9)
    np.testing.assert_allclose(a.q_cov, b.q_cov, rtol=1e-6, atol=1e-12)
    assert pieces.report.n_poses == pieces.report.n_steps == 300
    assert pieces.report.rms == pytest.approx(whole.report.rms)
    assert pieces.report.rms_by_camera == pytest.approx(whole.report.rms_by_camera)
    assert pieces.report.rms_by_tag == pytest.approx(whole.report.rms_by_tag, rel=0.05)
    assert len(pieces.frames.t) == len(whole.frames.t)
    assert [row[:2] for row in pieces.report.worst_frames] == [row[:2] for row in whole.report.worst_frames]


@pytest.mark.slow
def test_memory_does_not_grow_with_the_recording(tagged: ObjectModel) -> None:
    cameras, layout = default_rig(), layout_of(tagged)
    _, once = tumble(100, np.random.default_rng(1))
    peaks = []
    for n in (200, 400):
        rng = np.random.default_rng(1)
        # there and back, so that pieces are alike
        t, q = np.arange(n) / 148, np.tile(np.concatenate([once, once[::-1]]), (n // 200, 1))
        tracemalloc.start()
        found = track_stream(sights(cameras, tagged, t, q, rng), cameras, layout, settings=PIECES)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert len(found.tracks["cube"].t) == n
    # a pose with its covariance and what the report keeps of three frames are half a kilobyte; a whole scene takes 17
    assert peaks[1] - peaks[0] < 200 * 4000


def test_a_gap_in_detections_does_not_end_the_track(tagged: ObjectModel) -> None:
    rng, cameras = np.random.default_rng(2), default_rig()
    t, q = tumble(120, rng)
    t = np.where(np.arange(120) < 60, t, t + 7.0)
    found = track_stream(sights(cameras, tagged, t, q, rng), cameras, layout_of(tagged), settings=PIECES)
    track = found.tracks["cube"]
    assert len(track.t) == 120
    assert np.abs(tangent(track, q)[:, :3]).max() < 2e-3
    with pytest.raises(InputError, match="nothing to track"):
        track_stream([], cameras, layout_of(tagged), settings=PIECES)


LOOSE = 1e-8 * np.eye(6)


@pytest.mark.parametrize(
    ("late", "n", "settings", "change"),
    [
        (1.3, 400, PIECES, {}),  # further apart than a piece is long
        (1.3, 400, STRETCHES, {"T_rig_cam": None}),
        (0.0405, 500, STRETCHES, {"T_rig_cam_cov": LOOSE}),
    ],
)
def test_a_clock_is_found_once_and_taken_off_all_pieces(
    tagged: ObjectModel, late: float, n: int, settings: TrackSettings, change: dict[str, np.ndarray | None]
) -> None:
    """Of detections that come once, in the order of their time stamps."""
    rng, cameras = np.random.default_rng(9), default_rig(n_cameras=2)
    t, q = tumble(n, rng)
    stamped = [d for c in (0, 1) for d in sights(cameras[c : c + 1], tagged, t, q, rng, late=late * c)]
    stamped.sort(key=lambda d: d.t)
    cameras = (cameras[0], replace(cameras[1], **change))
    found = track_stream(iter(stamped), cameras, layout_of(tagged), settings=settings)
    assert found.report.clocks["cam1"][0] == pytest.approx(late, abs=2e-4)
    assert found.report.sightings == {c: sum(d.camera == c for d in stamped) for c in ("cam0", "cam1")}
    assert sum(sum(reasons.values()) for reasons in found.report.left_out.values()) < 0.02 * len(stamped)
    track = found.tracks["cube"]
    assert len(track.t) > 0.97 * n
    truth = q[np.clip(np.round(track.t * 148).astype(int), 0, len(q) - 1)]
    assert np.median(np.linalg.norm(track.q[:, :3] - truth[:, :3], axis=1)) < 1e-3


@pytest.mark.parametrize("known", [True, False])
def test_poses_are_handed_on_as_they_are_found(tagged: ObjectModel, known: bool) -> None:
    """Piece by piece, or, of what is tracked as a whole, at its end; the same poses."""
    rng, cameras, layout = np.random.default_rng(5), default_rig(), layout_of(tagged)
    t, q = tumble(300 if known else 60, rng)
    detections = list(sights(cameras, tagged, t, q, rng))
    if not known:
        body = layout.bodies[-1]
        body = replace(body, tags=(replace(body.tags[0], T_body_tag=None), *body.tags[1:]))
        layout = replace(layout, bodies=(*layout.bodies[:-1], body))
    parts: list[PoseTrack] = []
    settings = replace(PIECES, clocks=False)
    whole = track_stream(detections, cameras, layout, settings=settings).tracks["cube"]
    found = track_stream(detections, cameras, layout, settings=settings, keep=lambda body, part: parts.append(part))
    assert found.tracks == {}
    assert found.report.n_poses == len(whole.t)
    assert len(parts) > 1 if known else len(parts) == 1
    np.testing.assert_array_equal(np.concatenate([part.q for part in parts]), whole.q)
    assert (np.sum(whole.q[1:, 3:7] * whole.q[:-1, 3:7], axis=1) > 0).all()


@pytest.mark.parametrize("what", ["cameras", "tags"])
def test_a_long_recording_is_calibrated_by_stretches_of_it(tagged: ObjectModel, what: str) -> None:
    """Poses as good as tracked in one go, covariances that hold, and what is static within its own deviations."""
    rng, true = np.random.default_rng(6), default_rig()
    t, q = tumble(300, rng)
    detections = list(sights(true, tagged, t, q, rng))
    cameras, layout, body = true, layout_of(tagged), layout_of(tagged).bodies[-1]
    if what == "cameras":
        cameras = (true[0], *(replace(camera, T_rig_cam=None) for camera in true[1:]))
    else:
        unknown = [replace(tag, T_body_tag=None) for tag in body.tags[1:]]
        layout = replace(layout, bodies=(*layout.bodies[:-1], replace(body, tags=(body.tags[0], *unknown))))
    settings = replace(STRETCHES, clocks=False)
    whole = track_scene(detections, cameras, layout, settings=settings).tracks["cube"]
    with tempfile.TemporaryFile() as file:
        found = track_stream(DetectionSpool(iter(detections), file), cameras, layout, settings=settings)
    track = found.tracks["cube"]
    assert found.report.n_poses == found.report.n_steps == len(track.t) == 300
    errors = [np.linalg.norm(tangent(one, q)[:, :3], axis=1) for one in (whole, track)]
    assert np.median(errors[0]) < 3e-4
    assert np.median(errors[1]) < 2.0 * np.median(errors[0])  # the stretches are 200 of 300 frames
    assert np.percentile(errors[1], 95) < 2.0 * np.percentile(errors[0], 95)
    assert 0.5 < np.mean(nees(track, q)) < 3  # all frames share one draw of the calibration's error
    if what == "cameras":
        for camera, truth in zip(found.cameras[1:], true[1:], strict=True):
            moved = found.report.cameras[camera.name]
            assert moved.distance is None  # against what was given, not against what the stretches found
            off = np.linalg.norm(camera.T_rig_cam[:3, 3] - truth.T_rig_cam[:3, 3])
            assert off < 5 * moved.sigma < 2e-3
    else:
        assert set(found.report.tags) == {tag.id for tag in body.tags[1:]}
        for tag, truth in zip(found.layout.bodies[-1].tags, body.tags, strict=True):
            assert np.abs(tag.T_body_tag - truth.T_body_tag).max() < 3e-3
