"""Prints on the ground that resemble tags give no false tag."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from tests.vision.tosses import thrown
from tossid.objects import ObjectModel
from tossid.rotations import transform, transform_points
from tossid.settings.rendering import RenderSettings
from tossid.synthesis.timeline import Filming, FilmTruth, Timeline, make_timeline, render_timeline
from tossid.types import Detection
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig
from tossid.vision.cameras.shutter import poses_at
from tossid.vision.detection.detect import detect_frames
from tossid.vision.recordings.formats.frames import read_recording
from tossid.vision.recordings.recording import Recording
from tossid.vision.recordings.writing import RecordingWriter
from tossid.vision.rendering.backdrop import KINDS, scatter
from tossid.vision.setup.faces import tag_corners
from tossid.vision.setup.layout import layout_of

IMAGES = RenderSettings(samples=8)


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
