"""The keys of commands: where their values are sought, and that they are the library's settings."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipelines.config.compose import load
from pipelines.config.keys import group_members
from pipelines.config.places import CONF, SAMPLE, folders
from pipelines.config.schemas import IngestConfig, TrainConfig
from pipelines.config.schemas.ingestion import _sources
from tossid.settings.training import TrainSettings
from tossid.vision.recordings.registry import input_formats


def test_what_ships_is_found_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert (CONF / "train.yaml").is_file()
    assert (SAMPLE / "cameras.yaml").is_file()
    assert folders() == (CONF,)


def test_the_working_folder_adds_members(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "conf/object").mkdir(parents=True)
    (tmp_path / "conf/object/brick.yaml").write_text("name: brick\n")
    assert folders() == (CONF, tmp_path / "conf")
    assert {"brick", "cube"} <= set(group_members("object"))


def test_a_clone_is_not_searched_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(CONF.parent)
    assert folders() == (CONF,)


def test_another_main_folder_stands_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "conf").mkdir()
    assert folders(tmp_path / "other") == (tmp_path / "other",)


def test_the_librarys_part_of_the_keys() -> None:
    config = load("train", TrainConfig, ["seed=3", "epochs=7", "restart=true"])
    settings = config.settings()
    assert type(settings) is TrainSettings
    assert (settings.seed, settings.epochs) == (3, 7)
    assert settings.model == config.model


def test_every_registered_format_can_be_a_source() -> None:
    assert {settings.name for settings in _sources()} == set(input_formats()) >= set(group_members("source"))
    for name, entry in input_formats().items():
        if name in group_members("source"):
            source = load("ingest", IngestConfig, [f"source={name}", "source.path=x"]).source
            assert source == entry.settings(path=Path("x"))
