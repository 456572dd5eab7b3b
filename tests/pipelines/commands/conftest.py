"""A project folder with a small recording."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipelines.cli import app
from tests.once import made_once

FILM = ["tosses=1", "camera.count=2", "camera.samples=4", "camera.pause_s=[0.1,0.1]", "camera.carry_s=[0.2,0.2]"]


@pytest.fixture(scope="session")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project folder with one small recording in data/raw."""

    def make(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            assert app.run(["synthesize", *FILM, "--quiet"]) == 0

    return made_once(tmp_path_factory, "film", make)
