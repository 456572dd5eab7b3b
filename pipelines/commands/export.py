"""`tossid export`: a learned model as MJCF or URDF, and how near MuJoCo's rollouts of it come to tossid's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pipelines.cli.console import Console
from pipelines.config.schemas import ExportConfig

FOLDER = Path("outputs/export")


def run(config: ExportConfig, console: Console) -> dict[str, Any]:
    """Export; returns the files, what could not be carried, and the comparison."""
    from pipelines.tracking.runs import find_run
    from tossid import export
    from tossid.evaluation.export import SUFFIXES

    record = find_run(config.run)
    out = config.out or FOLDER / f"{record.name}{SUFFIXES[config.format]}"
    found = export(record.trained_model(), out, settings=config)
    head, rows = found.table()
    console.table(head, rows, title=f"wrote {out}")
    for text in found.left_out:
        console.say(f"not in the file: {text}")
    return {"run": record.id, **found.as_json()}
