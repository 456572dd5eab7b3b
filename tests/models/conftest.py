from __future__ import annotations

from pathlib import Path

import pytest

from tossid.objects import ObjectModel, load_object


@pytest.fixture(scope="session")
def cube() -> ObjectModel:
    return load_object(Path(__file__).parents[2] / "conf/object/cube.xml")


@pytest.fixture(scope="session")
def elbow() -> ObjectModel:
    return load_object(Path(__file__).parents[2] / "conf/object/elbow.xml")
