"""`tossid.ingest`: films and tracked poses become the same kind of dataset."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tossid
from tests.vision.conftest import Filmed
from tests.vision.tosses import thrown
from tossid.errors import ConfigError, FileError
from tossid.ingestion.ingest import ingest_source
from tossid.ingestion.progress import IngestWarning, Progress
from tossid.objects import ObjectModel
from tossid.store import read_dataset, write_tum
from tossid.types import Phase, PoseTrack, Toss
from tossid.vision.recordings.formats.frames import FramesSource


@pytest.fixture(scope="module")
def tosses(cube: ObjectModel) -> tuple[Toss, ...]:
    rng = np.random.default_rng(8)
    return tuple(thrown(cube, rng, name=f"{i}") for i in range(5))


@pytest.fixture
def tum(tmp_path: Path, tosses: tuple[Toss, ...]) -> Path:
    write_tum(tmp_path / "tum", tosses)
    return tmp_path / "tum"


def test_a_film_becomes_tosses_in_a_file_or_in_memory(filmed: Filmed, tagged: ObjectModel, tmp_path: Path) -> None:
    folder, out = filmed.recording.folder, tmp_path / "data" / "tosses.h5"
    seen: list[Progress] = []
    dataset = tossid.ingest(folder, object=tagged, out=out, progress=seen.append)
    assert len(dataset.tosses) == 2
    found = ingest_source(FramesSource(path=folder), object=tagged)
    for one, again, read in zip(dataset.tosses, found.dataset.tosses, read_dataset(out).tosses, strict=True):
        for name in ("t", "q", "v", "q_cov", "v_cov", "phase"):
            np.testing.assert_array_equal(getattr(one, name), getattr(again, name))
            np.testing.assert_array_equal(getattr(one, name), getattr(read, name))
        assert one.split == again.split == read.split != ""
    true = filmed.timeline
    for toss in dataset.tosses:
        index = np.abs(true.t[:, None] - toss.t).argmin(axis=0)
        assert np.linalg.norm(toss.q[:, :3] - true.q[index, :3], axis=1).max() < 2e-3
    report = found.report
    assert report.detect["tags"] == dataset.provenance["n_detections"] > 0
    assert report.track.n_poses == dataset.provenance["n_poses"] > 100
    assert report.ground is None  # two tosses have too few rests for a plane
    assert "resting" in {stretch.reason for stretch in report.rejected or ()}
    images = [p for p in seen if p.stage == "detect" and not p.message]
    assert sum(p.done for p in images) == images[0].total == filmed.recording.n_frames
    assert sorted(path.name for path in out.parent.iterdir()) == ["tosses.h5"]


def test_a_format_is_recognized_and_keys_reach_its_settings(tum: Path, tosses: tuple[Toss, ...]) -> None:
    dataset = tossid.ingest(tum, splits=(1.0, 0.0, 0.0))
    assert dataset.source == "tum"
    assert dataset.object.name == "cube"
    assert {toss.split for toss in dataset.tosses} == {"train"}
    for one, true in zip(dataset.tosses, tosses, strict=True):
        flight = one.phase == Phase.FLIGHT
        assert np.median(np.abs(one.v[flight, :3] - true.v[: len(one)][flight, :3])) < 0.02


def test_what_cannot_be_ingested_is_named(tum: Path, tmp_path: Path) -> None:
    with pytest.raises(FileError, match="no such file"):
        tossid.ingest(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileError, match="holds no input that is recognized; expected one of contactnets, frames"):
        tossid.ingest(tmp_path / "empty")
    with pytest.raises(ConfigError, match="there is no format 'tumm'"):
        tossid.ingest(tum, source="tumm")
    with pytest.raises(ConfigError, match="gravty"):
        tossid.ingest(tum, gravty=9.0)
    with pytest.raises(FileError, match="no such file or folder"):
        tossid.ingest(tmp_path / "nowhere", source="tum")


def test_problems_are_warnings_and_tosses_with_defects_can_be_set_aside(
    tmp_path: Path, tosses: tuple[Toss, ...]
) -> None:
    """One toss hangs in the air for a tenth of a second, which neither gravity nor contact explains."""
    fast = tosses[0]
    write_tum(tmp_path / "tum", tosses)
    q = fast.q.copy()
    q[10:25, :3] = q[10, :3]
    write_tum(tmp_path / "tum", [PoseTrack(fast.name, fast.t, q)])
    with pytest.warns(IngestWarning, match="1 of 5 tosses have defects"):
        dataset = tossid.ingest(tmp_path / "tum", defects="set_aside")
    assert [toss.name for toss in dataset.tosses if not toss.split] == [fast.name]
