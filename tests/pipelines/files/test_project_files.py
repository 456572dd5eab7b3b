"""Where commands look for recordings, datasets, stages' files, models, and what is kept of an unfinished training."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from pipelines.config.compose import load
from pipelines.config.schemas import IngestConfig
from pipelines.files.datasets import provenance
from pipelines.files.open_source import located, read_track
from pipelines.files.project import dataset_path, named, newest_dataset, newest_recording
from pipelines.files.resume import STATE, Unfinished
from pipelines.tracking.runs import RunRecord
from tossid.errors import ConfigError, FileError, InputError
from tossid.types import PoseTrack
from tossid.vision.recordings.formats.frames import FramesSource
from tossid.vision.recordings.npz import write_tracks


def made(path: Path, at: int) -> Path:
    """A file, in a folder, both of a given age."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("")
    os.utime(path, (at, at))
    os.utime(path.parent, (at, at))
    return path


def test_the_newest_is_the_one_written_last_and_nothing_that_is_being_written(tmp_path: Path) -> None:
    made(tmp_path / "b.h5", 1)
    newest = made(tmp_path / "a.h5", 2)
    made(tmp_path / ".half.h5", 3)
    assert newest_dataset(tmp_path) == newest
    for name, at in (("b", 1), ("a", 2), (".new.tmp-1-00000000", 3)):
        made(tmp_path / name / "cameras.yaml", at)
    assert newest_recording(tmp_path) == tmp_path / "a"
    for find, command in ((newest_recording, "synthesize"), (newest_dataset, "ingest")):
        with pytest.raises(FileError, match=f"make one with 'tossid {command}'"):
            find(tmp_path / "empty")


def test_keys_name_files_and_folders_of_their_kind(project: Path) -> None:
    tosses = made(project / "made" / "tosses.h5", 1)
    assert dataset_path(tosses) == dataset_path(project / "made") == tosses
    with pytest.raises(FileError, match="no such dataset"):
        dataset_path(project / "other.h5")
    assert named("out", Path("a.hdf5"), ".h5", ".hdf5") == Path("a.hdf5")
    with pytest.raises(ConfigError, match=r"out: 'a\.txt' does not end in \.h5.*'a\.h5'"):
        named("out", Path("a.txt"), ".h5", ".hdf5")
    made(project / "data" / "raw" / "mine" / "cameras.yaml", 1)
    assert located(FramesSource()).path == Path("data/raw/mine")
    assert located(FramesSource(path=Path("other"))).path == Path("other")


def test_a_stage_takes_the_one_track(tmp_path: Path) -> None:
    q = np.tile([0.0, 0, 0, 1, 0, 0, 0], (3, 1))
    tracks = [PoseTrack(name, np.arange(3.0), q) for name in ("a", "b")]
    write_tracks(tracks[:1], tmp_path / "one.npz")
    write_tracks(tracks, tmp_path / "two.npz")
    assert read_track(tmp_path / "one.npz").name == "a"
    with pytest.raises(FileError, match="holds 2 tracks, expected one"):
        read_track(tmp_path / "two.npz")
    with pytest.raises(FileError, match="'tossid track' makes it"):
        read_track(tmp_path / "none.npz")


def test_keys_that_leave_the_data_as_they_are_are_no_part_of_where_it_comes_from() -> None:
    keys = ["source=tum", "source.path=a"]
    one, other = (
        provenance("ingest", load("ingest", IngestConfig, [*keys, *more]), {"source_sha256": "ab"})
        for more in (["out=a.h5"], ["out=b.h5", "threads=1"])
    )
    assert one == other
    assert (one["command"], one["source_sha256"]) == ("tossid ingest", "ab")
    assert yaml.safe_load(str(one["config"]))["source"]["path"] == "a"
    assert {"python", "numpy"} <= json.loads(str(one["versions"])).keys()


def test_a_run_without_a_model_is_named(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.pt"
    with pytest.raises(InputError, match=r"run cn-g9.81 \(0123\) has no checkpoint"):
        RunRecord("0123", "cn-g9.81", tmp_path, None).trained_model()
    path.write_bytes(b"no model")
    with pytest.raises(FileError, match=r"checkpoint.pt"):
        RunRecord("0123", "cn-g9.81", tmp_path, path).trained_model()


def test_an_unfinished_training_comes_back_until_it_is_cleared_and_a_damaged_one_is_named(tmp_path: Path) -> None:
    kept, again = (Unfinished(tmp_path / "under_way", code="a") for _ in range(2))
    assert (kept.run(), kept.state(), kept.of_other_code()) == (None, None, False)
    kept.begin("0123")
    kept.save({"weights": torch.arange(3)})
    found = again.state()
    assert found is not None
    assert (again.run(), found["weights"].tolist(), again.of_other_code()) == ("0123", [0, 1, 2], False)
    assert Unfinished(kept.folder, code="b").of_other_code()
    (kept.folder / STATE).write_bytes(b"half")
    with pytest.raises(FileError, match="restart=true starts anew"):
        kept.state()
    torch.save({"schema": "another"}, kept.folder / STATE)
    with pytest.raises(FileError, match="not a training's state of schema"):
        kept.state()
    again.clear()
    assert kept.state() is None
    assert not kept.folder.exists()
