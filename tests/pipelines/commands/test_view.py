"""`tossid view`: contact sheets and Rerun files, and calls that show nothing."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from pipelines.cli import app
from pipelines.commands import view
from pipelines.commands.view import sheet_of
from pipelines.drawing.recording_view import ViewContent
from tests.pipelines.conftest import one_line
from tossid.errors import InputError
from tossid.vision.detection.contact_sheet import FOUND, PLACED


def test_a_sheet_marks_what_was_found(content: ViewContent) -> None:
    sheet = sheet_of(content, 3).astype(int)
    assert 900 < sheet.shape[1] < 1100
    for colour in (FOUND, PLACED):
        assert (np.abs(sheet - colour).max(axis=-1) < 40).sum() > 300
    nothing = ViewContent("n", content.cameras, content.layout, content.recording, content.frames)
    bare = sheet_of(nothing, 3).astype(int)
    assert bare.shape == sheet.shape
    marked = np.abs(sheet - FOUND).max(axis=-1) < 10
    assert (np.abs(bare - FOUND).max(axis=-1) < 10).sum() < 0.3 * marked.sum()  # the legend's alone


def test_detections_without_images_are_drawn_too(content: ViewContent) -> None:
    bare = replace(content, recording=None, frames=None)
    sheet = sheet_of(bare, 3).astype(int)
    assert (np.abs(sheet - FOUND).max(axis=-1) < 40).sum() > 300
    assert (np.abs(sheet - 150).max(axis=-1) < 3).mean() > 0.3  # the pictures are empty
    with pytest.raises(InputError, match="no frames and no detections"):
        sheet_of(replace(bare, detections=()), 3)


def test_a_sheet_needs_no_rerun(late_film: Path, monkeypatch: pytest.MonkeyPatch, answer: Any, capfd: Any) -> None:
    monkeypatch.chdir(late_film)
    monkeypatch.setitem(sys.modules, "rerun", None)  # an import that fails
    made = answer("view", "recording=film", "sheet=sheet.png", "moments=2", "start_s=0.3", "seconds=0.4")
    assert made["sheet"] == "sheet.png"
    assert made["out"] is None
    assert cv2.imread("sheet.png").shape[1] >= 760
    assert app.run(["view", "recording=film", "--quiet"]) == 2
    line = one_line(capfd.readouterr().err)
    assert "pip install 'tossid[view]'" in line
    assert "sheet=" in line


def test_the_viewer_listens_on_loopback_alone(
    late_film: Path, monkeypatch: pytest.MonkeyPatch, answer: Any, tmp_path: Path
) -> None:
    started: list[list[str]] = []
    rerun_file = SimpleNamespace(
        need_rerun=lambda: None, write_rerun=lambda content, path, **more: path.write_bytes(b"RRF") or 0
    )
    monkeypatch.setitem(sys.modules, "pipelines.drawing.rerun_file", rerun_file)
    monkeypatch.setattr(view.subprocess, "Popen", lambda args, **more: started.append(args))
    monkeypatch.chdir(late_film)
    out = str(tmp_path / "film.rrd")
    answer("view", "recording=film", f"out={out}", "open=true", "every=50")
    assert started == [[sys.executable, "-m", "rerun", "--bind", "127.0.0.1", out]]
