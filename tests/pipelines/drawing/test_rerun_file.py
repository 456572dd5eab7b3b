"""A Rerun file holds all that there is to see."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from pipelines.drawing.recording_view import ViewContent
from pipelines.drawing.rerun_file import need_rerun
from tossid.errors import InputError


def test_the_module_imports_without_rerun_and_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)  # an import that fails
    with pytest.raises(InputError, match=r"pip install 'tossid\[view\]'"):
        need_rerun()


def test_a_rerun_file_holds_it_all(
    late_film: Path, content: ViewContent, monkeypatch: pytest.MonkeyPatch, answer: Any
) -> None:
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    monkeypatch.chdir(late_film)
    made = answer("view", "recording=film", "out=film.rrd", "every=5", "seconds=0.8")
    reader = RrdReader("film.rrd")
    rows: dict[str, int] = {}
    for chunk in reader.stream():
        rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + chunk.num_rows
    assert len(reader.blueprints()) == 1
    for camera in ("cam0", "cam1"):
        images = rows[f"/world/{camera}/found"]
        assert images == pytest.approx(0.8 * 148 / 5, abs=2)
        assert rows[f"/world/{camera}"] == images + 1  # and its lens and pose
    assert made["n_images"] == rows["/world/cam0/found"] + rows["/world/cam1/found"]
    assert rows["/world/cube"] == rows["/world/uncertainty/cube"] == made["n_poses"]["cube"]
    assert {f"/world/cube/tag_{tag}/code" for tag in range(6)} <= rows.keys()
    assert {"/world/path/cube", "/toss", "/phase", "/plots/height_m/cube"} <= rows.keys()


def test_a_rerun_file_of_rollouts(made: Path, project: Path, answer: Any) -> None:
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    (run,) = (made / "outputs" / "train").glob("cnrpi-*")
    shutil.copytree(made / "tosses", project / "tosses")
    found = answer("view", f"run={run}", "data=tosses")
    assert found["out"] == "outputs/view/tosses.rrd"
    paths = {chunk.entity_path for chunk in RrdReader(found["out"]).stream()}
    assert {"/world/cube", "/world/predicted/cube/faces", "/world/path/predicted/cube"} <= paths
