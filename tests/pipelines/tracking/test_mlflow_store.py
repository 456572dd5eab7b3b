"""The store of runs: its tables are made once, also on network file systems and without `flock`; servers away."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from pipelines.cli import app
from pipelines.tracking import mlflow_store
from pipelines.tracking.mlflow_store import _making, client, experiment_id, is_remote
from pipelines.tracking.run import tracked_run
from tests.pipelines.conftest import one_line, stored_run
from tests.pipelines.processes import free_port


def journal_of(database: Path) -> str:
    with closing(sqlite3.connect(database)) as store:
        return str(store.execute("PRAGMA journal_mode").fetchone()[0])


@pytest.mark.parametrize(("shared", "journal"), [("nfs4", "delete"), (None, "wal")])
def test_a_network_file_system_gets_a_rollback_journal(
    project: Path, monkeypatch: pytest.MonkeyPatch, shared: str | None, journal: str
) -> None:
    monkeypatch.setattr(mlflow_store, "network_file_system", lambda path: shared)
    with tracked_run("there", {}, command="train") as run:
        run.metrics({"loss": 1.0}, step=1)
    assert stored_run(run.id).data.metrics == {"loss": 1.0}
    assert journal_of(project / "mlflow.db") == journal


def test_a_network_file_system_is_known_by_its_mount(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mounts = f"/dev/vda / ext4 rw 0 0\nlab:/data {tmp_path}/a\\040b nfs4 rw 0 0\n"
    read = Path.read_text
    monkeypatch.setattr(Path, "read_text", lambda self: mounts if self.name == "mounts" else read(self))
    assert mlflow_store.network_file_system(tmp_path / "a b" / "not" / "there.db") == "nfs4"
    assert mlflow_store.network_file_system(tmp_path / "a") is None


def test_the_doctor_names_the_file_system(project: Path, answer: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mlflow_store, "network_file_system", lambda path: "nfs4")
    (found,) = [each for each in answer("doctor")["findings"] if each["what"] == "MLflow"]
    assert "it lies on nfs4" in found["advice"]
    assert "docs/guide/server.md" in found["advice"]


@pytest.mark.parametrize(
    "kind", ["postgresql+psycopg2://ann:sec%40ret-9f3a@127.0.0.1:PORT/runs", "http://ann:sec%2Fret-9f3a@127.0.0.1:PORT"]
)
def test_a_server_that_is_not_there_is_named_without_its_password(
    project: Path, answer: Any, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    if kind.startswith("postgresql"):
        pytest.importorskip("psycopg2", reason="psycopg2 is an extra: pip install -e '.[server]'")
    for name, value in mlflow_store._HTTP_AT_ONCE.items():
        monkeypatch.setenv(f"MLFLOW_HTTP_REQUEST_{name}", value)
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


def test_a_store_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    database = tmp_path / "mlflow.db"
    with pytest.raises(KeyboardInterrupt), _making(database):
        database.write_bytes(b"half a store")
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []
    database.write_bytes(b"half a store")  # and here the process was killed
    database.with_suffix(".making").write_bytes(b"making")
    with _making(database):
        assert not database.exists()
        database.write_bytes(b"whole")
    with pytest.raises(ValueError, match="of the caller"), _making(database):
        raise ValueError("of the caller")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {
        "mlflow.db": b"whole",
        "mlflow.db.unfinished": b"half a store",
    }


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
    store: Path, project: Path, capfd: pytest.CaptureFixture[str], harm: Any, says: str
) -> None:
    with closing(sqlite3.connect(store / "mlflow.db")) as made, closing(sqlite3.connect("mlflow.db")) as copy:
        made.backup(copy)
    harm(project / "mlflow.db")
    assert app.run(["evaluate"]) == 2
    said = one_line(capfd.readouterr().err)
    assert said.startswith(f"tossid evaluate: {project / 'mlflow.db'}: ")
    assert says in said


def test_what_is_deleted_while_a_command_works_is_no_bug(
    project: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
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


def test_an_experiment_is_made_once_and_the_page_opens_it_as_training_of_models(project: Path) -> None:
    store = client()
    assert not is_remote(store)
    store.create_experiment("tossid")  # as an earlier version made it
    made = [experiment_id(store, name) for name in ("tossid", "another", "tossid")]
    assert made[0] == made[2] != made[1]
    for each in made:
        assert store.get_experiment(each).tags["mlflow.experimentKind"] == "custom_model_development"
