"""What a dataset says of the call that made it."""

from __future__ import annotations

import json
from typing import Any

import yaml

from tossid.plain_json import jsonable
from tossid.versions import computing_versions, package_version


def provenance_of(call: str, settings: Any, **more: Any) -> dict[str, str | int | float | bool]:
    """The call, tossid's version, the versions of all that computes as JSON, and all settings as YAML.

    Args:
        call: What was called ("tossid.ingest").
        settings: A settings dataclass.
        **more: Further settings.
    """
    config = yaml.safe_dump({**more, **jsonable(settings)}, sort_keys=False, allow_unicode=True)
    versions = json.dumps(computing_versions())
    return {"command": call, "version": package_version("tossid"), "versions": versions, "config": config}
