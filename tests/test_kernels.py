"""Compiled kernels: never stale, whichever file is edited; kept where nothing has changed."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import pytest

from tests.copied import Copy
from tossid.kernels import by_type, fused_kernel, implements, kernel

SOURCES = {
    "_inner": """
from tossid.kernels import kernel
ADDED = 1.0
@kernel(from_python=False)
def inner(x):
    return x + ADDED
""",
    "_outer": """
from tossid.kernels import by_type, kernel
from tossid._inner import inner
@by_type
def scale(factor): pass
@kernel
def outer(factor, x):
    return scale(factor) * inner(x)
""",
    "_factor": """
from typing import NamedTuple
from tossid._outer import scale
from tossid.kernels import implements
class Two(NamedTuple): pass
@implements(scale, Two)
def two(factor):
    return 2.0
""",
}
CALL = """
from tossid._factor import Two
from tossid._outer import outer
print(outer(Two(), 1.0), len(outer.stats.cache_hits))
"""
EDIT_AND_CALL = f"""
import pathlib, tossid._inner
path = pathlib.Path("tossid/_inner.py")
path.write_text(path.read_text().replace("ADDED = 5.0", "ADDED = 7.0"))
{CALL}"""
CALL_WITH_OWN_TYPE = """
from typing import NamedTuple
from tossid._outer import outer, scale
from tossid.kernels import implements
class Three(NamedTuple): pass
implements(scale, Three)(lambda factor: 3.0)
print(outer(Three(), 1.0), len(outer.stats.cache_hits))
"""
NOTHING_IS_LOCKED = """
import errno, fcntl
def flock(*_):
    raise OSError(errno.ENOLCK, "No locks available")
fcntl.flock = flock
"""
COMPILE_SLOWLY = f"""
import os, pathlib, time
from tossid._outer import outer
compile_ = outer._compiler.compile
def slowly(*args):
    pathlib.Path("compiling").touch()
    while not os.path.exists("go"):
        time.sleep(0.02)
    return compile_(*args)
outer._compiler.compile = slowly
{CALL}"""
WAIT = f"""
import pathlib
from tossid._outer import outer
pathlib.Path("waiting").touch()
{CALL}"""


@pytest.fixture
def copy(tmp_path: Path) -> Copy:
    found = Copy(tmp_path)
    for name, text in SOURCES.items():
        (tmp_path / "tossid" / f"{name}.py").write_text(text)
    return found


def test_a_kernel_is_compiled_anew_where_code_that_it_is_made_of_is_edited(copy: Copy) -> None:
    assert copy.python(NOTHING_IS_LOCKED + CALL) == "4.0 0"
    assert copy.python(NOTHING_IS_LOCKED + CALL) == "4.0 1"
    copy.edit("tossid/_inner.py", r"^", "# a comment\n")
    copy.edit("tossid/_inner.py", r"\Z", "\nSPARE = 1\n")  # which is no part of it
    assert copy.python(CALL) == "4.0 1"
    copy.edit("tossid/_inner.py", r"ADDED = 1\.0", "ADDED = 5.0")
    assert copy.python(CALL) == "12.0 0"
    # an implementation for an argument's type, which stands in no import of the kernel's module
    copy.edit("tossid/_factor.py", r"2\.0", "3.0")
    assert copy.python(CALL) == "18.0 0"
    # edited while a process runs, which keeps what it has read
    assert copy.python(EDIT_AND_CALL) == "18.0 1"
    assert copy.python(CALL) == "24.0 0"
    # a type of the user's own, which other processes cannot unpickle
    assert copy.python(CALL_WITH_OWN_TYPE) == copy.python(CALL_WITH_OWN_TYPE) == "24.0 0"
    # as in a clone that was updated: the index's signatures are unpickled, and name a module that is no longer there
    (copy.folder / "tossid/_factor.py").rename(copy.folder / "tossid/_moved.py")
    assert [copy.python(CALL.replace("_factor", "_moved")) for _ in range(2)] == ["24.0 0", "24.0 1"]


def test_of_two_processes_one_compiles_a_kernel(copy: Copy) -> None:
    with ThreadPoolExecutor(2) as at_once:
        first = at_once.submit(copy.python, COMPILE_SLOWLY)
        wait_for((copy.folder / "compiling").exists, first)
        second = at_once.submit(copy.python, WAIT)
        wait_for((copy.folder / "waiting").exists, second)
        time.sleep(1.0)
        assert not second.done(), "it was to wait for the first"
        (copy.folder / "go").touch()
        assert first.result() == "4.0 0"
        assert second.result() == "4.0 1"


def wait_for(there: Callable[[], bool], process: Future[str]) -> None:
    """Until a file is there; what the process raises, if it ends before."""
    while not there():
        assert not process.done(), process.result()
        time.sleep(0.02)


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


class Halved(NamedTuple):
    x: float


class Doubled(NamedTuple):
    x: float


@by_type
def value(number):  # type: ignore[no-untyped-def]
    """A number's value."""


@implements(value, Halved)
def _half(number):  # type: ignore[no-untyped-def]
    return number.x / 2.0


@implements(value, Doubled)
def _double(number):  # type: ignore[no-untyped-def]
    return number.x * 2.0


def test_the_type_of_an_argument_chooses_the_implementation_in_kernels_and_in_python() -> None:
    @kernel
    def compiled(number):  # type: ignore[no-untyped-def]
        return value(number)

    for number, expected in ((Halved(4.0), 2.0), (Doubled(4.0), 8.0)):
        assert compiled(number) == value(number) == expected
    with pytest.raises(numba.TypingError):
        compiled((1.0,))
    with pytest.raises(KeyError):
        value((1.0,))
