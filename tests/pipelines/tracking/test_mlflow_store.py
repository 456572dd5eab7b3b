"""The store of runs: its tables are made once, whole or not at all; servers away, damaged files."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from pipelines.cli import app
from pipelines.tracking.mlflow_store import client, experiment_id
from pipelines.tracking.run import tracked_run
from tests.pipelines.conftest import one_line
from tests.pipelines.processes import free_port


@pytest.mark.parametrize(
    "kind", ["postgresql+psycopg2://ann:sec%40ret-9f3a@127.0.0.1:PORT/runs", "http://ann:sec%2Fret-9f3a@127.0.0.1:PORT"]
)
def test_a_server_that_is_not_there_is_named_without_its_password(
    project: Path, answer: Any, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    if kind.startswith("postgresql"):
        pytest.importorskip("psycopg2", reason="psycopg2 is an extra: pip install -e '.[server]'")
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", kind.replace("PORT", str(free_port())))
    assert app.run(["evaluate", "--debug"]) == 2
    said = capfd.readouterr().err
    assert "does not answer" in said.splitlines()[-1]
    assert "ann:***@127.0.0.1" in said
    report = answer("doctor")
    (found,) = [each for each in report["findings"] if each["what"] == "MLflow"]
    assert (found["state"], report["ok"]) == ("missing", False)
    assert "does not answer" in found["found"]
    assert "ret-9f3a" not in said + str(report)


@pytest.mark.parametrize("uri", ["postgresql://ann:sec@ret-9f3a@db/runs", "postgresql://ann:sec/ret-9f3a@db/runs"])
def test_a_password_that_is_not_encoded_is_refused(
    project: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, uri: str
) -> None:
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    assert app.run(["evaluate"]) == 2
    line = one_line(capfd.readouterr().err)
    assert "MLFLOW_TRACKING_URI=postgresql://ann:***@db/runs: '@' and '/'" in line
    assert "%40 and %2F" in line


def test_a_store_appears_whole_or_not_at_all_and_opens_as_training_of_models(
    project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mlflow import MlflowClient

    Path(".mlflow.tmp-1-00000000.db").write_bytes(b"half a store, of a process that was killed")
    with monkeypatch.context() as patch:
        patch.setattr(MlflowClient, "search_experiments", _interrupt)
        with pytest.raises(KeyboardInterrupt):
            client()
    assert [path.name for path in project.iterdir() if path.suffix == ".db"] == []
    store = client()
    made = [experiment_id(store, name) for name in ("tossid", "another", "tossid")]
    assert made[0] == made[2] != made[1]
    for each in made:
        assert store.get_experiment(each).tags["mlflow.experimentKind"] == "custom_model_development"


def _interrupt(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def _other_version(database: Path) -> None:
    with closing(sqlite3.connect(database)) as store:
        store.execute("UPDATE alembic_version SET version_num = '0584bdc529eb'")
        store.commit()


def _folder_instead(database: Path) -> None:
    database.unlink()
    database.mkdir()


@pytest.mark.parametrize(
    ("harm", "says"),
    [
        (lambda database: database.write_bytes(b"no database" * 500), "store is damaged"),
        (lambda database: database.write_bytes(database.read_bytes()[:100_000]), "store is damaged"),
        (_other_version, "another version of MLflow made this store; after a copy is made, 'mlflow db upgrade sqlite:"),
        (_folder_instead, "is not a regular file"),
    ],
)
def test_a_store_that_cannot_be_opened_is_named(
    beside: Path, capfd: pytest.CaptureFixture[str], harm: Any, says: str
) -> None:
    harm(beside / "mlflow.db")
    assert app.run(["evaluate"]) == 2
    said = one_line(capfd.readouterr().err)
    assert said.startswith(f"tossid evaluate: {beside / 'mlflow.db'}: ")
    assert says in said


def test_what_is_deleted_while_a_command_works_is_no_bug(
    beside: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def deleted_meanwhile(*_: object, **__: object) -> None:
        with tracked_run("there", {}, command="train") as run:
            client().delete_run(run.id)
            run.metrics({"loss": 1.0}, step=1)

    monkeypatch.setattr("pipelines.tracking.runs.find_run", deleted_meanwhile)
    assert app.run(["evaluate"]) == 1
    said = one_line(capfd.readouterr().err)
    assert "MLflow's store refuses (" in said
    assert "must be in the 'active' state" in said
    assert "The command can be run again" in said
