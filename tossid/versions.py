"""Versions of all that computes: the same code gives other numbers with another NumPy, Numba, PyTorch or MuJoCo."""

from __future__ import annotations

import platform
from functools import cache
from importlib import metadata

COMPUTE = (
    "numpy",
    "scipy",
    "numba",
    "llvmlite",
    "torch",
    "mujoco",
    "gtsam",
    "opencv-python-headless",
    "pupil-apriltags",
)
"""Packages that numbers depend on. Those that read, write, draw or track are not among them."""
ABSENT = "not installed"


def computing_versions() -> dict[str, str]:
    """Versions of Python and of the packages in `COMPUTE`, by name, as this process has them.

    Returns:
        A new dictionary: {"python": "3.11.9", "numpy": "2.4.1", ...}; "not installed" for what is not there.
    """
    return {"python": platform.python_version(), **{name: package_version(name) for name in COMPUTE}}


def differing_versions(here: dict[str, str], there: dict[str, str]) -> list[tuple[str, str, str]]:
    """What two environments have in different versions.

    Args:
        here: Of `computing_versions`.
        there: Likewise.

    Returns:
        (name, version here, version there), in order of name.
    """
    names = sorted(here.keys() | there.keys())
    pairs = [(name, here.get(name, ABSENT), there.get(name, ABSENT)) for name in names]
    return [(name, one, other) for name, one, other in pairs if one != other]


@cache
def package_version(name: str) -> str:
    """The installed version of a package, "not installed" where there is none.

    Args:
        name: As on an index ("opencv-python-headless").
    """
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ABSENT
