"""`tossid segment`: tosses from tracked poses, to a dataset."""

from __future__ import annotations

from typing import Any

from pipelines.console import Console
from pipelines.frames import segment_file
from pipelines.schemas import SegmentStageConfig


def run(config: SegmentStageConfig, console: Console) -> dict[str, Any]:
    """Segment, write; returns what `info` says of the dataset, and `out`."""
    return segment_file(config, console)
