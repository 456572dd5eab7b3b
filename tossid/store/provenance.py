"""What a dataset says of the call that made it."""

from __future__ import annotations

from importlib import metadata
from typing import Any

import yaml

from tossid.plain_json import jsonable


def provenance_of(call: str, settings: Any, **more: Any) -> dict[str, str | int | float | bool]:
    """The call, tossid's version, and all settings as YAML.

    Args:
        call: What was called ("tossid.ingest").
        settings: A settings dataclass.
        **more: Further settings.
    """
    try:
        version = metadata.version("tossid")
    except metadata.PackageNotFoundError:
        version = "unknown"
    config = yaml.safe_dump({**more, **jsonable(settings)}, sort_keys=False, allow_unicode=True)
    return {"command": call, "version": version, "config": config}
