"""A small dataset and its file, and folders of tensors as they are published."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.store.makers import contactnets_rows, make_dataset, pll_rows, save
from tossid.objects import ObjectModel
from tossid.store import Dataset, write_dataset


@pytest.fixture
def dataset(cube: ObjectModel) -> Dataset:
    return make_dataset(cube)


@pytest.fixture
def path(dataset: Dataset, tmp_path: Path) -> Path:
    write_dataset(dataset, tmp_path / "tosses.h5")
    return tmp_path / "tosses.h5"


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
