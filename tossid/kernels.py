"""The one place where kernels are compiled: Numba's decorator, with a cache on disk that an edit cannot outdate.

Numba keeps a compiled function until the function's own file changes, though other functions, constants and named
tuples of other files are compiled into it. Here the cache is valid for a digest of all the code that kernels stand in
or import, and not used at all once one of these files has been edited since the process began. Of several processes
that start at once, one compiles a kernel, and the others wait for it.

Every kernel states its own `fastmath`. Where it is left open, Numba takes it from the caller that happens to be
compiled first, so that the last digits would depend on what ran before.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from typing import Any

import numba
import numpy as np
from numba import types
from numba.core.caching import FunctionCache
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import overload

from tossid.code_digest import digest_of_modules, kernel_modules, modification_times

REORDERED = frozenset({"contract", "reassoc", "arcp", "nsz"})
"""Flags of `fastmath` for sums over many pixels: their order is free, and a division may be a product."""

FUSED = frozenset({"contract"})
"""Flags of `fastmath` by which a product and a sum may be rounded once together; nothing is reordered."""

LONGEST_WAIT_S = 300.0
"""Time for which a process waits for another that compiles the same kernel, before it compiles it itself [s]."""
_POLL_S = 0.05

_BEGAN = modification_times()
_IMPLEMENTATIONS: dict[Callable[..., Any], dict[type, Callable[..., Any]]] = {}


def kernel(
    function: Any = None,
    /,
    *,
    fastmath: frozenset[str] = frozenset(),
    keep: bool = True,
    allocates: bool = True,
    inlined: bool = False,
    from_python: bool = True,
) -> Any:
    """Compile a function with Numba when it is first called: without the interpreter's lock, dividing as NumPy does.

    Args:
        function: what is decorated; `@kernel` and `@kernel(fastmath=...)` both work.
        fastmath: LLVM's flags for arithmetic that may round otherwise than written.
        keep: whether to keep the compiled code on disk.
        allocates: whether the function may make arrays. One that makes none is compiled without counting references:
            to take an array out of a NamedTuple then costs nothing, instead of 10 to 20 ns. What it calls is its own.
        inlined: whether the function becomes part of whatever calls it; for short ones, called in inner loops.
        from_python: whether Python may call the function; if only kernels call it, less has to be compiled.

    Returns:
        The compiled function, or the decorator if no function is given.
    """
    if function is None:
        return partial(
            kernel, fastmath=fastmath, keep=keep, allocates=allocates, inlined=inlined, from_python=from_python
        )
    options = _options(fastmath=fastmath, allocates=allocates, inlined=inlined, from_python=from_python)
    compiled: Any = numba.njit(nogil=True, **options)(function)
    if keep and hasattr(compiled, "enable_caching"):  # a plain function where NUMBA_DISABLE_JIT is set
        compiled._cache = _Cache(function)
        compiled.compile = partial(_compile, compiled.compile, compiled._cache)
    return compiled


def _options(*, fastmath: frozenset[str], allocates: bool, inlined: bool, from_python: bool) -> Any:
    """Numba's options for one function, as `kernel` explains them."""
    options = {"error_model": "numpy", "fastmath": set(fastmath), "_nrt": allocates, "forceinline": inlined}
    return options if from_python else options | {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


fused_kernel = kernel(fastmath=FUSED)
"""The same, with products and sums rounded once together."""

lean_kernel = kernel(allocates=False, from_python=False)
"""One that makes no arrays, for other kernels."""

fused_lean_kernel = kernel(fastmath=FUSED, allocates=False, from_python=False)
"""The same, with products and sums rounded once together."""

inlined_kernel = kernel(allocates=False, inlined=True, keep=False, from_python=False)
"""A short one that makes no arrays, and becomes part of whatever calls it."""

fused_inlined_kernel = kernel(fastmath=FUSED, allocates=False, inlined=True, keep=False, from_python=False)
"""The same, with products and sums rounded once together."""


def by_type(stub: Callable[..., Any]) -> Callable[..., Any]:
    """The stub, which kernels may call once `implements` has named an implementation for the argument's type.

    Args:
        stub: a function whose first argument is a NamedTuple; its docstring says what implementations do.
    """
    table: dict[type, Callable[..., Any]] = {}
    _IMPLEMENTATIONS[stub] = table

    def choose(*arguments: Any) -> Callable[..., Any] | None:
        return table.get(getattr(arguments[0], "instance_class", type(None)))

    overload(
        stub, jit_options=_options(fastmath=frozenset(), allocates=False, inlined=True, from_python=False), strict=False
    )(choose)
    return stub


def implements(stub: Callable[..., Any], kind: type) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A decorator that makes a function the implementation of `stub` for first arguments of a NamedTuple class.

    Args:
        stub: a function declared with `by_type`.
        kind: the NamedTuple class.
    """

    def keep(function: Callable[..., Any]) -> Callable[..., Any]:
        _IMPLEMENTATIONS[stub][kind] = function
        return function

    return keep


def implemented(stub: Callable[..., Any]) -> list[type]:
    """The NamedTuple classes that `stub` has an implementation for.

    Args:
        stub: a function declared with `by_type`.
    """
    return list(_IMPLEMENTATIONS[stub])


@cache
def kernel_digest() -> str:
    """The digest that compiled kernels are kept under.

    Returns:
        SHA-256 over all modules with kernels and what they import, and the versions of Numba and NumPy.
    """
    return f"{digest_of_modules(_modules())} numba {numba.__version__} numpy {np.__version__}"


def _edited() -> bool:
    """Whether a source of kernels was written since this process began: what runs may be what stood there before."""
    return any(_BEGAN.get(name) != now for name, now in modification_times(_modules()).items())


@cache
def _modules() -> frozenset[str]:
    return kernel_modules()


def _is_ours(kind: Any) -> bool:
    """Whether an argument's type has no function in it, and no named tuple of a module that the digest leaves out."""
    named = getattr(kind, "instance_class", None)
    if isinstance(kind, types.Callable) or (named is not None and named.__module__ not in _modules()):
        return False
    return all(_is_ours(part) for part in getattr(kind, "types", ()))


def _compile(by_numba: Callable[[Any], Any], kept: _Cache, sig: Any) -> Any:
    """Load or compile a function for a signature, with Numba's own lock between threads taken before ours."""
    with global_compiler_lock:
        try:
            return by_numba(sig)
        finally:
            kept.give_back()


class _Cache(FunctionCache):
    """Numba's cache of a function's machine code, valid for a digest of all kernels instead of the function's file.

    What is not in it is compiled under a lock between processes: whoever waited for the lock finds it in the cache.
    Kernels call each other without cycles, so that two processes never wait for each other.
    """

    _lock: int | None = None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        if not self._may_be_used(sig):
            return None
        found = self._kept(sig, target_context)
        if found is None and self._lock is None and self._take():
            found = self._kept(sig, target_context)
        return found

    def _kept(self, sig: Any, target_context: Any) -> Any:
        """What the cache has; nothing, and an empty index, where its signatures name types that have moved since."""
        try:
            return super().load_overload(sig, target_context)
        except (ImportError, AttributeError):
            with suppress(OSError):  # a read-only folder
                self._cache_file.flush()
            return None

    def _take(self) -> bool:
        """Take the lock, if there is one to be had; returns whether it was taken."""
        with suppress(OSError):  # a read-only folder, or a file system without `flock`
            os.makedirs(self._cache_path, exist_ok=True)
            path = os.path.join(self._cache_path, f"{self._impl.filename_base}.lock")
            self._lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            until = time.monotonic() + LONGEST_WAIT_S
            while time.monotonic() < until:
                try:
                    fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    return True
                except BlockingIOError:
                    time.sleep(_POLL_S)
        return False

    def give_back(self) -> None:
        """Let others compile the function, or load what was compiled here."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def save_overload(self, sig: Any, data: Any) -> None:
        if self._may_be_used(data.signature.args):
            with suppress(ImportError, AttributeError):  # such an index in a read-only folder
                super().save_overload(sig, data)

    def _may_be_used(self, arguments: Any) -> bool:
        """Whether the digest stands for all that is compiled in: no plug-in's kernel, and no argument of its types."""
        if self._py_func.__module__ not in _modules() or _edited() or not all(_is_ours(kind) for kind in arguments):
            return False
        self._cache_file._source_stamp = kernel_digest()
        return True
