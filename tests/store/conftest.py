"""A small dataset, and its file."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.store.makers import make_dataset
from tossid.objects import ObjectModel
from tossid.store import Dataset, write_dataset


@pytest.fixture
def dataset(cube: ObjectModel) -> Dataset:
    return make_dataset(cube)


@pytest.fixture
def path(dataset: Dataset, tmp_path: Path) -> Path:
    write_dataset(dataset, tmp_path / "tosses.h5")
    return tmp_path / "tosses.h5"
