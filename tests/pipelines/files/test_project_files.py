"""Where commands look for recordings, datasets, stages' files, models, and what is kept of an unfinished training."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
import torch
import yaml

from pipelines.commands.ingest import provenance
from pipelines.commands.train import STATE, Unfinished
from pipelines.config.compose import load
from pipelines.config.schemas import IngestConfig
from pipelines.files.open_source import located
from pipelines.files.project import dataset_path, named, newest_dataset, newest_recording
from tossid.errors import ConfigError, FileError
from tossid.vision.recordings.formats.frames import FramesSource


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


def test_an_unfinished_training_comes_back_until_it_is_cleared_and_a_damaged_one_is_named(tmp_path: Path) -> None:
    kept, again = (Unfinished(tmp_path / "under_way", code="a") for _ in range(2))
    assert (kept.recall(), kept.run, kept.state) == (False, None, None)
    kept.save("0123", None)
    assert (again.recall(), again.run, again.state) == (False, "0123", None)
    kept.save("0123", {"weights": torch.arange(3)})
    assert (again.recall(), again.run) == (False, "0123")
    assert again.state is not None
    assert again.state["weights"].tolist() == [0, 1, 2]
    other = Unfinished(kept.folder, code="b")
    assert (other.recall(), other.run) == (True, None)
    (kept.folder / STATE).write_bytes(b"half")
    with pytest.raises(FileError, match="restart=true starts anew"):
        kept.recall()
    torch.save({"schema": "another"}, kept.folder / STATE)
    with pytest.raises(FileError, match="not a training's state of schema"):
        kept.recall()
    again.clear()
    assert not kept.folder.exists()
