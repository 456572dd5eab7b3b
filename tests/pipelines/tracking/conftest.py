"""One MLflow store for the tests of a module."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipelines.tracking.runs import find_run
from tossid.errors import InputError


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
