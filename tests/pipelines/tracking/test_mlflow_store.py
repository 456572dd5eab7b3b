"""MLflow's store: addresses without passwords, tables that are made once, experiments by name."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipelines.tracking.mlflow_store import _making, client, experiment_id, is_remote, without_password


@pytest.mark.parametrize(
    ("uri", "shown"),
    [
        ("http://anna:secret@host:5000/x", "http://anna:***@host:5000/x"),
        ("https://host", "https://host"),
        ("sqlite:///mlflow.db", "sqlite:///mlflow.db"),
        ("postgresql://:secret@host/db", "postgresql://:***@host/db"),
    ],
)
def test_no_password_is_printed(uri: str, shown: str) -> None:
    assert without_password(uri) == shown


@pytest.mark.usefixtures("inside")
def test_an_experiment_is_made_once() -> None:
    store = client()
    assert not is_remote(store)
    made = experiment_id(store, "tossid-test")
    assert experiment_id(store, "tossid-test") == made
    assert experiment_id(store, "tossid-other") != made


def test_a_store_whose_making_failed_is_removed(tmp_path: Path) -> None:
    database = tmp_path / "mlflow.db"
    with pytest.raises(KeyboardInterrupt), _making(database):
        database.write_bytes(b"half a store")
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_a_store_that_a_killed_process_left_half_made_is_put_aside(tmp_path: Path) -> None:
    database = tmp_path / "mlflow.db"
    database.write_bytes(b"half a store")
    database.with_suffix(".making").write_bytes(b"making")
    with _making(database):
        assert not database.exists()
        database.write_bytes(b"whole")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {
        "mlflow.db": b"whole",
        "mlflow.db.unfinished": b"half a store",
    }


def test_a_store_that_is_there_is_left_alone(tmp_path: Path) -> None:
    database = tmp_path / "mlflow.db"
    database.write_bytes(b"whole")
    with pytest.raises(ValueError, match="of the caller"), _making(database):
        raise ValueError("of the caller")
    assert database.read_bytes() == b"whole"
