"""What is newest in a project folder, and how a dataset is named."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pipelines.files.project import check_dataset_name, dataset_path, newest_dataset, newest_recording
from tossid.errors import ConfigError, FileError


def made(path: Path, at: int) -> Path:
    """A file of a given age."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("")
    os.utime(path, (at, at))
    return path


def test_the_newest_dataset_is_the_one_written_last(tmp_path: Path) -> None:
    made(tmp_path / "b.h5", 1)
    newest = made(tmp_path / "a.h5", 2)
    made(tmp_path / ".half.h5", 3)
    assert newest_dataset(tmp_path) == newest


def test_the_newest_recording_is_the_folder_that_changed_last(tmp_path: Path) -> None:
    for name, at in (("b", 1), ("a", 2)):
        made(tmp_path / name / "cameras.yaml", at)
        os.utime(tmp_path / name, (at, at))
    assert newest_recording(tmp_path) == tmp_path / "a"


def test_where_there_is_none_the_way_to_one_is_said(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="make one with 'tossid synthesize'"):
        newest_recording(tmp_path)
    with pytest.raises(FileError, match="make one with 'tossid ingest'"):
        newest_dataset(tmp_path)


def test_a_key_names_a_file_or_the_folder_that_synthesize_wrote(tmp_path: Path) -> None:
    tosses = made(tmp_path / "made" / "tosses.h5", 1)
    assert dataset_path(tosses) == dataset_path(tmp_path / "made") == tosses
    with pytest.raises(FileError, match="no such dataset"):
        dataset_path(tmp_path / "other.h5")


def test_a_dataset_ends_in_h5() -> None:
    assert check_dataset_name("out", Path("a.h5")) == Path("a.h5")
    with pytest.raises(ConfigError, match=r"does not end in .h5.*'a.h5'"):
        check_dataset_name("out", Path("a.txt"))


def test_a_recording_that_is_being_written_is_not_the_newest(tmp_path: Path) -> None:
    for name in ("old", ".new.tmp-1-00000000"):
        (tmp_path / "data" / "raw" / name).mkdir(parents=True)
        (tmp_path / "data" / "raw" / name / "cameras.yaml").write_text("")
    assert newest_recording(tmp_path / "data" / "raw") == tmp_path / "data" / "raw" / "old"
