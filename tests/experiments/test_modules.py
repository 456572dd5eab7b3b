"""Every study and benchmark can be imported: what it takes from the library is there."""

from __future__ import annotations

import importlib
import pkgutil

import pytest

import benchmarks
import experiments

MODULES = [
    module.name
    for package in (experiments, benchmarks)
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
]


@pytest.mark.parametrize("name", MODULES)
def test_a_module_is_imported(name: str) -> None:
    assert importlib.import_module(name).__name__ == name
