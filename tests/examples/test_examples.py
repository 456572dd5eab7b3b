"""Each example runs as it stands, in an empty folder, and says what it promises."""

from __future__ import annotations

import json
import os
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest

import tossid

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
NOTEBOOK = EXAMPLES / "why_is_my_simulator_wrong.ipynb"


def output_of(script: str, folder: Path, *args: str) -> str:
    """What a script prints that runs in a folder."""
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(EXAMPLES / script), *args]
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_script_is_tested_and_listed() -> None:
    scripts = {path.name for path in EXAMPLES.glob("*.py")}
    assert len(scripts) >= 5
    for text in (Path(__file__).read_text(), (EXAMPLES / "README.md").read_text()):
        assert all(script in text for script in scripts)


def test_own_object(tmp_path: Path) -> None:
    lines = output_of("own_object.py", tmp_path).splitlines()
    assert len(lines) == 8
    dataset = tossid.read_dataset(tmp_path / "brick.h5")
    assert (dataset.object.name, dataset.object.friction) == ("brick", 0.3)
    assert tossid.objects.load_object(tmp_path / "brick.xml").mass.item() == 0.5


def test_bare_h5py(tmp_path: Path) -> None:
    head, *rows = output_of("bare_h5py.py", tmp_path).splitlines()
    assert head == "6 tosses of 'cube' at 148 Hz"
    assert len(rows) == 6
    assert all(0.5 < float(row.split()[-2]) < 10 for row in rows)  # [m/s]


def test_study_as_loop(tmp_path: Path) -> None:
    _, *rows = output_of("study_as_loop.py", tmp_path, "3", "2", "3").splitlines()
    assert [row.split()[:2] for row in rows] == [["2", "9.81"], ["2", "0.00"], ["3", "9.81"], ["3", "0.00"]]


@pytest.mark.slow
def test_study_as_loop_shows_that_errors_fall_with_tosses(tmp_path: Path) -> None:
    _, *rows = output_of("study_as_loop.py", tmp_path, "30", "2", "8").splitlines()
    few, few_wrong, many, many_wrong = (float(row.split()[-2]) for row in rows)
    assert many < 0.5 * few
    assert many_wrong < 0.5 * few_wrong  # as with the right gravity: k_res repairs the wrong one


@pytest.mark.slow
def test_study_by_processes(tmp_path: Path) -> None:
    lines = output_of("study_by_processes.py", tmp_path, "1").splitlines()
    assert sum(line.startswith("done: ") for line in lines) == 4
    assert [line.split()[:2] for line in lines[-4:]] == [["cn", "0"], ["cn", "9.81"], ["cnrp", "0"], ["cnrp", "9.81"]]
    assert (tmp_path / "studies" / "gravity" / "table.md").is_file()


@pytest.mark.slow
def test_diagnose_trained_model(tmp_path: Path) -> None:
    said = output_of("diagnose_trained_model.py", tmp_path, "--quick")
    assert "gravity; g 7.0" in said
    assert (tmp_path / "gap" / "gap.html").is_file()


@pytest.mark.slow
def test_frames_to_report(tmp_path: Path) -> None:
    camera = {"count": 2, "samples": 4, "pause_s": (0.15, 0.15), "carry_s": (0.2, 0.2)}
    tossid.synthesize("cube", frames=True, out=tmp_path / "film", tosses=8, **camera)
    assert "rotation_error_deg" in output_of("frames_to_report.py", tmp_path, "film")
    assert (tmp_path / "gap" / "gap.html").is_file()


@pytest.mark.slow
def test_the_two_faults_of_the_shipped_simulator_are_found() -> None:
    dataset = tossid.ingest(EXAMPLES / "poses" / "tosses", source="tum", object="cube")
    gap = tossid.diagnose(dataset, simulator=EXAMPLES / "poses" / "cube.xml")
    assert set(gap.named) == {"friction", "com_offset"}
    values = {(f.name, key): value for f in gap.found for key, value in f.parameters.items()}
    for name, key, truth in (("friction", "mu", 0.3), ("com_offset", "x_m", 0.003), ("com_offset", "z_m", 0.004)):
        assert values[name, key].value == pytest.approx(truth, rel=0.05)


# ---------------------------------------------------------------- the notebook


def cells_of_notebook() -> list[dict[str, Any]]:
    """The cells with code, in their order."""
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


def test_the_notebook_is_kept_with_what_it_shows() -> None:
    cells = cells_of_notebook()
    outputs = [output for cell in cells for output in cell["outputs"]]
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    assert all(output["output_type"] in ("stream", "display_data", "execute_result") for output in outputs)
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 3
    assert NOTEBOOK.stat().st_size < 1_000_000
    assert "/tmp" not in NOTEBOOK.read_text()


@pytest.mark.slow
def test_the_notebook_runs_and_finds_what_is_true(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(EXAMPLES)
    names: dict[str, Any] = {}
    with matplotlib.rc_context({"backend": "agg"}):
        for cell in cells_of_notebook():
            exec("".join(cell["source"]), names)
    assert names["gap"].named == ("friction",)
    assert names["found"].value == pytest.approx(names["true"], rel=0.02)
    assert {"gap.html", "gap.json", "patched.xml"} <= {path.name for path in names["folder"].iterdir()}


# ---------------------------------------------------------------- simulators of users


ENGINES = [("diagnose_mujoco.py", "mujoco"), ("diagnose_drake.py", "pydrake"), ("diagnose_bullet.py", "pybullet")]


@pytest.mark.parametrize(("script", "package"), ENGINES)
def test_an_engine_drops_the_cube_onto_its_face(script: str, package: str) -> None:
    pytest.importorskip(package, reason=f"{script} needs the package '{package}'")
    simulate = runpy.run_path(str(EXAMPLES / script))["simulate"]
    q0 = np.array([[0.0, 0.0, 0.0624, 1.0, 0.0, 0.0, 0.0], [0.1, 0.2, 0.5, 0.6, 0.8, 0.0, 0.0]])
    v0 = np.array([[0.5, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.3, 1.0, 0.0, 0.0, 4.0]])
    q, v = simulate(q0, v0, 60, 1 / 100)
    assert (q.shape, v.shape) == ((2, 61, 7), (2, 61, 6))
    np.testing.assert_array_equal(q[:, 0], q0)
    # it slides 1 cm down and on, and friction of 0.18 stops it after some 7 cm
    assert q[0, -1, 2] == pytest.approx(0.0524, abs=2e-3)
    assert q[0, -1, 0] == pytest.approx(0.5**2 / (2 * 0.18 * 9.81), abs=0.02)
    # free: a parabola, and even spin about the body's z
    t = np.arange(20) / 100
    np.testing.assert_allclose(q[1, :20, 2], 0.5 + t - 4.905 * t**2, atol=5e-3)
    np.testing.assert_allclose(v[1, :20, 3:], np.tile([0, 0, 4.0], (20, 1)), atol=1e-2)


@pytest.mark.slow
def test_diagnose_mujoco(tmp_path: Path) -> None:
    said = output_of("diagnose_mujoco.py", tmp_path, "--quick")
    assert "gap" in said.splitlines()[0]
    assert (tmp_path / "gap-mujoco" / "gap.html").is_file()
