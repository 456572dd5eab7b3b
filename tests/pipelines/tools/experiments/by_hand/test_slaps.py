"""Faces that fall about an edge rebound the more, the more their world bounces, recorded as made."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from pipelines.tools.experiments.by_hand.slaps import SPEEDS, made, main, slaps
from tests.diagnosis.tossed import DT, seen
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.store import Dataset, write_dataset


def test_faces_rebound_more_the_more_the_world_bounces(cube: ObjectModel) -> None:
    """Parabolas through five frames smooth what comes next, so that shares are below the restitution."""
    tosses, shares = seen(World(cube), cube, 150, seed=2), {}
    for restitution in (0.1, 0.4):
        world = World(cube.with_changes(restitution=restitution))
        found = slaps(made(tosses, world, DT), world, DT)
        assert len(found) >= 8
        assert (found[:, 0] > SPEEDS[0]).all()
        shares[restitution] = np.median(found[:, 1])
        assert -0.1 < shares[restitution] < restitution + 0.05
    assert shares[0.4] > shares[0.1] + 0.15


def test_recorded_and_made_stand_side_by_side(
    cube: ObjectModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tosses = tuple(seen(World(cube.with_changes(restitution=0.4)), cube, 150, seed=2))
    write_dataset(Dataset(cube, tosses, 148.0, "made", {}), tmp_path / "tosses.h5")
    effects = json.dumps({"restitution": {"e": 0.1}})
    monkeypatch.setattr(sys, "argv", ["slaps", str(tmp_path / "tosses.h5"), "--split", "", "--effects", effects])
    main()
    rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines()[2:]]
    assert rows
    recorded, simulated = (float(part.split()[0]) for part in rows[-1][2].split(", "))
    assert recorded > simulated + 0.15
