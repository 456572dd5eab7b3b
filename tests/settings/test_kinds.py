"""Marked fields are settings like others in Python, and no keys."""

from __future__ import annotations

from tossid.settings.changed import changed
from tossid.settings.kinds import ADVANCED
from tossid.settings.tracking import GraphSettings, TrackSettings


def test_an_advanced_part_changes_by_name_and_is_marked() -> None:
    settings = changed(TrackSettings(), {"graph.window": 10, "clocks": False})
    assert (settings.graph, settings.clocks) == (GraphSettings(window=10), False)
    marked = {name for name, field in TrackSettings.__dataclass_fields__.items() if field.metadata.get(ADVANCED)}
    assert "graph" in marked
    assert "clocks" not in marked
