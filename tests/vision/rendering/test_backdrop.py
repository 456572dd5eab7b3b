"""Prints on the ground that resemble tags give no false tag."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from tests.vision.films import corner_rms, film_of
from tossid.objects import ObjectModel
from tossid.settings.rendering import RenderSettings
from tossid.synthesis.timeline import Filming, Timeline
from tossid.vision.detection.detect import detect_frames
from tossid.vision.rendering.backdrop import KINDS, scatter


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
