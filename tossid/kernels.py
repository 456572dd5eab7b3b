"""The one place where kernels are compiled: Numba's decorator, with a cache on disk that an edit cannot outdate.

Numba keeps a compiled function until the function's own file changes, though other functions, constants and named
tuples of other files are compiled into it. Here the cache is valid for a digest of all the code that kernels stand in
or import, and not used at all once one of these files has been edited since the process began.

Every kernel states its own `fastmath`. Where it is left open, Numba takes it from the caller that happens to be
compiled first, so that the last digits would depend on what ran before.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numba
import numpy as np
from numba import types
from numba.core.caching import FunctionCache

from tossid.code_digest import digest_of_modules, kernel_modules, modification_times

REORDERED = frozenset({"contract", "reassoc", "arcp", "nsz"})
"""Flags of `fastmath` for sums over many pixels: their order is free, and a division may be a product."""

_BEGAN = modification_times()


def kernel(
    function: Any = None, /, *, fastmath: frozenset[str] = frozenset(), keep: bool = True, **options: Any
) -> Any:
    """Compile a function with Numba when it is first called: without the interpreter's lock, dividing as NumPy does.

    Args:
        function: what is decorated; `@kernel` and `@kernel(fastmath=...)` both work.
        fastmath: LLVM's flags for arithmetic that may round otherwise than written.
        keep: whether to keep the compiled code on disk.
        **options: further options of `numba.njit`.

    Returns:
        The compiled function, or the decorator if no function is given.
    """
    if function is None:
        return lambda decorated: kernel(decorated, fastmath=fastmath, keep=keep, **options)
    compiled: Any = numba.njit(nogil=True, error_model="numpy", fastmath=set(fastmath), **options)(function)
    if keep and hasattr(compiled, "enable_caching"):  # a plain function where NUMBA_DISABLE_JIT is set
        compiled._cache = _Cache(function)
    return compiled


fused_kernel = kernel(fastmath=frozenset({"contract"}))
"""The same, where a product and a sum may be rounded once together; nothing is reordered."""


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


class _Cache(FunctionCache):
    """Numba's cache of a function's machine code, valid for a digest of all kernels instead of the function's file."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        return super().load_overload(sig, target_context) if self._may_be_used(sig) else None

    def save_overload(self, sig: Any, data: Any) -> None:
        if self._may_be_used(data.signature.args):
            super().save_overload(sig, data)

    def _may_be_used(self, arguments: Any) -> bool:
        """Whether the digest stands for all that is compiled in: no plug-in's kernel, and no argument of its types."""
        if self._py_func.__module__ not in _modules() or _edited() or not all(_is_ours(kind) for kind in arguments):
            return False
        self._cache_file._source_stamp = kernel_digest()
        return True
