"""A hook of mkdocs: the reference names each public name of a package.

A line `::: tossid.store.*` of a page becomes a line for each name in `tossid.store.__all__` that is no module. Names
that are imported at their first use are invisible to a reader of the source, so the package itself is asked.
"""

from __future__ import annotations

import importlib
import re
from types import ModuleType
from typing import Any


def public_names(package: str) -> list[str]:
    """The dotted public names of a package, without its modules."""
    module = importlib.import_module(package)
    return [f"{package}.{name}" for name in module.__all__ if not isinstance(getattr(module, name), ModuleType)]


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page with each `::: PACKAGE.*` replaced by its public names."""
    return re.sub(
        r"^::: ([\w.]+)\.\*$",
        lambda found: "\n\n".join(f"::: {name}" for name in public_names(found[1])),
        markdown,
        flags=re.MULTILINE,
    )
