"""Datasets as commands write them: with their lineage, and described afterwards as `info` would."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from pipelines.cli.console import Console
from pipelines.commands.info import show
from pipelines.config.compose import as_plain
from pipelines.execution.code_version import commit, version
from tossid.store import dataset_info
from tossid.versions import computing_versions

Lineage = Mapping[str, str | int | float | bool]

_NOT_LINEAGE = ("out", "threads")
"""Keys that leave the data as they are: the same data from the same call are the same bytes."""


def provenance(command: str, config: Any, lineage: Lineage) -> dict[str, str | int | float | bool]:
    """Where a dataset comes from.

    Args:
        command: The command that made it.
        config: All its keys.
        lineage: Source path and hash, covariances' origin, and the like.

    Returns:
        Values by name.
    """
    keys = {name: value for name, value in as_plain(config).items() if name not in _NOT_LINEAGE}
    return {
        "command": f"tossid {command}",
        "version": version(),
        "commit": commit(),
        "versions": json.dumps(computing_versions()),
        "config": yaml.safe_dump(keys, sort_keys=False, allow_unicode=True),
        **lineage,
    }


def described(path: Path, console: Console) -> dict[str, Any]:
    """What `tossid info` says of a dataset that was just written, and `out`."""
    facts = {**dataset_info(path), "out": str(path)}
    show({name: value for name, value in facts.items() if name != "provenance"}, console, title=f"wrote {path}")
    return facts
