"""The cube with its tags, a rig of small cameras, and one rendered toss that several modules look at."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.once import made_once
from tests.vision.tosses import thrown
from tossid.objects import ObjectModel
from tossid.synthesis.timeline import Timeline, make_timeline, render_timeline
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig
from tossid.vision.recordings.formats.frames import read_recording
from tossid.vision.recordings.recording import Recording
from tossid.vision.recordings.writing import RecordingWriter
from tossid.vision.setup.faces import default_tags
from tossid.vision.setup.layout import layout_of


@pytest.fixture(scope="session")
def tagged(cube: ObjectModel) -> ObjectModel:
    return cube.with_changes(tags=default_tags(cube))


@pytest.fixture(scope="session")
def rig() -> tuple[Camera, ...]:
    return default_rig(resolution=(480, 384))


@pytest.fixture(scope="session")
def timeline(tagged: ObjectModel) -> Timeline:
    """One toss of 0.8 s at the most, from hand to hand."""
    rng = np.random.default_rng(3)
    return make_timeline([thrown(tagged, rng, longest=0.8)], tagged, rng, start=2.0)


@dataclass(frozen=True)
class Filmed:
    recording: Recording
    timeline: Timeline


@pytest.fixture(scope="session")
def filmed(tagged: ObjectModel, rig: tuple[Camera, ...], tmp_path_factory: pytest.TempPathFactory) -> Filmed:
    """Two tosses, three cameras, noise and blur."""
    rng = np.random.default_rng(5)
    timeline = make_timeline([thrown(tagged, rng, name=f"toss_{i}") for i in range(2)], tagged, rng, start=2.0)

    def make(folder: Path) -> None:
        render_timeline(timeline, tagged, rig, RecordingWriter(folder / "recording", rig, layout_of(tagged)), rng)

    return Filmed(read_recording(made_once(tmp_path_factory, "filmed", make) / "recording"), timeline)
