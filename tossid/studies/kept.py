"""A study's folder: each cell with its checkpoint, its settings and its numbers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import yaml

from tossid.outputs import output_file, write_whole
from tossid.plain_json import jsonable
from tossid.studies.cells import SCHEMA, CellResult, StudyCell

CELL, CHECKPOINT, CONFIG = "cell.json", "checkpoint.pt", "config.yaml"
"""Names of a cell's files: its numbers, its model, its settings."""


def find_cell(cell: StudyCell, folder: Path) -> CellResult | None:
    """A cell that a study in this folder, or in one beside it, has computed from the same settings, data and code.

    Args:
        cell: The cell.
        folder: The study's.

    Returns:
        What it gave; None where it is not there, or not whole.
    """
    for path in sorted(folder.parent.glob(f"*/cells/{cell.name}/{CELL}")):
        try:
            found = json.loads(path.read_text())
        except (OSError, ValueError):
            continue
        if isinstance(found, dict) and found.get("schema") == SCHEMA and found.get("digest") == cell.digest:
            return CellResult(found["result"], found["history"], path.parent / CHECKPOINT)
    return None


def keep_cell(cell: StudyCell, computed: CellResult, folder: Path) -> CellResult:
    """Write a cell: its checkpoint and settings, and last, as the sign that all is there, its numbers.

    Args:
        cell: The cell.
        computed: What it gave, with the content of its checkpoint.
        folder: The study's.

    Returns:
        The same, as a later call will find it.
    """
    assert isinstance(computed.checkpoint, bytes)
    place = folder / "cells" / cell.name
    write_whole(place / CHECKPOINT, computed.checkpoint)
    write_text(place / CONFIG, yaml.safe_dump(dict(cell.keys), sort_keys=False, allow_unicode=True))
    content = {"schema": SCHEMA, "digest": cell.digest, "result": computed.scores, "history": computed.history}
    content = jsonable(content)
    write_text(place / CELL, json.dumps(content, indent=1) + "\n")
    return replace(computed, scores=content["result"], history=content["history"], checkpoint=place / CHECKPOINT)


def write_text(path: Path, text: str) -> None:
    """Write a text whole or not at all.

    Args:
        path: The file.
        text: Its content.
    """
    with output_file(path) as temporary:
        temporary.write_text(text)
