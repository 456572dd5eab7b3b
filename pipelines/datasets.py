"""Datasets as commands write them: with their lineage, and described afterwards as `info` would."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from pipelines.config import as_plain
from pipelines.console import Console
from pipelines.info import show
from pipelines.version import commit, version
from tossid.errors import InputError
from tossid.store import dataset_info, write_dataset
from tossid.types import Dataset

if TYPE_CHECKING:
    from tossid.objects import ObjectModel
    from tossid.types import Toss

_NOT_LINEAGE = ("out", "threads")
"""Keys that leave the data as they are: the same data from the same call are the same bytes."""


def save(
    tosses: Sequence[Toss],
    model: ObjectModel,
    path: Path,
    *,
    rate_hz: float,
    source: str,
    command: str,
    config: Any,
    lineage: dict[str, str | int | float | bool],
) -> None:
    """Write a dataset with where it comes from.

    Args:
        path: the file, as `output_file` yields it.
        source: importer or simulator.
        command, config: what made it, with all its keys.
        lineage: source path and hash, covariances' origin, and the like.
    """
    if not tosses:
        raise InputError("no toss was found; there is nothing to write")
    keys = {name: value for name, value in as_plain(config).items() if name not in _NOT_LINEAGE}
    provenance = {
        "command": f"tossid {command}",
        "version": version(),
        "commit": commit(),
        "config": yaml.safe_dump(keys, sort_keys=False, allow_unicode=True),
        **lineage,
    }
    write_dataset(Dataset(model, tuple(tosses), float(rate_hz), source, provenance), path)


def described(path: Path, console: Console) -> dict[str, Any]:
    """What `tossid info` says of a dataset that was just written, and `out`."""
    facts = {**dataset_info(path), "out": str(path)}
    show({name: value for name, value in facts.items() if name != "provenance"}, console, title=f"wrote {path}")
    return facts
