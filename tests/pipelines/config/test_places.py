"""Values are sought in what ships with tossid, then in the conf/ of the working folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipelines.config.keys import group_members
from pipelines.config.places import CONF, SAMPLE, folders


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
