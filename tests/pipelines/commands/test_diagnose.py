"""`tossid diagnose` as it is called: a spoilt friction is found, the files are whole, bad input is one line."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.cli import app
from pipelines.tracking.runs import find_runs
from tests.pipelines.conftest import USER
from tests.pipelines.disturbed import FEW
from tossid.outputs import MARKER
from tossid.store import read_dataset, write_dataset
from tossid.types import Phase, Toss


@pytest.fixture(scope="session")
def spoilt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve tosses made with friction 0.35; the dataset states 0.18."""
    folder = tmp_path_factory.mktemp("spoilt")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        keys = ["frames=false", "engine=lcp", "tosses=12", "seconds=0.6", "object.friction=0.35"]
        keys += [
            "release.speed=[0.5,1.2]",
            "noise.position=0.00015",
            "noise.rotation=0.0015",
            "noise.velocity=0.02",
            "noise.spin=0.2",
        ]
        assert app.run(["synthesize", *keys, "out=tosses", "--quiet"]) == 0
        dataset = read_dataset(Path("tosses/tosses.h5"))
        stated = replace(dataset, object=dataset.object.with_changes(friction=0.18))
        write_dataset(stated, folder / "spoilt.h5")
    return folder / "spoilt.h5"


def test_ctrl_c_leaves_what_is_known(spoilt: Path, tmp_path: Path) -> None:
    out = tmp_path / "gap"
    out.mkdir()
    (out / MARKER).touch()
    (out / "gap.json").write_text("of before")
    command = [sys.executable, "-m", "pipelines.cli.app", "diagnose", f"data={spoilt}", f"out={out}", "threads=1", FEW]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=tmp_path, start_new_session=True
    ) as running:
        assert running.stderr is not None
        lines = []
        for line in running.stderr:
            lines.append(line)
            if "next suspect" in line:
                break
        os.kill(running.pid, signal.SIGINT)
        rest, code = running.stderr.read(), running.wait(timeout=60)
    assert code == 130, rest
    assert any("the gap over short windows is" in line and "most in slide" in line for line in lines)
    assert "Traceback" not in rest
    where = tmp_path / "gap-interrupted"
    assert f"what was known by then is in {where / 'gap.html'}" in rest.strip().splitlines()[-1]
    gap = json.loads((where / "gap.json").read_text())
    assert gap["complete"] is False
    assert "friction" in gap["interrupted"]["suspects"][0]["name"]
    assert "was interrupted" in (where / "gap.html").read_text()
    assert (out / "gap.json").read_text() == "of before"


def test_a_spoilt_friction_is_found_in_the_users_mujoco_model_and_the_patch_works(
    project: Path, spoilt: Path, answer: Any
) -> None:
    (project / "mine.xml").write_text(USER)
    found = answer("diagnose", f"data={spoilt}", "sim=mjcf", "sim.path=mine.xml", "out=gap", FEW, "repeats=0")
    assert found["schema"] == "tossid.gap/1"
    assert found["explanation"]["verdict"] in ("explained", "partly_explained")
    assert found["explanation"]["effects"] == ["friction"]
    first = found["effects"][0]
    assert (first["name"], first["verdict"]) == ("friction", "identified")
    assert first["parameters"]["mu"]["value"] == pytest.approx(0.35, abs=0.01)
    patch = found["patch"]
    # tosses of rigid contact, and a model whose contact is MuJoCo's default
    assert {c["effect"] for c in patch["changes"]} == {"friction", "rigid contact"}
    run = patch["rerun"]
    assert run["position_error_pct"]["after"]["value"] < 0.7 * run["position_error_pct"]["before"]["value"]
    assert Path(found["patched_mjcf"]).read_text() == patch["mjcf"]

    kept = json.loads((project / "gap" / "gap.json").read_text())
    assert kept["explanation"] == found["explanation"]
    assert kept["patch"] == patch
    page = (project / "gap" / "gap.html").read_text()
    assert "explained" in page[: page.index("</title>")]
    assert all(Path(path).is_file() for path in found["figures"])
    (tracked,) = find_runs(command="diagnose")
    assert tracked.info.run_id == found["run"]
    assert tracked.data.tags["effects"] == "friction"
    assert tracked.data.metrics["gap_closed"] == pytest.approx(found["explanation"]["gap_closed"]["value"])


@pytest.mark.slow
def test_a_trained_run_is_diagnosed_and_the_report_stays_where_the_tracker_is_lost(
    beside: Path, answer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mlflow import MlflowClient
    from mlflow.exceptions import MlflowException

    def lost(*_: object) -> None:
        raise MlflowException("Connection refused")

    answer("train", "model=cnrp", "model.learn_geometry=false", "epochs=2", "data=tosses")
    monkeypatch.setattr(MlflowClient, "set_tag", lost)
    words = ["diagnose", "data=tosses", "sim=run", "out=gap", FEW, "repeats=0", "--quiet"]
    assert app.run(words) == 1
    found = json.loads((beside / "gap" / "gap.json").read_text())
    assert found["simulator"]["sim"] == "run"
    assert "residual" in found["patch"]["not_expressed"]


# ---------------------------------------------------------------- tosses that say little


def in_flight(toss: Toss) -> Toss:
    n = int(np.argmax(toss.phase != Phase.FLIGHT)) or len(toss)
    return toss.frames(slice(0, n))


def on_the_ground(toss: Toss) -> Toss:
    return toss.frames(slice(int(np.argmax(toss.phase != Phase.FLIGHT)) + 2, None))


@pytest.mark.slow
@pytest.mark.parametrize("kind", [in_flight, on_the_ground])
def test_tosses_that_say_little_name_nothing_by_accident(project: Path, spoilt: Path, answer: Any, kind: Any) -> None:
    dataset = read_dataset(spoilt)
    tosses = tuple(toss for toss in map(kind, dataset.tosses) if len(toss) > 12)
    assert len(tosses) >= 6
    stated = dataset.object if kind is on_the_ground else dataset.object.with_changes(friction=0.35)
    write_dataset(replace(dataset, tosses=tosses, object=stated), project / "few.h5")
    found = answer("diagnose", "data=few.h5", FEW, "repeats=0")
    names = set(found["explanation"]["effects"])
    assert names <= ({"friction"} if kind is on_the_ground else set())
    if kind is in_flight:
        (friction,) = [each for each in found["effects"] if each["name"] == "friction"]
        assert friction["verdict"] == "not_identifiable"
