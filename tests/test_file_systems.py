"""Network file systems are known by the number that `statfs` gives."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tossid import file_systems
from tossid.file_systems import network_file_system


def test_the_number_is_what_the_system_says(tmp_path: Path) -> None:
    said = subprocess.run(
        ["stat", "--file-system", "--format=%t", tmp_path], capture_output=True, text=True, check=True
    )
    assert file_systems._type_number(tmp_path) == int(said.stdout, 16)


@pytest.mark.parametrize(
    ("number", "name"),
    [(0x6969, "NFS"), (0xFF534D42, "CIFS"), (0x0BD00BD0, "Lustre"), (0x01021997, "9p"), (0xEF53, None)],
)
def test_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, name: str | None) -> None:
    monkeypatch.setattr(file_systems, "_type_number", lambda path: number)
    assert network_file_system(tmp_path) == name


def test_of_what_is_not_there_yet_the_folder_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Path] = []
    monkeypatch.setattr(file_systems, "_type_number", asked.append)
    assert network_file_system(tmp_path / "not" / "there.db") is None
    assert asked == [tmp_path]
