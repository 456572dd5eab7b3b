"""Names of a package that are imported when they are first used (PEP 562), so that importing it stays quick."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import sys
from collections.abc import Callable
from typing import Any


def imported_at_first_use(package: str) -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """The public names of a package, its `__getattr__` and its `__dir__`.

    Args:
        package: The package's `__name__`. Its source imports its public names under `if TYPE_CHECKING:`, where type
            checkers find them, and this function too.

    Returns:
        The names (`__all__`); a function from a name, or that of a module in the package, to what it stands for, which
        raises AttributeError for others; and one that lists all of them.
    """
    module = sys.modules[package]
    parts = [part for part in ast.parse(inspect.getsource(module)).body if isinstance(part, ast.If)]
    imports = [line for part in parts for line in part.body if isinstance(line, ast.ImportFrom)]
    homes = {name.name: str(line.module) for line in imports for name in line.names}
    inside = {found.name for found in pkgutil.iter_modules(module.__path__)}

    def get(name: str) -> Any:
        if name in homes:
            vars(module)[name] = getattr(importlib.import_module(homes[name]), name)
            return vars(module)[name]
        if name in inside:
            return importlib.import_module(f"{package}.{name}")
        raise AttributeError(f"module '{package}' has no attribute {name!r}")

    return [*homes], get, lambda: sorted({*vars(module), *homes, *inside})
