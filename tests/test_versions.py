"""Versions of all that computes, and where two environments differ."""

from __future__ import annotations

import platform

import numba
import torch

from tossid.versions import ABSENT, computing_versions, differing_versions


def test_versions_are_those_that_run() -> None:
    found = computing_versions()
    assert found["python"] == platform.python_version()
    assert found["numba"] == numba.__version__
    assert found["torch"] == torch.__version__
    assert ABSENT not in (found[name] for name in ("numpy", "scipy", "llvmlite", "mujoco"))


def test_differences_name_the_package_and_both_versions() -> None:
    here = {"numpy": "2.4.1", "torch": "2.13.0"}
    assert differing_versions(here, dict(here)) == []
    assert differing_versions(here, {"numpy": "2.4.2"}) == [
        ("numpy", "2.4.1", "2.4.2"),
        ("torch", "2.13.0", ABSENT),
    ]
