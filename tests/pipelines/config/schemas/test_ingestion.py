"""The sources of ingest are the registered formats."""

from __future__ import annotations

from pathlib import Path

from pipelines.config.compose import load
from pipelines.config.keys import group_members
from pipelines.config.schemas import IngestConfig
from pipelines.config.schemas.ingestion import _sources
from tossid.vision.recordings.registry import input_formats


def test_every_registered_format_can_be_a_source() -> None:
    assert {settings.name for settings in _sources()} == set(input_formats()) >= set(group_members("source"))
    for name, entry in input_formats().items():
        if name in group_members("source"):
            source = load("ingest", IngestConfig, [f"source={name}", "source.path=x"]).source
            assert source == entry.settings(path=Path("x"))
