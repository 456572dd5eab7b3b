"""What the workers of one test run share: made by the first that needs it, read by all."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tossid.locks import held


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """A folder of the test run, filled by the first worker that asks for it; the others wait.

    Args:
        factory: Of the worker's temporary folders.
        name: Of the folder.
        make: Fills it.

    Returns:
        The folder. Tests read what is in it, and copy what they change.
    """
    own = factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / name
    with held(folder.with_suffix(".lock"), wait=True):
        if not folder.with_suffix(".done").exists():
            folder.mkdir()
            make(folder)
            folder.with_suffix(".done").touch()
    return folder
