"""Compiled kernels: never stale, whichever file is edited; kept where nothing has changed."""

from __future__ import annotations

import importlib
import pkgutil
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
from numba.core.caching import NullCache

import tossid
from tests.copied import Copy
from tossid.code_digest import kernel_modules
from tossid.kernels import _Cache, _is_ours, fused_kernel, kernel
from tossid.physics.forces import Forces

INNER = """
from tossid.kernels import kernel
@kernel
def inner(x):
    return x + 1.0
"""
OUTER = """
from tossid.kernels import kernel
from tossid._inner import inner
@kernel
def outer(x):
    return 2.0 * inner(x)
"""
RUN = """
from tossid._outer import outer
print(outer(1.0), len(outer.stats.cache_hits))
"""
EDIT_AND_RUN = """
import pathlib, tossid.kernels
path = pathlib.Path("tossid/_inner.py")
path.write_text(path.read_text().replace("x + 5.0", "x + 7.0"))
from tossid._outer import outer
print(outer(1.0), len(outer.stats.cache_hits))
"""


def test_a_kernel_whose_callee_is_edited_in_another_file_is_compiled_anew(tmp_path: Path) -> None:
    copy = Copy(tmp_path)
    for name, text in (("_inner", INNER), ("_outer", OUTER)):
        (tmp_path / "tossid" / f"{name}.py").write_text(text)
    assert copy.python(RUN) == "4.0 0"
    assert copy.python(RUN) == "4.0 1"
    copy.edit("tossid/_inner.py", r"^", "# a comment\n")
    assert copy.python(RUN) == "4.0 1"
    copy.edit("tossid/_inner.py", r"x \+ 1\.0", "x + 5.0")
    assert copy.python(RUN) == "12.0 0"
    # edited while a process runs: that one neither reads nor leaves anything
    assert copy.python(EDIT_AND_RUN) == "16.0 0"
    assert copy.python(RUN) == "16.0 0"
    assert copy.python(RUN) == "16.0 1"


def test_every_kernel_s_source_is_in_the_digest() -> None:
    modules = kernel_modules()
    found = 0
    for info in pkgutil.walk_packages(tossid.__path__, "tossid."):
        for value in vars(importlib.import_module(info.name)).values():
            if hasattr(value, "py_func"):
                found += 1
                assert value.py_func.__module__ in modules
                assert type(value._cache) in (_Cache, NullCache)  # not Numba's, which an edit outdates
    assert found > 50


class Theirs(NamedTuple):
    factor: float


def test_what_is_compiled_for_a_user_s_types_is_not_kept() -> None:
    assert _is_ours(numba.typeof((1.0, np.zeros(3), Forces())))
    assert not _is_ours(numba.typeof((1.0, (Theirs(2.0), 1))))
    assert not _is_ours(numba.typeof(kernel(lambda x: x)))


def test_a_kernel_computes_what_its_function_does() -> None:
    def mean(x: np.ndarray, by: float) -> float:
        total = 0.0
        for i in range(len(x)):
            total += x[i]
        return total / by

    x = np.arange(5.0)
    assert kernel(mean)(x, 5.0) == mean(x, 5.0) == 2.0
    assert fused_kernel(mean)(x, 5.0) == 2.0
    assert np.isinf(kernel(mean)(x, 0.0))  # as NumPy divides
