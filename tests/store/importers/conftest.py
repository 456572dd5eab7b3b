"""Folders of tensors as they are published."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.store.importers.folders import save
from tests.store.makers import contactnets_rows, pll_rows


@pytest.fixture
def cube_folder(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    folder = tmp_path / "cube"
    folder.mkdir()
    for name in ("10", "2", "1"):
        rows = contactnets_rows(20, rng)
        save(folder / f"{name}.pt", rows[None] if name == "2" else rows)
    return folder


@pytest.fixture
def elbow_folder(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    folder = tmp_path / "elbow"
    folder.mkdir()
    for name in ("0", "1"):
        save(folder / f"{name}.pt", pll_rows(20, rng))
    return folder
