"""The one place where kernels are compiled: Numba's decorator, with a cache on disk that an edit cannot outdate.

Numba keeps a compiled function until the function's own file changes, though other functions, constants and named
tuples of other files are compiled into it. Here it is kept under a digest of what it is made of (`_key`), as this
process has it. Of several processes that start at once, one compiles a kernel, and the others wait for it.

Every kernel states its own `fastmath`. Where it is left open, Numba takes it from the caller that happens to be
compiled first, so that the last digits would depend on what ran before.
"""

from __future__ import annotations

import fcntl
import hashlib
import inspect
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from enum import EnumMeta
from functools import cache, partial, wraps
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import numba
import numpy as np
from llvmlite import binding as llvm
from numba import types
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import LoweringPass, register_pass
from numba.core.typed_passes import AnnotateTypes
from numba.extending import overload

from tossid.code_digest import code_text, note_registered
from tossid.errors import InputError

REORDERED = frozenset({"contract", "reassoc", "arcp", "nsz"})
"""Flags of `fastmath` for sums over many pixels: their order is free, and a division may be a product."""

FUSED = frozenset({"contract"})
"""Flags of `fastmath` by which a product and a sum may be rounded once together; nothing is reordered."""

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
        from_python: whether Python may call the function; if only kernels call it, it is optimised as part of these.

    Returns:
        The compiled function, or the decorator if no function is given.
    """
    if function is None:
        return partial(
            kernel, fastmath=fastmath, keep=keep, allocates=allocates, inlined=inlined, from_python=from_python
        )
    options = _options(fastmath=fastmath, allocates=allocates, inlined=inlined, from_python=from_python)
    compiled: Any = numba.njit(nogil=True, **options)(function)
    if not hasattr(compiled, "enable_caching"):  # a plain function where NUMBA_DISABLE_JIT is set
        return compiled
    compiled.get_call_template = partial(_without_literals, compiled.get_call_template)
    if keep:
        with suppress(RuntimeError):  # no folder can be written to
            compiled._cache = _Cache(function)
            compiled.compile = partial(_compile, compiled.compile, compiled._cache)
    return compiled


def _without_literals(template: Callable[..., Any], args: Sequence[Any], kws: dict[str, Any]) -> Any:
    """Numba's choice of a compiled function for a call, by types alone: it would compile one for each constant, too."""
    return template(tuple(map(types.unliteral, args)), {name: types.unliteral(kind) for name, kind in kws.items()})


def _options(*, fastmath: frozenset[str], allocates: bool, inlined: bool, from_python: bool) -> Any:
    """Numba's options for one function, as `kernel` explains them."""
    options = {"error_model": "numpy", "fastmath": set(fastmath), "_nrt": allocates, "forceinline": inlined}
    if from_python:
        return options
    return options | {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": _PartCompiler}


fused_kernel = kernel(fastmath=FUSED)
"""The same, with products and sums rounded once together."""

part_kernel = kernel(from_python=False)
"""The same as `kernel`, for other kernels only."""

fused_part_kernel = kernel(fastmath=FUSED, from_python=False)
"""The same, with products and sums rounded once together."""

lean_kernel = kernel(allocates=False, from_python=False)
"""One that makes no arrays, for other kernels."""

fused_lean_kernel = kernel(fastmath=FUSED, allocates=False, from_python=False)
"""The same, with products and sums rounded once together."""

inlined_kernel = kernel(allocates=False, inlined=True, from_python=False)
"""A short one that makes no arrays, and becomes part of whatever calls it."""

fused_inlined_kernel = kernel(fastmath=FUSED, allocates=False, inlined=True, from_python=False)
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


class _Part(JITCodeLibrary):
    """Code that only kernels call: it is optimised, and turned into machine code, as part of what Python calls.

    Numba does both for every function, each with all that it calls: for the innermost of a dozen a dozen times.
    """

    def _optimize_final_module(self) -> None:
        return

    def _finalize_final_module(self) -> None:
        code = self._final_module
        for function in code.functions:
            if not function.is_declaration and function.linkage == llvm.Linkage.external:
                function.linkage = llvm.Linkage.linkonce_odr  # as Numba marks what others link in
        self._finalize_dynamic_globals()
        self._shared_module = code
        # machine code of nothing but the function's environment, whose address Numba asks for
        own = [str(each) for each in code.global_variables if each.linkage == llvm.Linkage.common]
        empty = str(self._codegen._create_empty_module(self.name))
        self._final_module = llvm.parse_assembly("\n".join([empty, *own]))
        super()._finalize_final_module()


@register_pass(mutates_CFG=False, analysis_only=True)
class _AsPart(LoweringPass):
    """Numba's step that chooses what a function's code is kept in."""

    _name = "as_part"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        codegen = state.targetctx.codegen()
        state.library = _Part(codegen, state.func_id.func_qualname)
        state.library.enable_object_caching()
        return False


class _PartCompiler(CompilerBase):
    """Numba's compiler with that step."""

    def define_pipelines(self) -> Any:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_AsPart, AnnotateTypes)
        passes.finalize()
        return [passes]


def register_implementation(
    stub: Callable[..., Any], kind: type, function: Callable[..., Any], arguments: Sequence[str], what: str
) -> None:
    """Note a user's function for a NamedTuple class, before it becomes the class's implementation of `stub`.

    Args:
        stub: a function declared with `by_type`.
        kind: the class.
        function: the user's.
        arguments: names of what it is to take.
        what: what the function is called in messages, such as "contact solver".

    Raises:
        InputError: the class is no NamedTuple class or has such a function already, or it takes other arguments.
    """
    if not (isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields")):
        raise InputError(f"a {what} was registered for {kind!r}, expected a NamedTuple class of its numbers")
    if kind in implemented(stub):
        raise InputError(f"{kind.__name__} has a {what} already; register a class of another name")
    taken = list(inspect.signature(getattr(function, "py_func", function)).parameters)
    if len(taken) != len(arguments):
        raise InputError(
            f"the {what} {function.__name__} takes ({', '.join(taken)}), expected ({', '.join(arguments)})"
        )
    note_registered(kind, function)


_COMPILED_BY = f"{hashlib.sha256(Path(__file__).read_bytes()).hexdigest()} {numba.__version__} {np.__version__}"


@cache
def _key(function: Callable[..., Any], kinds: frozenset[type]) -> str:
    """Digest of all that a function's machine code is made of, and of what compiles it.

    That is the code of every function that it calls, directly or through others, the constants that these read, and
    the named tuples among its arguments.

    Args:
        function: As it is written.
        kinds: The named tuples among its arguments, by which `by_type` chooses.
    """
    found, seen = hashlib.sha256(_COMPILED_BY.encode()), {function}
    found.update("".join(_constant(kind) for kind in sorted(kinds, key=_name)).encode())
    waiting: list[Any] = [function]
    while waiting:
        each = waiting.pop()
        found.update(f"{code_text(each.__code__)}\n{each.__defaults__}\n".encode())
        for name, value in _read(each):
            called = _called(value, kinds)
            options = sorted((key, _name(option)) for key, option in getattr(value, "targetoptions", {}).items())
            text = _constant(value) if called is None else f"{[_name(function) for function in called]} {options}"
            found.update(f"{name} {text}\n".encode())
            waiting += (new := [function for function in called or () if function not in seen])
            seen.update(new)
    return found.hexdigest()


def _read(function: Any) -> list[tuple[str, Any]]:
    """The globals, names of modules and variables of enclosing functions that a function may read."""
    names, codes = set(), [function.__code__]
    for code in codes:
        names |= {*code.co_names}
        codes += [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    held = {name: function.__globals__[name] for name in sorted(names & function.__globals__.keys())}
    for module in [value for value in held.values() if isinstance(value, ModuleType)]:
        held |= {f"{module.__name__}.{name}": vars(module)[name] for name in sorted(names & vars(module).keys())}
    closure = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    return [*held.items(), *((name, cell.cell_contents) for name, cell in closure)]


def _called(value: Any, kinds: frozenset[type]) -> list[Callable[..., Any]] | None:
    """The functions that are compiled where a kernel calls a value; None if it is no kernel."""
    if hasattr(value, "py_func"):
        return [value.py_func]
    table = _IMPLEMENTATIONS.get(value) if inspect.isfunction(value) else None
    return None if table is None else [table[kind] for kind in sorted(table.keys() & kinds, key=_name)]


def _constant(value: Any) -> str:
    """A value that is compiled in, as text; of what can only be called, its name."""
    fields = getattr(value, "_fields", None)
    if fields is not None and inspect.isclass(value):  # a named tuple's
        return f"{_name(value)} {fields} {getattr(value, '_field_defaults', {})}"
    if isinstance(value, EnumMeta):
        return f"{_name(value)} {value.__members__}"
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    return _name(value)


def _name(value: Any) -> str:
    """The name in full of what has one, else the value."""
    if hasattr(value, "__qualname__"):
        return f"{value.__module__}.{value.__qualname__}"
    if isinstance(value, set | frozenset):
        return repr(sorted(map(repr, value)))
    return value.__name__ if isinstance(value, ModuleType) else repr(value)


def _kinds(of: Iterable[Any]) -> Iterator[type]:
    """The named tuples among Numba's types, and in them; of a function, Numba's own type."""
    for kind in of:
        if isinstance(kind, types.Callable):
            yield type(kind)
        if hasattr(kind, "instance_class"):
            yield kind.instance_class
        yield from _kinds(getattr(kind, "types", ()))


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
        if not self._is_ours(sig):
            return None
        try:
            return super().load_overload(sig, target_context)
        except (ImportError, AttributeError):  # its index names types that have moved since
            with suppress(OSError):  # a read-only folder
                self._cache_file.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        if self._is_ours(sig):
            with suppress(ImportError, AttributeError):  # such an index in a read-only folder
                super().save_overload(sig, data)

    def _is_ours(self, sig: Any) -> bool:
        """Whether every process knows the types of the arguments: whoever opens the index unpickles them all."""
        self._cache_file._source_stamp = _key(self._py_func, frozenset())
        return all(kind.__module__.startswith("tossid.") for kind in _kinds(sig))

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return (*super()._index_key(sig, codegen), _key(self._py_func, frozenset(_kinds(sig))))
