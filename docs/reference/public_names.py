"""A hook of mkdocs: the reference names each public name of a package.

A line `::: tossid.store.*` of a page becomes a line for each name in `tossid.store.__all__` that is no module. Names
that are imported at their first use are invisible to a reader of the source, so the package itself is asked. A line
`::: tossid.settings.**` becomes a line for each module of the package.
"""

from __future__ import annotations

import importlib
import pkgutil
import re
from types import ModuleType
from typing import Any


def public_names(package: str) -> list[str]:
    """The dotted public names of a package, without its modules."""
    module = importlib.import_module(package)
    return [f"{package}.{name}" for name in module.__all__ if not isinstance(getattr(module, name), ModuleType)]


def modules(package: str) -> list[str]:
    """The dotted names of a package's modules, at any depth."""
    found = pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}.")
    return [module.name for module in found if not module.ispkg and "._" not in module.name]


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page with `::: PACKAGE.*` and `::: PACKAGE.**` replaced by what they stand for."""
    for stars, names in ((r"\*\*", modules), (r"\*", public_names)):
        markdown = re.sub(
            rf"^::: ([\w.]+)\.{stars}$",
            lambda found, names=names: "\n\n".join(f"::: {name}" for name in names(found[1])),  # type: ignore[misc]
            markdown,
            flags=re.MULTILINE,
        )
    return markdown
