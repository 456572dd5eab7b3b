"""Formats are recognized by what lies at a path, and named by their settings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.store.makers import contactnets_rows, pll_rows
from tossid.errors import ConfigError
from tossid.store.importers import TumSource
from tossid.store.importers.registry import Contents
from tossid.vision.recordings.registry import (
    format_named,
    open_recording,
    recognized_format,
)


def _touch(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return folder


@pytest.mark.parametrize(
    ("files", "name"),
    [
        (["cameras.yaml", "frames/cam0/1.jpg"], "frames"),
        (["cameras.yaml", "cam0.mp4"], "video"),
        (["cameras.yaml", "film.bag.bz2"], "rosbag"),
        (["metadata.yaml", "film.db3"], "rosbag"),
        (["0.txt", "0.joints.txt"], "tum"),
        (["notes.md"], None),
    ],
)
def test_a_folder_is_recognized_by_its_files(tmp_path: Path, files: list[str], name: str | None) -> None:
    found = recognized_format(_touch(tmp_path, *files))
    assert (found.name if found else None) == name


def test_tensors_are_told_apart_by_their_columns(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for name, rows in (("contactnets", contactnets_rows(9, rng)), ("pll", pll_rows(9, rng))):
        (tmp_path / name).mkdir()
        torch.save(torch.from_numpy(rows), tmp_path / name / "0.pt")
        found = recognized_format(tmp_path / name)
        assert found.name == name
        assert recognized_format(tmp_path / name, contents=Contents.RECORDING) is None


def test_what_is_no_format_or_no_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="there is no format 'csv'; expected contactnets, frames"):
        format_named("csv")
    with pytest.raises(ConfigError, match="tum holds tracked poses"):
        open_recording(TumSource(path=tmp_path))
