"""Names that are imported when they are first used."""

from __future__ import annotations

import sys
from types import ModuleType

import pytest

from tossid.first_use import imported_at_first_use


@pytest.fixture
def package(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    module = ModuleType("lazy_package")
    monkeypatch.setitem(sys.modules, "lazy_package", module)
    module.__getattr__ = imported_at_first_use("lazy_package", {"Path": "pathlib"})  # type: ignore[method-assign]
    return module


def test_a_name_is_imported_once_and_then_stays(package: ModuleType) -> None:
    assert "Path" not in vars(package)
    assert package.Path is sys.modules["pathlib"].Path
    assert "Path" in vars(package)


def test_a_name_that_is_not_there_is_said(package: ModuleType) -> None:
    with pytest.raises(AttributeError, match="module 'lazy_package' has no attribute 'Pth'"):
        _ = package.Pth
