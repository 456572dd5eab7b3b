"""What is drawn of recordings, datasets, runs and gaps is what they hold; contact sheets and Rerun files."""

from __future__ import annotations

import itertools
import json
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from pipelines.cli import app
from pipelines.cli.console import Console
from pipelines.commands import view
from pipelines.commands.view import happening, sheet_of
from pipelines.config.compose import load
from pipelines.config.schemas import ViewConfig
from pipelines.drawing.recording_view import ViewContent, faces_in_view, misplaced, recording_content
from pipelines.drawing.toss_view import in_a_row, toss_content
from tests.pipelines.conftest import one_line
from tossid.errors import FileError
from tossid.motion import frames_in_flight
from tossid.objects import to_mjcf
from tossid.rotations import geodesic_angle
from tossid.store import read_dataset
from tossid.vision.cameras.shutter import poses_at
from tossid.vision.detection.contact_sheet import FOUND, PLACED
from tossid.vision.recordings.npz import read_tracks


def test_a_recording_is_shown_as_it_was(film: Path, content: ViewContent) -> None:
    """The tracked body follows the truth, and is drawn over its tags in both cameras, late clock or not."""
    (truth,) = read_tracks(film / "film" / "truth_poses.npz")
    (body,) = content.moving
    true = poses_at(truth.t, truth.q, body.t)
    assert np.median(np.linalg.norm(body.p - true[:, :3], axis=1)) < 3e-4
    assert np.rad2deg(np.median(geodesic_angle(body.quat, true[:, 3:7]))) < 0.2
    assert len(content.tosses) == 1
    assert len(body.polygons) == len(body.tags) == 6
    off: dict[str, list[float]] = {"cam0": [], "cam1": []}
    for camera in content.cameras:
        for file in content.frames[camera.name][::7]:
            found = [d for d in content.detections if d.camera == camera.name and abs(d.t - file.t_ns * 1e-9) < 1e-6]
            error = misplaced(content, camera, found) if found else None
            if error is None:
                continue
            off[camera.name].append(error)
            outlines = faces_in_view(content, camera, file.t_ns * 1e-9)
            assert 1 <= len(outlines) <= 3
            for d in found:  # each tag lies within one of the outlines
                assert any(
                    all(
                        cv2.pointPolygonTest(o.astype(np.float32), (float(x), float(y)), True) > -1
                        for x, y in d.corners
                    )
                    for o in outlines
                )
    assert all(len(errors) > 5 and np.median(errors) < 0.2 for errors in off.values())
    release = content.tosses[0].t[0]
    assert happening(content, release - 0.05) == ""
    assert happening(content, release + 0.02).endswith("flight")


def test_stages_files_are_shown_where_there_are_some(film: Path, tmp_path: Path, monkeypatch: Any, answer: Any) -> None:
    """Their clocks too: `track` leaves them in its set-up."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(film / "film", tmp_path / "film")
    answer("detect", "recording=film")
    answer("track", "recording=film")
    monkeypatch.setattr("pipelines.drawing.recording_view.stages.detect", None)
    monkeypatch.setattr("pipelines.drawing.recording_view.stages.track", None)
    seen = recording_content(load("view", ViewConfig, ["recording=film"]), Console(quiet=True))
    late = {camera.name: camera.clock_offset for camera in seen.cameras}
    assert late["cam1"] - late["cam0"] == pytest.approx(0.02, abs=3e-4)
    times = [[file.t_ns * 1e-9 for file in files] for files in seen.frames.values()]
    np.testing.assert_allclose(times[0], times[1], atol=4e-4)
    (tmp_path / "film" / "cameras.yaml").touch()  # a newer recording of the same name: its stages are not there yet
    with pytest.raises(TypeError, match="NoneType"):
        recording_content(load("view", ViewConfig, ["recording=film"]), Console(quiet=True))


def test_a_rerun_file_holds_it_all(
    film: Path, content: ViewContent, monkeypatch: pytest.MonkeyPatch, answer: Any
) -> None:
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    monkeypatch.chdir(film)
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


def test_tosses_and_rollouts_are_shown_one_after_another(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(made)
    dataset = read_dataset(made / "tosses" / "tosses.h5")
    row = in_a_row(dataset.tosses)
    assert all(a.t[-1] < b.t[0] for a, b in itertools.pairwise(row))
    np.testing.assert_allclose(np.diff(row[3].t), np.diff(dataset.tosses[3].t), atol=1e-12)
    everything = toss_content(load("view", ViewConfig, ["data=tosses"]), Console(quiet=True))
    assert len(everything.tosses) == len(dataset.tosses)
    assert sum(len(toss) for toss in dataset.tosses) == len(everything.moving[0].t)
    (run,) = (made / "outputs" / "train").glob("cnrpi-*")
    seen = toss_content(load("view", ViewConfig, [f"run={run}"]), Console(quiet=True))
    assert [toss.name for toss in seen.tosses] == [toss.name for toss in dataset.of_split("test")]
    measured, predicted = seen.moving[0], seen.predicted["predicted"][0]
    for toss in seen.tosses:  # a rollout starts where its toss does
        i, j = (int(np.argmin(np.abs(body.t - toss.t[0]))) for body in (measured, predicted))
        assert np.linalg.norm(measured.p[i] - predicted.p[j]) < 2e-3


def test_a_gap_is_shown_with_its_simulators(made: Path, tmp_path: Path) -> None:
    """Tosses of the stated object in rigid contact: both simulators follow them through their flight."""
    dataset = read_dataset(made / "tosses" / "tosses.h5")
    report = {
        "schema": "tossid.gap/1",
        "simulator": {"sim": "nominal", "about": "the stated cube"},
        "data": {"path": str(made / "tosses" / "tosses.h5")},
        "gap": {"total": {"value": 3.2, "unit": "standard deviations of noise"}},
        "explanation": {"verdict": "partly_explained"},
        "change": [{"name": "friction", "parameter": "mu", "from": 0.18, "to": 0.3}],
        "patch": {"mjcf": to_mjcf(dataset.object, timestep=4e-4)},
    }
    (tmp_path / "gap.json").write_text(json.dumps(report))
    seen = toss_content(load("view", ViewConfig, [f"gap={tmp_path}"]), Console(quiet=True))
    assert "**partly explained**" in seen.notes
    assert "- friction mu: 0.18, found 0.3" in seen.notes
    assert seen.predicted.keys() == {"stated", "patched"}
    (measured,) = seen.moving
    for (predicted,) in seen.predicted.values():
        assert len(predicted.t) == len(measured.t)
        for toss in seen.tosses:
            flight = (measured.t >= toss.t[0]) & (measured.t <= toss.t[frames_in_flight([toss], dataset.object)[0] - 1])
            assert np.linalg.norm(predicted.p[flight] - measured.p[flight], axis=1).max() < 4e-3
    with pytest.raises(FileError, match="no gap report"):
        toss_content(load("view", ViewConfig, [f"gap={made / 'tosses'}"]), Console(quiet=True))


def _of_colour(figure: Figure, colour: str) -> int:
    """How many pixels of a figure have a colour, to within 10 levels."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3] / 255
    return int((np.abs(pixels - to_rgb(colour)).max(axis=-1) < 0.04).sum())


def test_a_sheet_marks_what_was_found(content: ViewContent) -> None:
    sheet = sheet_of(content, 3)
    nothing = ViewContent("n", content.cameras, content.layout, content.recording, content.frames)
    bare = sheet_of(nothing, 3)
    np.testing.assert_array_equal(bare.get_size_inches(), sheet.get_size_inches())
    assert _of_colour(sheet, PLACED) > 300
    assert _of_colour(bare, FOUND) < 0.3 * _of_colour(sheet, FOUND)  # the legend's alone


def test_a_sheet_needs_no_rerun(film: Path, monkeypatch: pytest.MonkeyPatch, answer: Any, capfd: Any) -> None:
    monkeypatch.chdir(film)
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
    film: Path, monkeypatch: pytest.MonkeyPatch, answer: Any, tmp_path: Path
) -> None:
    started: list[list[str]] = []
    rerun_file = SimpleNamespace(
        need_rerun=lambda: None, write_rerun=lambda content, path, **more: path.write_bytes(b"RRF") or 0
    )
    monkeypatch.setitem(sys.modules, "pipelines.drawing.rerun_file", rerun_file)
    monkeypatch.setattr(view.subprocess, "Popen", lambda args, **more: started.append(args))
    monkeypatch.chdir(film)
    out = str(tmp_path / "film.rrd")
    answer("view", "recording=film", f"out={out}", "open=true", "every=50")
    assert started == [[sys.executable, "-m", "rerun", "--bind", "127.0.0.1", out]]
