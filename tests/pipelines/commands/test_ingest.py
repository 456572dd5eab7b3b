"""`tossid ingest`: the newest recording becomes a dataset, and what was copied or turned is said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.cli import app
from pipelines.demo_page import pose_errors
from pipelines.files.project import newest_dataset, newest_recording
from tossid.store import read_dataset


def test_ingest_finds_the_newest_recording_and_its_tosses(
    film: Path, monkeypatch: pytest.MonkeyPatch, answer: Any
) -> None:
    monkeypatch.chdir(film)
    recording = newest_recording()
    made = answer("ingest")
    assert made["out"] == f"data/datasets/{recording.name}.h5"
    assert newest_dataset() == Path(made["out"])
    info = answer("info", made["out"])
    assert {name: made[name] for name in info} == info
    truth, found = (read_dataset(path) for path in (recording / "truth.h5", Path(made["out"])))
    assert all(np.median(errors) < most for errors, most in zip(pose_errors(truth, found), (0.5, 0.3), strict=True))


def test_copies_and_turns_of_the_real_cube_are_reported_and_undone_where_asked(
    project: Path, shared_data: Path, answer: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = project / "some"
    folder.mkdir()
    for name in [*range(40, 80), 140]:
        path = shared_data / "contactnets_cube" / f"{name}.pt"
        if path.exists():
            (folder / path.name).symlink_to(path)
    keys = ["source=contactnets", f"source.path={folder}", "object=cube", "out=cube.h5"]
    assert app.run(["ingest", *keys, "--quiet"]) == 0
    said = capfd.readouterr().err
    assert "1 toss is a copy of an earlier one, turned about the vertical: 140 of 56 (-169.0°)" in said
    assert "kept, each in the split of its first" in said
    split = {toss.name: toss.split for toss in read_dataset(project / "cube.h5").tosses}
    assert split["140"] == split["56"]
    made = answer("ingest", *keys, "turned=undo", "copies=set_aside")
    assert (made["object"], made["rate_hz"], made["provenance"]["source_path"]) == ("cube", 148.0, str(folder))
    assert made["splits"].get("none") == 1
    back = read_dataset(project / "cube.h5")
    assert {toss.name: toss.split for toss in back.tosses} == {**split, "140": ""}
    assert back.order is not None
    assert np.abs(back.order.turn[:, 1:3]).max() == 0.0  # about the vertical alone
    velocity = np.array([toss.v[0, :2] for toss in back.tosses])
    assert np.abs(np.arctan2(*velocity.T[::-1])).max() < 0.3
