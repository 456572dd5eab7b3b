"""Digests of code: results and compiled kernels are kept under one, and made anew when the code that made them changes.

The code of a result is the module that computes it and all that this module imports, directly or through others,
inside the packages of the project. It is read from the source text, so nothing is imported for it. Comments, docstrings
and layout do not count. What is registered from outside (an effect, a model, a solver of the user's own) counts too,
and so do the versions of the packages that compute (`tossid.versions`).
"""

from __future__ import annotations

import ast
import hashlib
import inspect
from collections.abc import Iterable, Iterator
from dataclasses import is_dataclass
from functools import cache
from importlib.util import resolve_name
from pathlib import Path
from types import CodeType
from typing import Any, NamedTuple

from tossid.versions import computing_versions

ROOT = Path(__file__).resolve().parents[1]
"""The folder that holds the packages."""
PACKAGES = ("tossid", "pipelines")

_outside: dict[str, dict[str, str]] = {}
"""What was registered from outside the packages: by registry, the digest of each function and class."""


def code_digest(*modules: str) -> str:
    """Hash of the code that runs when one of the modules computes.

    It covers the modules, all that they import, and the versions of the packages that compute.

    Args:
        modules: names in full, as tossid.training.api.

    Returns:
        SHA-256 in hexadecimal.

    Raises:
        KeyError: there is no such module in the packages of the project.
    """
    found = hashlib.sha256(_digest_of_modules(modules).encode())
    for name, version in sorted(computing_versions().items()):
        found.update(f"{name} {version}\n".encode())
    reached = imported_modules(*modules) if _outside else frozenset()
    for registry in sorted(reached & _outside.keys()):
        for name, digest in sorted(_outside[registry].items()):
            found.update(f"{name}\n{digest}\n".encode())
    return found.hexdigest()


def note_registered(registry: str, *registered: Any) -> None:
    """Let digests of code that reaches a registry depend on what is registered there from outside the packages.

    Args:
        registry: The module in which the registry stands.
        *registered: Classes and functions, and objects that hold some. What the packages themselves register counts by
            its imports already.
    """
    for part in _functions_and_classes(registered):
        if not _in_packages(part.__module__):
            digest = hashlib.sha256(_source_of(part).encode()).hexdigest()
            _outside.setdefault(registry, {})[f"{part.__module__}.{part.__qualname__}"] = digest


def imported_modules(*modules: str, registered: bool = True) -> frozenset[str]:
    """The modules, and all that they import directly or through others, inside the packages.

    A name that a package's `__init__` only passes on leads to the module that defines it, not to all that the package
    has.

    Args:
        *modules: Names in full.
        registered: Whether a module that registers something at its top level belongs to whatever reaches its registry.
    """
    found: set[str] = set()
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += _imports(name)
        if not waiting and registered:
            waiting = [name for name, registries in _registering().items() if name not in found and registries & found]
    return frozenset(found)


@cache
def fingerprint(module: str) -> str:
    """Hash of one module's code as Python compiles it: comments, docstrings and layout do not count."""
    found = hashlib.sha256()
    for part in _parts(compile(_source(module), module, "exec", optimize=2, dont_inherit=True)):
        found.update(part.encode() + b"\n")
    return found.hexdigest()


def modification_time(module: str) -> int:
    """When the module's file was last written [ns since the epoch]; 0 if it is gone."""
    try:
        return _files()[module].stat().st_mtime_ns
    except OSError:
        return 0


def all_modules() -> frozenset[str]:
    """The modules of the packages."""
    return frozenset(_files())


@cache
def _digest_of_modules(modules: tuple[str, ...]) -> str:
    return digest_of_modules(imported_modules(*modules))


def digest_of_modules(modules: Iterable[str]) -> str:
    """Hash of the code of just these modules."""
    found = hashlib.sha256()
    for name in sorted(modules):
        found.update(f"{name}\n{fingerprint(name)}\n".encode())
    return found.hexdigest()


def _parts(code: CodeType) -> Iterator[str]:
    """What a code object does, without where it stands."""
    yield code.co_code.hex()
    yield f"{code.co_name} {code.co_names} {code.co_varnames} {code.co_freevars} {code.co_cellvars} {code.co_flags}"
    yield f"{code.co_argcount} {code.co_posonlyargcount} {code.co_kwonlyargcount} {code.co_exceptiontable.hex()}"
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _parts(constant)
        elif "__firstlineno__" not in code.co_names or constant != code.co_firstlineno:  # a class notes its line
            yield repr(sorted(map(repr, constant)) if isinstance(constant, frozenset) else constant)


# ---------------------------------------------------------------- the graph of imports


@cache
def _files() -> dict[str, Path]:
    """The source file of each module."""
    paths = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
    return {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in paths}


@cache
def _source(module: str) -> str:
    return _files()[module].read_text(encoding="utf-8")


class _Read(NamedTuple):
    """What the graph needs of a module's syntax tree, without docstrings and what only type checkers read.

    Attributes:
        imports: Each as (module, name); the name is "" where the module itself is imported.
        texts: Modules that it names in full, as text.
        passed_on: The module of each name, as an `__init__` that imports when a name is used tells type checkers, or
            has it in a dictionary.
        called: Names of functions that it calls in a statement at its top, or decorates with.
    """

    imports: frozenset[tuple[str, str]]
    texts: frozenset[str]
    passed_on: dict[str, str]
    called: frozenset[str]


@cache
def _read(module: str) -> _Read:
    tree = ast.parse(_source(module))
    package = module if _files()[module].name == "__init__.py" else module.rpartition(".")[0]
    imports: set[tuple[str, str]] = set()
    texts: set[str] = set()
    passed_on: dict[str, str] = {}
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            continue
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            sources = [each for each in node.body if isinstance(each, ast.ImportFrom) and each.module in _files()]
            passed_on |= {alias.name: str(each.module) for each in sources for alias in each.names}
            continue
        if isinstance(node, ast.Import):
            imports |= {(alias.name, "") for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            relative = "." * node.level + (node.module or "")
            imports |= {(resolve_name(relative, package), alias.name) for alias in node.names}
        elif isinstance(node, ast.Dict):
            for key, value in zip(node.keys, node.values, strict=True):
                if isinstance(key, ast.Constant) and isinstance(value, ast.Constant) and value.value in _files():
                    passed_on[str(key.value)] = str(value.value)
        elif isinstance(node, ast.Constant) and node.value in _files() and node.value not in PACKAGES:
            texts.add(node.value)
        waiting += ast.iter_child_nodes(node)
    return _Read(frozenset(imports), frozenset(texts), passed_on, frozenset(_called_at_top(tree)))


def _called_at_top(tree: ast.Module) -> Iterator[str]:
    for statement in tree.body:
        called = [statement.value] if isinstance(statement, ast.Expr) else getattr(statement, "decorator_list", [])
        for call in called:
            function = call.func if isinstance(call, ast.Call) else call
            if isinstance(function, ast.Name):
                yield function.id


@cache
def _imports(module: str) -> frozenset[str]:
    """What a module imports, at its top or inside a function, and modules that it names in full as text."""
    read = _read(module)
    return read.texts | {_home(source, name) for source, name in read.imports if source in _files()}


def _home(source: str, name: str) -> str:
    """The module that `from source import name` needs."""
    if f"{source}.{name}" in _files():
        return f"{source}.{name}"
    if _files()[source].name == "__init__.py" and name in (passed := _passed_on(source)):
        return _home(*passed[name])
    return source


def _passed_on(package: str) -> dict[str, tuple[str, str]]:
    """Names that a package's `__init__` takes from elsewhere, when it is imported or when they are first used."""
    read = _read(package)
    found = {name: (home, name) for name, home in read.passed_on.items()}
    return found | {name: (home, name) for home, name in read.imports if name and home in _files()}


@cache
def _registering() -> dict[str, set[str]]:
    """Modules that call or decorate with a `register...` of another module at their top level, and those others."""
    found: dict[str, set[str]] = {}
    for module in _files():
        if "register" in _source(module):
            read = _read(module)
            called = {name for name in read.called if name.startswith("register")}
            homes = {_home(home, name) for home, name in read.imports if name in called and home in _files()}
            if homes - {module}:
                found[module] = homes - {module}
    return found


# ---------------------------------------------------------------- what is registered from outside


def _in_packages(module: str) -> bool:
    return module.partition(".")[0] in PACKAGES


def _functions_and_classes(value: Any) -> Iterator[Any]:
    """Those that a value is or holds: in tuples, dataclasses, partial functions and compiled kernels."""
    if inspect.isclass(value) or inspect.isfunction(value):
        yield value
    elif isinstance(value, (tuple, list)):
        for each in value:
            yield from _functions_and_classes(each)
    elif is_dataclass(value):
        yield type(value)
        yield from _functions_and_classes(tuple(vars(value).values()))
    else:
        for name in ("py_func", "func"):
            if hasattr(value, name):
                yield from _functions_and_classes(getattr(value, name))


def _source_of(part: Any) -> str:
    """The file that a function or class stands in; of one that is typed into a notebook, its own code."""
    try:
        return Path(inspect.getfile(part)).read_text(encoding="utf-8")
    except (OSError, TypeError):
        code = getattr(part, "__code__", None)
        return "".join(_parts(code)) if code is not None else part.__qualname__
