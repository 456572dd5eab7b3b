"""The one place where kernels are compiled: Numba's decorator, with a cache on disk that an edit cannot outdate.

Numba keeps a compiled function until the function's own file changes, though other functions, constants and named
tuples of other files are compiled into it. Here it is kept under a digest of all the code that it can be made of: the
imports of its own module, and those of the modules of its arguments' types. It is not kept at all once one of these
files has been edited since the process began. Of several processes that start at once, one compiles a kernel, and the
others wait for it.

Every kernel states its own `fastmath`. Where it is left open, Numba takes it from the caller that happens to be
compiled first, so that the last digits would depend on what ran before.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, partial, wraps
from typing import Any

import numba
import numpy as np
from numba import types
from numba.core.caching import FunctionCache
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import overload

from tossid.code_digest import all_modules, digest_of_modules, imported_modules, modification_time

REORDERED = frozenset({"contract", "reassoc", "arcp", "nsz"})
"""Flags of `fastmath` for sums over many pixels: their order is free, and a division may be a product."""

FUSED = frozenset({"contract"})
"""Flags of `fastmath` by which a product and a sum may be rounded once together; nothing is reordered."""

_WRITTEN = {module: modification_time(module) for module in all_modules()}
"""When each source was written, as the process began."""
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
        with suppress(RuntimeError):  # no folder can be written to
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
    """A function that calls the implementation that `implements` has named for its first argument's type.

    Args:
        stub: a function whose first argument is a NamedTuple; its docstring says what implementations do.
    """
    table: dict[type, Callable[..., Any]] = {}

    @wraps(stub)
    def in_python(*arguments: Any) -> Any:
        return table[type(arguments[0])](*arguments)

    def choose(*arguments: Any) -> Callable[..., Any] | None:
        return table.get(getattr(arguments[0], "instance_class", type(None)))

    _IMPLEMENTATIONS[in_python] = table
    overload(
        in_python,
        jit_options=_options(fastmath=frozenset(), allocates=False, inlined=True, from_python=False),
        strict=False,
    )(choose)
    return in_python


def implements(stub: Callable[..., Any], kind: type) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A decorator that makes a function the implementation of `stub` for first arguments of a NamedTuple class.

    It stands in the module of the class: what is compiled is kept under a digest of the modules of its arguments'
    types, among others.

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
def _key(modules: frozenset[str]) -> str:
    """Digest of the code that these modules import, and the versions of what compiles it."""
    return f"{digest_of_modules(_imported(modules))} numba {numba.__version__} numpy {np.__version__}"


@cache
def _imported(modules: frozenset[str]) -> frozenset[str]:
    return imported_modules(*modules, registered=False)


def _is_as_it_was(modules: frozenset[str]) -> bool:
    """Whether what these modules import is ours, and was not written since this process began.

    What runs may otherwise not be what stands in the files.
    """
    return modules <= _WRITTEN.keys() and all(modification_time(name) == _WRITTEN[name] for name in _imported(modules))


def _modules_of(kinds: Iterable[Any]) -> Iterator[str]:
    """The modules of the named tuples among Numba's types, and in them; of a function, a name that no module has."""
    for kind in kinds:
        if isinstance(kind, types.Callable):
            yield "<function>"
        if hasattr(kind, "instance_class"):
            yield kind.instance_class.__module__
        yield from _modules_of(getattr(kind, "types", ()))


def _compile(by_numba: Callable[[Any], Any], kept: _Cache, sig: Any) -> Any:
    """Load or compile a function for a signature, with Numba's own lock between threads taken before ours."""
    with global_compiler_lock, kept.locked():
        return by_numba(sig)


class _Cache(FunctionCache):
    """Numba's cache of a function's machine code, valid for digests of code instead of the function's file.

    It is read and filled under a lock between processes. Kernels call each other without cycles, so that two processes
    never wait for each other.
    """

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other processes from this function's cache, where there are locks."""
        lock = None
        with suppress(OSError):  # a read-only folder, or a file system without `flock`
            os.makedirs(self._cache_path, exist_ok=True)
            path = os.path.join(self._cache_path, f"{self._impl.filename_base}.lock")
            lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            yield
        finally:
            if lock is not None:
                os.close(lock)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        if not self._may_be_used(sig):
            return None
        try:
            return super().load_overload(sig, target_context)
        except (ImportError, AttributeError):  # its index names types that have moved since
            with suppress(OSError):  # a read-only folder
                self._cache_file.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        if self._may_be_used(sig):
            with suppress(ImportError, AttributeError):  # such an index in a read-only folder
                super().save_overload(sig, data)

    def _may_be_used(self, sig: Any) -> bool:
        """Whether digests stand for all that is compiled in: no plug-in's code, and none that was just edited."""
        own = frozenset([self._py_func.__module__])
        if not (_is_as_it_was(own) and _is_as_it_was(frozenset(_modules_of(sig)))):
            return False
        self._cache_file._source_stamp = _key(own)
        return True

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return (*super()._index_key(sig, codegen), _key(frozenset(_modules_of(sig))))
