"""What `make scale` makes long: a film of the same images under later times."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from pipelines.cli.console import Console
from pipelines.tools.benchmarks.scale import Took, _panels, _repeated, _taken


def test_a_film_is_repeated_under_later_times(tmp_path: Path) -> None:
    film = tmp_path / "film"
    for camera in ("cam0", "cam1"):
        (film / "frames" / camera).mkdir(parents=True)
        for stamp in (1_000_000_000, 1_500_000_000):
            (film / "frames" / camera / f"{stamp:015d}.jpg").write_bytes(camera.encode())
    for name in ("cameras.yaml", "truth.h5"):
        (film / name).touch()
    _repeated(film, tmp_path / "long", 3.0)  # a second each, with the pause
    names = [path.stem for path in sorted((tmp_path / "long" / "frames" / "cam1").iterdir())]
    assert [int(name) / 1e9 for name in names] == [1.0, 1.5, 2.0, 2.5, 3.0, 3.5]
    assert (tmp_path / "long" / "frames" / "cam1" / f"{names[-1]}.jpg").read_bytes() == b"cam1"
    assert {path.name for path in (tmp_path / "long").iterdir()} == {"frames", "cameras.yaml"}


def test_costs_are_sorted_by_what_counts_as_size() -> None:
    rows = [Took("train", 10, 2.0, 1.0, 0.5), Took("ingest film", 1, 9.0, 8.0, 0.7), Took("train", 100, 4.0, 3.0, 0.6)]
    panels = _panels(rows)
    assert panels["tosses [count]"]["train"] == [(10, 1.0, 0.5), (100, 3.0, 0.6)]
    assert panels["film [min]"] == {"ingest film": [(1, 8.0, 0.7)]}


def test_a_command_that_fails_ends_the_measurement(tmp_path: Path) -> None:
    with pytest.raises(subprocess.CalledProcessError):
        _taken("info", 1, tmp_path, Console(quiet=True), ["info", "nowhere.h5"])
    (tmp_path / "a.h5").touch()
    took = _taken("info", 1, tmp_path, Console(quiet=True), ["info", "."])
    assert took.cpu > 0
    assert 0 < took.memory < 4
