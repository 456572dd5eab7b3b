"""One digest of the project's code: results are kept under it, and made anew when the code that made them may differ.

It covers the sources of a package as they stand in its files, what is registered from outside (an effect, a model, a
solver of the user's own), and the versions of the packages that compute (`tossid.versions`).
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Iterator
from dataclasses import is_dataclass
from functools import cache
from pathlib import Path
from types import CodeType
from typing import Any

from tossid.versions import computing_versions

ROOT = Path(__file__).resolve().parents[1]
"""The folder that holds the packages."""

_outside: dict[str, str] = {}
"""Digests of the functions and classes that were registered from outside, by their names in full."""


def code_digest(*packages: str) -> str:
    """Hash of the code that computes.

    Args:
        *packages: Whose sources count; tossid if none is named.

    Returns:
        SHA-256 in hexadecimal.
    """
    parts = [_sources(package) for package in packages or ("tossid",)]
    parts += [f"{name} {version}" for name, version in sorted(computing_versions().items())]
    parts += [f"{name} {digest}" for name, digest in sorted(_outside.items())]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


@cache
def _sources(package: str) -> str:
    """Hash of a package's sources."""
    found = hashlib.sha256()
    for path in sorted((ROOT / package).rglob("*.py")):
        found.update(f"{path.relative_to(ROOT).as_posix()}\n".encode() + path.read_bytes())
    return found.hexdigest()


def note_registered(*registered: Any) -> None:
    """Let the digest depend on what is registered from outside the packages.

    Args:
        *registered: Classes and functions, and objects that hold some.
    """
    for part in _functions_and_classes(registered):
        if not part.__module__.startswith(("tossid.", "pipelines.")):
            _outside[f"{part.__module__}.{part.__qualname__}"] = hashlib.sha256(_source_of(part).encode()).hexdigest()


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
        return code_text(code) if code is not None else part.__qualname__


def code_text(code: CodeType) -> str:
    """What a function's code does, as text without its docstring and without where it stands."""
    names = f"{code.co_name} {code.co_names} {code.co_varnames} {code.co_freevars} {code.co_cellvars} {code.co_flags}"
    counts = f"{code.co_argcount} {code.co_posonlyargcount} {code.co_kwonlyargcount} {code.co_exceptiontable.hex()}"
    constants = code.co_consts[1:] if code.co_consts and isinstance(code.co_consts[0], str) else code.co_consts
    parts = [code.co_code.hex(), names, counts]
    for constant in constants:
        if isinstance(constant, CodeType):
            parts.append(code_text(constant))
        else:
            parts.append(repr(sorted(map(repr, constant)) if isinstance(constant, frozenset) else constant))
    return "\n".join(parts)
