"""Witnesses find, without a simulator, what tosses were made with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tossid.diagnosis.findings import Witness
from tossid.diagnosis.localisation.witnesses import witnesses
from tossid.objects import ObjectModel, load_object
from tossid.physics.effects import World, effect_named
from tossid.physics.forces import Law

BALL = """
<mujoco model="ball">
  <worldbody>
    <body name="ball">
      <inertial pos="0 0 0" mass="0.6" diaginertia="5.66e-3 5.66e-3 5.66e-3"/>
      <geom type="sphere" size="0.119" friction="0.6"/>
    </body>
  </worldbody>
</mujoco>
"""


def found(truth: World, cube: ObjectModel, *, count: int = 40) -> dict[str, Witness]:
    tosses = seen(truth, cube, count, seed=3, frames=120)
    return {w.quantity: w for w in witnesses(tosses, World(cube), truth)}


def test_inertia_and_restitution_come_from_lone_corners(cube: ObjectModel) -> None:
    com = cube.com + np.array([0.0, 0.0, 0.005])
    truth = World(cube.with_changes(restitution=0.4, inertia=1.3 * cube.inertia, com=com))
    said = found(truth, cube)
    inertia, rebound = said["inertia over the stated"], said["rebound of a lone corner"]
    assert (inertia.stated, inertia.found) == (1.0, pytest.approx(1.3))
    assert inertia.measured.value == pytest.approx(1.3, rel=0.03)
    assert inertia.measured.low < 1.3 * 1.02
    assert inertia.measured.high > 1.3 * 0.98
    assert (rebound.stated, rebound.found) == (0.0, 0.4)
    assert rebound.measured.value == pytest.approx(0.4, abs=0.03)


def test_friction_shows_by_speed_and_in_impacts(cube: ObjectModel) -> None:
    """Slow sliding has 0.14, fast sliding and impacts 0.22."""
    truth = World(cube.with_changes(restitution=0.4, friction=0.22), law=Law(static_rel=0.14 / 0.22, slip_speed=0.15))
    said = found(truth, cube)
    assert said["friction of a hit corner"].measured.value == pytest.approx(0.22, abs=0.01)
    assert said["friction of fast sliding (0.3 to 0.6 m/s)"].measured.value == pytest.approx(0.22, abs=0.01)
    slow = said["friction of slow sliding (0.05 to 0.1 m/s)"]
    assert slow.measured.value == pytest.approx(slow.found, abs=0.015)
    assert slow.found < 0.17


def test_too_few_tosses_are_no_witness(cube: ObjectModel) -> None:
    assert found(World(cube), cube, count=2) == {}


@pytest.mark.parametrize("impedance", [0.0, 0.9])
def test_a_soft_ball_rebounds_by_its_spring_and_damper(tmp_path: Path, impedance: float) -> None:
    """The rebound that is measured is the one that the law's numbers give."""
    path = tmp_path / "ball.xml"
    path.write_text(BALL)
    ball = load_object(path)
    truth = effect_named("compliance").at(World(ball), np.array([4e4, 20.0, impedance]))
    said = {w.quantity: w for w in witnesses(seen(truth, ball, 30, seed=3, frames=120), World(ball), truth)}
    rebound = said["rebound of the lowest point"]
    assert rebound.stated == 0.0
    assert rebound.found == pytest.approx(0.815, abs=0.01)
    assert rebound.measured.value == pytest.approx(rebound.found, abs=0.02)
    if impedance == 0:
        assert said["inertia over the stated"].measured.value == pytest.approx(1.0, abs=0.03)
    assert set(said) <= {"inertia over the stated", "rebound of the lowest point"}
