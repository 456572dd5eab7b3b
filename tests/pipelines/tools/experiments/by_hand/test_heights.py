"""Resting heights show size and slope, and depths of struck corners their radius."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from pipelines.tools.experiments.by_hand.heights import depths, main, struck
from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.localisation.witnesses import lone_impacts
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.store import Dataset, write_dataset


def test_struck_corners_show_their_radius(cube: ObjectModel) -> None:
    bouncing = World(cube.with_changes(restitution=0.4))
    made = EFFECTS["rounded_corners"].at(bouncing, np.array([0.006]))
    for world, radius in ((bouncing, 0.0), (made, 6.0)):
        depth, steepness = depths(lone_impacts(seen(world, cube, 200, seed=3, frames=40), bouncing), cube)
        assert len(depth) >= 12
        said = struck(depth, steepness)[-1]
        found = float(re.findall(r"radius (-?[\d.]+) mm", said)[0])
        assert found == pytest.approx(radius, abs=1.5)


def test_resting_cubes_show_their_size_and_the_slope(
    cube: ObjectModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tilted = EFFECTS["ground_tilt"].at(World(cube.with_changes(restitution=0.3)), np.array([0.02, 0.0]))
    tosses = tuple(seen(tilted, cube, 60, seed=3, frames=160))
    write_dataset(Dataset(cube, tosses, 148.0, "made", {}), tmp_path / "tosses.h5")
    effects = json.dumps({"ground_tilt": {"x_rad": 0.02, "y_rad": 0.0}})
    monkeypatch.setattr(sys, "argv", ["heights", str(tmp_path / "tosses.h5"), "--split", "", "--effects", effects])
    main()
    said = {row.split(" | ")[0]: row.split(" | ")[1] for row in capsys.readouterr().out.splitlines() if " | " in row}
    heights = [float(x) for x in said["| height of the centre, by face [mm]"].removesuffix(" |").split(", ")]
    np.testing.assert_allclose(heights, 52.4, atol=0.3)
    slopes = said["| slope of the ground by heights, along x and y [mrad]"].split(", ")
    assert [float(each.split(" ")[0]) for each in slopes] == pytest.approx([0.0, 20.0], abs=0.5)
    leans = said["| slope by attitudes (medians) [mrad]"].removesuffix(" |").split(", ")
    assert [float(each) for each in leans] == pytest.approx([0.0, 20.0], abs=1.0)
