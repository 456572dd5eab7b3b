"""Compiled kernels: never stale, whichever file is edited; kept where nothing has changed."""

from __future__ import annotations

import errno
import importlib
import pkgutil
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import pytest
from numba import types
from numba.core.caching import NullCache

import tossid
from tests.copied import Copy
from tossid import kernels
from tossid.code_digest import kernel_modules
from tossid.kernels import _Cache, _is_ours, fused_kernel, kernel
from tossid.physics.batch import _fill
from tossid.physics.forces import Forces
from tossid.vision.pose_graph.solver.corner_sums import residual_sizes

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


COMPILES_SLOWLY = """
import os, pathlib, time
from tossid._outer import outer
compile_ = outer._compiler.compile
def slowly(*args):
    pathlib.Path("compiling").touch()
    while not os.path.exists("go"):
        time.sleep(0.02)
    return compile_(*args)
outer._compiler.compile = slowly
print(outer(1.0), len(outer.stats.cache_hits))
"""
WAITS = """
import pathlib
from tossid._outer import outer
pathlib.Path("waiting").touch()
print(outer(1.0), len(outer.stats.cache_hits))
"""


def test_of_two_processes_one_compiles_a_kernel(tmp_path: Path) -> None:
    copy = Copy(tmp_path)
    for name, text in (("_inner", INNER), ("_outer", OUTER)):
        (tmp_path / "tossid" / f"{name}.py").write_text(text)
    with ThreadPoolExecutor(2) as at_once:
        first = at_once.submit(copy.python, COMPILES_SLOWLY)
        wait_for((tmp_path / "compiling").exists, first)
        second = at_once.submit(copy.python, WAITS)
        wait_for((tmp_path / "waiting").exists, second)
        time.sleep(1.0)
        assert not second.done(), "it was to wait for the first"
        (tmp_path / "go").touch()
        assert first.result() == "4.0 0"
        assert second.result() == "4.0 1"


def wait_for(there: Callable[[], bool], process: Future[str]) -> None:
    """Until a file is there; what the process raises, if it ends before."""
    while not there():
        assert not process.done(), process.result()
        time.sleep(0.02)


def test_a_kernel_is_compiled_where_nothing_can_be_locked(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    kept = _Cache(_fill.py_func)
    assert kept._take()
    kept.give_back()
    monkeypatch.setattr(kernels.fcntl, "flock", refuse)
    assert not kept._take()
    kept.give_back()
    assert kept._lock is None


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


def test_an_index_whose_types_have_moved_is_begun_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a clone that was updated: signatures are unpickled, and name modules that are no longer there."""
    emptied: list[bool] = []

    class Moved:
        def load(self, key: object) -> None:
            raise ModuleNotFoundError("No module named 'tossid.moved'")

        def flush(self) -> None:
            emptied.append(True)

    monkeypatch.setattr(residual_sizes._cache, "_cache_file", Moved())
    assert residual_sizes._cache._kept((types.float64,), residual_sizes.targetctx) is None
    assert emptied == [True]
