"""A registered format is found by its settings' name; a folder of tosses is one without cameras."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest

from tossid.objects import ObjectModel
from tossid.store.importers.registry import FORMATS, Contents, Imported, holds, register_importer


@dataclass(frozen=True, kw_only=True)
class ToySource:
    """Nothing at all."""

    name: Literal["nothing"] = "nothing"
    """nothing"""
    path: Path
    """anywhere"""


def test_a_format_is_registered_by_the_name_of_its_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tossid.store.importers.registry.FORMATS", {})

    def read(source: ToySource, model: ObjectModel) -> Imported:
        return Imported([])

    register_importer(ToySource, read, default_object="elbow", cut_at_rest=True)
    from tossid.store.importers import registry

    (entry,) = registry.FORMATS.values()
    assert (entry.name, entry.contents, entry.default_object) == ("nothing", Contents.POSES, "elbow")
    assert entry.cut_at_rest
    assert not entry.recognizes(Path())
    assert "nothing" not in FORMATS


def test_a_folder_with_cameras_holds_no_tosses(tmp_path: Path) -> None:
    assert not holds(tmp_path / "nowhere", ".txt")
    (tmp_path / "a.txt").touch()
    assert holds(tmp_path, ".txt")
    assert not holds(tmp_path, ".pt")
    (tmp_path / "cameras.yaml").touch()
    assert not holds(tmp_path, ".txt")
