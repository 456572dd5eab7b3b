"""What tests of several rooms share: the nominal objects, and real data where it is."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tossid import code_digest
from tossid.objects import OBJECT_FILES, ObjectModel, load_object

ROOT = Path(__file__).parents[1]


@pytest.fixture(autouse=True)
def digests_forget_registrations(monkeypatch: pytest.MonkeyPatch) -> None:
    """What other tests register does not change the digests of this one: workers of its own do not know it."""
    monkeypatch.setattr(code_digest, "_outside", {})


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real recordings: $TOSSID_SHARED_DATA, or shared/data beside the repository."""
    named = os.environ.get("TOSSID_SHARED_DATA")
    folder = Path(named) if named else ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("no real data: set TOSSID_SHARED_DATA to the folder that holds contactnets_cube and pll_elbow")
    return folder


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder, with MLflow's own defaults."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    return tmp_path


@pytest.fixture(scope="session")
def cube() -> ObjectModel:
    return load_object(OBJECT_FILES / "cube.xml")


@pytest.fixture(scope="session")
def elbow() -> ObjectModel:
    return load_object(OBJECT_FILES / "elbow.xml")
