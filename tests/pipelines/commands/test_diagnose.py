"""`tossid diagnose` as it is called: a spoilt friction is found, the files are whole, bad input is one line."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipelines.cli import app
from pipelines.cli.console import Console
from pipelines.commands import diagnose
from pipelines.tracking.runs import find_runs
from tests.pipelines.conftest import one_line
from tossid.diagnosis.conclude import Engine
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.simulators import world_of_model
from tossid.errors import InputError
from tossid.models.e2e import EndToEnd
from tossid.objects import ObjectModel
from tossid.outputs import MARKER
from tossid.physics.effects import LIBRARY
from tossid.store import read_dataset, write_dataset
from tossid.types import Phase, Toss

KEPT = ("friction", "gravity", "inertia")
FEW = "without=[" + ",".join(effect.name for effect in LIBRARY if effect.name not in KEPT) + "]"
"""A small library is a short diagnosis."""

USER = """<mujoco model="mine">
  <option timestep="0.001" cone="elliptic"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1" friction="0.18 0.005 0.0001"/>
    <body name="cube">
      <freejoint/>
      <inertial pos="0 0 0" mass="0.37" diaginertia="0.00081 0.00081 0.00081"/>
      <geom type="box" size="0.0524 0.0524 0.0524" friction="0.18 0.005 0.0001"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="session")
def spoilt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve tosses made with friction 0.35; the dataset states 0.18."""
    folder = tmp_path_factory.mktemp("spoilt")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        keys = [
            "frames=false",
            "engine=lcp",
            "tosses=12",
            "seconds=0.6",
            "object.friction=0.35",
            "release.speed=[0.5,1.2]",
        ]
        keys += ["noise.position=0.00015", "noise.rotation=0.0015", "noise.velocity=0.02", "noise.spin=0.2"]
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
    assert gap["explanation"]["verdict"] == "incomplete"
    assert gap["explanation"]["effects"] == []
    assert gap["gap"]["total"]["value"] > 1.5
    assert max(gap["gap"]["by_phase"], key=lambda each: each["share"])["phase"] == "slide"
    assert "friction" in gap["interrupted"]["suspects"][0]["name"]
    assert "was interrupted" in (where / "gap.html").read_text()
    assert (out / "gap.json").read_text() == "of before"


def test_what_is_known_lies_in_the_folder_asked_for_unless_a_report_is_there(
    project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(diagnose, "_say", lambda *args: None)
    known: Any = SimpleNamespace(save=lambda folder: (folder / "gap.html").write_text("known"))
    for name in ("gap", "gap-interrupted"):
        said = diagnose._save_so_far(known, Path("gap"), Console(quiet=True))
        assert said.endswith(f"is in {name}/gap.html")
        assert (project / name / "gap.html").read_text() == "known"


def refused(args: list[str], capfd: pytest.CaptureFixture[str]) -> str:
    assert app.run(["diagnose", *args]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    return one_line(err)


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
    assert found["next_toss"]["release"] is None
    assert "no two effects are confusable" in found["next_toss"]["reason"]

    patch = found["patch"]
    assert {c["attribute"] for c in patch["changes"] if c["effect"] == "friction"} == {"friction"}
    # tosses of rigid contact, and a model whose contact is MuJoCo's default
    others = {c["attribute"] for c in patch["changes"] if c["effect"] == "rigid contact"}
    assert others == {"timestep", "solref", "solimp"}
    assert {c["effect"] for c in patch["changes"]} == {"friction", "rigid contact"}
    assert patch["keys"]["object.friction"]["before"] == 0.18
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
def test_a_trained_run_is_diagnosed(beside: Path, made: Path, answer: Any) -> None:
    import shutil

    shutil.copytree(made / "outputs", beside / "outputs")
    (folder,) = (beside / "outputs" / "train").iterdir()
    found = answer("diagnose", "data=tosses", "sim=run", f"sim.path={folder}", FEW, "repeats=0")
    assert found["simulator"]["sim"] == "run"
    assert "residual" in found["patch"]["not_expressed"]


# ---------------------------------------------------------------- tosses that say little


def still(toss: Toss) -> Toss:
    """Its first frame, again and again."""
    n = len(toss)
    v = np.zeros_like(toss.v)
    return replace(toss, q=np.repeat(toss.q[:1], n, axis=0), v=v, phase=np.full(n, int(Phase.REST), dtype=np.uint8))


def cut(toss: Toss, frames: slice) -> Toss:
    parts = {name: getattr(toss, name)[frames] for name in ("t", "q", "v", "q_cov", "v_cov", "phase")}
    return replace(toss, **parts)


def in_flight(toss: Toss) -> Toss:
    n = int(np.argmax(toss.phase != Phase.FLIGHT)) or len(toss)
    return cut(toss, slice(0, n))


def on_the_ground(toss: Toss) -> Toss:
    return cut(toss, slice(int(np.argmax(toss.phase != Phase.FLIGHT)) + 2, None))


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


# ---------------------------------------------------------------- bad input


def test_two_tosses_are_too_few(project: Path, spoilt: Path, capfd: pytest.CaptureFixture[str]) -> None:
    dataset = read_dataset(spoilt)
    write_dataset(replace(dataset, tosses=dataset.tosses[:2]), project / "two.h5")
    assert "has 2 tosses; a diagnosis needs at least 3" in refused(["data=two.h5"], capfd)
    short = tuple(cut(toss, slice(0, 5)) for toss in dataset.tosses)
    write_dataset(replace(dataset, tosses=short), project / "short.h5")
    assert "has 0 tosses that serve (12 of 12 are shorter than 11 frames)" in refused(["data=short.h5"], capfd)
    write_dataset(replace(dataset, tosses=tuple(map(still, dataset.tosses))), project / "still.h5")
    assert "has 0 tosses that serve (in 12 of 12 nothing moves)" in refused(["data=still.h5"], capfd)


def test_only_the_chosen_tosses_are_diagnosed(
    project: Path, spoilt: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a split, from a place on; the test split is rolled out beside, unless it is what is asked about."""
    taken: list[tuple[list[str], list[str]]] = []

    def explained(problem: Problem, engine: Engine) -> None:
        taken.append(([toss.name for toss in problem.tosses], [toss.name for toss in problem.unseen]))
        raise InputError("seen enough")

    monkeypatch.setattr("tossid.diagnosis.diagnose.report_gap", lambda problem, of_all: None)
    monkeypatch.setattr("tossid.diagnosis.diagnose.explain", explained)
    dataset = read_dataset(spoilt)
    whole, train, test = ([toss.name for toss in each] for each in (
        dataset.tosses, dataset.of_split("train"), dataset.of_split("test")
    ))  # fmt: skip
    for keys in ([], ["skip=2", "tosses=7"], ["split=train"]):
        assert "seen enough" in refused([f"data={spoilt}", *keys], capfd)
    assert taken == [(whole, []), (whole[2:9], []), (train, test)]
    assert f"test split: has {len(test)} tosses; a diagnosis needs" in refused([f"data={spoilt}", "split=test"], capfd)
    assert "has 2 tosses" in refused([f"data={spoilt}", "split=train", "tosses=2"], capfd)
    assert "split" in refused([f"data={spoilt}", "split=trian"], capfd)


def test_a_simulator_with_other_joints_is_refused(project: Path, capfd: pytest.CaptureFixture[str]) -> None:
    keys = ["object=elbow", "frames=false", "engine=lcp", "tosses=6", "seconds=0.3", "out=elbow", "--quiet"]
    assert app.run(["synthesize", *keys]) == 0
    capfd.readouterr()
    (project / "mine.xml").write_text(USER)
    line = refused(["data=elbow", "sim=mjcf", "sim.path=mine.xml"], capfd)
    assert "with 1 joints" in line
    assert "same object" in line


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (USER.replace("0.0524 0.0524 0.0524", "0.2 0.05 0.05"), "105 x 105 x 105 mm"),
        (USER.replace('type="plane" size="5 5 .1"', 'type="sphere" size="5" pos="0 0 -5"'), "a plane"),
        ("<mujoco><nothing/></mujoco>", "sim.path: mine.xml"),
        (None, "no such object file"),
    ],
)
def test_a_model_that_is_no_simulator_of_it(
    project: Path, spoilt: Path, capfd: pytest.CaptureFixture[str], text: str | None, words: str
) -> None:
    if text is not None:
        (project / "mine.xml").write_text(text)
    assert words in refused([f"data={spoilt}", "sim=mjcf", "sim.path=mine.xml"], capfd)
    assert not (project / "outputs").exists()


MINE = """
import numpy as np

def still(q0, v0, n_steps, dt):
    return np.repeat(q0[:, None], n_steps + 1, axis=1), np.repeat(v0[:, None], n_steps + 1, axis=1)

def broken(q0, v0, n_steps, dt):
    return still(q0 * np.nan, v0, n_steps, dt)

def dying(q0, v0, n_steps, dt):
    raise SystemExit(7)
"""


@pytest.mark.parametrize(
    ("function", "words"),
    [
        ("broken", "broken of mine.py: returns q that is not finite in 1 of 1 motions, in row 0 from frame 0"),
        ("dying", "dying of mine.py: its process ended (exit status 7)"),
        ("absent", "has no function 'absent'"),
    ],
)
def test_a_python_simulator_that_fails_is_one_line(
    project: Path, spoilt: Path, capfd: pytest.CaptureFixture[str], function: str, words: str
) -> None:
    (project / "mine.py").write_text(MINE)
    keys = [f"data={spoilt}", "sim=python", "sim.path=mine.py", f"sim.function={function}"]
    assert words in refused(keys, capfd)
    assert not (project / "outputs").exists()


def test_a_python_simulator_needs_its_file(project: Path, spoilt: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert "sim.path: is needed" in refused(["sim=python"], capfd)
    assert "sim.path: there is no file none.py" in refused([f"data={spoilt}", "sim=python", "sim.path=none.py"], capfd)


def test_wrong_keys(project: Path, spoilt: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert "Did you mean 'friction'?" in refused([f"data={spoilt}", "without=[fricton]"], capfd)
    assert "Did you mean 'nominal'?" in refused(["sim=nominl"], capfd)
    assert "sim.path: is needed" in refused(["sim=mjcf"], capfd)
    assert "no finished run yet" in refused([f"data={spoilt}", "sim=run"], capfd)


def test_a_gravity_that_no_planet_has(project: Path, spoilt: Path, capfd: pytest.CaptureFixture[str]) -> None:
    line = refused([f"data={spoilt}", "sim.gravity=1e200"], capfd)
    assert "sim.gravity" in line
    assert "from 0 to 1000" in line


def test_a_network_is_no_simulator_with_effects(cube: ObjectModel) -> None:
    with pytest.raises(InputError, match="e2e"):
        world_of_model(EndToEnd(cube, hidden=4))
