"""A project folder of its own for each test, and what commands have made once for all."""

from __future__ import annotations

import json
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from pipelines.cli import app
from pipelines.cli.console import Console
from pipelines.config.compose import load
from pipelines.config.keys import Group, keys_of
from pipelines.config.schemas import IngestConfig, ViewConfig
from pipelines.tracking.mlflow_store import client
from pipelines.tracking.runs import find_run
from tests.once import made_once
from tossid.errors import InputError

if TYPE_CHECKING:
    from pipelines.drawing.recording_view import ViewContent

KEYS = ["model=cnrpi", "model.horizons=[]", "epochs=6", "patience=6"]
"""A short training."""

FILM = ["tosses=1", "seed=2", "camera.count=2", "camera.samples=4", "camera.clocks_s=[0,0.02]"]
FILM += ["camera.pause_s=[0.1,0.1]", "camera.carry_s=[0.2,0.2]"]
"""A small recording, one of whose clocks is late."""

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
"""A user's own simulator of the cube."""

MODEL = """<mujoco>{head}<worldbody><body name="base"><freejoint/><geom type="box" size="0.05 0.05 0.05"/></body>
</worldbody></mujoco>"""
"""A box."""


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small dataset of tosses, and an uninterrupted training of KEYS in an MLflow store."""
    keys = ["frames=false", "engine=lcp", "tosses=10", "seconds=0.8", "noise.position=0.0005", "noise.velocity=0.02"]

    def make(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            patch.delenv("MLFLOW_TRACKING_URI", raising=False)
            assert app.run(["synthesize", *keys, "out=tosses", "--quiet"]) == 0
            assert app.run(["train", *KEYS, "data=tosses", "--quiet"]) == 0

    return made_once(tmp_path_factory, "made", make)


@pytest.fixture
def answer(capfd: pytest.CaptureFixture[str]) -> Any:
    """Run a command with --json; returns its object."""

    def run(*args: str) -> dict[str, Any]:
        code = app.run([*args, "--json", "--quiet"])
        out, err = capfd.readouterr()
        assert code == 0, err
        found: dict[str, Any] = json.loads(out)
        return found

    return run


@pytest.fixture
def beside(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder of its own with the dataset and the store's tables, without outputs."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    shutil.copytree(made / "tosses", tmp_path / "tosses")
    with closing(sqlite3.connect(made / "mlflow.db")) as store, closing(sqlite3.connect("mlflow.db")) as copy:
        store.backup(copy)
    return tmp_path


@pytest.fixture(scope="session")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project folder with FILM in data/raw, made once for all workers; `film` leads to it."""

    def make(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            assert app.run(["synthesize", *FILM, "--quiet"]) == 0
        (recording,) = (folder / "data" / "raw").iterdir()
        (folder / "film").symlink_to(recording)

    return made_once(tmp_path_factory, "film", make)


@pytest.fixture(scope="session")
def content(film: Path) -> ViewContent:
    """What is shown of that recording."""
    from pipelines.drawing.recording_view import recording_content

    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(film)
        return recording_content(load("view", ViewConfig, [f"recording={film / 'film'}"]), Console(quiet=True))


def members(group: str) -> tuple[str, ...]:
    """The members of a group of `ingest`."""
    (found,) = [key for key in keys_of(IngestConfig, {}) if isinstance(key, Group) and key.name == group]
    return found.members()


def one_line(text: str) -> str:
    """The single line of an error report; fails where there are more."""
    lines = text.strip().splitlines()
    assert len(lines) == 1, text
    return lines[0]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project folder whose store has been made (making it takes seconds)."""
    folder = tmp_path_factory.mktemp("project")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.delenv("MLFLOW_TRACKING_URI", raising=False)
        with pytest.raises(InputError, match="no finished run yet"):
            find_run()
    return folder


@pytest.fixture
def inside(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(store)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)


def stored_run(run_id: str) -> Any:
    """MLflow's own record of a run."""
    return client().get_run(run_id)


def metric_history(run_id: str, name: str) -> list[tuple[int, float]]:
    """Steps and values of a run's metric."""
    return [(point.step, point.value) for point in client().get_metric_history(run_id, name)]
