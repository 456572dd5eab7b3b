"""The table of witnesses has a row for each quantity that tosses reveal."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from pipelines.tools.experiments.by_hand.witnesses import main
from tests.diagnosis.tossed import seen
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.store import Dataset, write_dataset


def test_a_bouncing_cube_shows_its_rebound(
    cube: ObjectModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tosses = seen(World(cube.with_changes(restitution=0.4)), cube, 24, seed=3, frames=120)
    write_dataset(Dataset(cube, tuple(tosses), 148.0, "made", {}), tmp_path / "tosses.h5")
    monkeypatch.setattr(
        sys, "argv", ["witnesses", str(tmp_path / "tosses.h5"), "--effects", '{"restitution": {"e": 0.5}}']
    )
    main()
    rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines()]
    (rebound,) = (row for row in rows if row[0] == "| rebound of a lone corner")
    assert rebound[1:3] == ["0", "0.5"]
    assert float(rebound[3].split()[0]) == pytest.approx(0.4, abs=0.02)
