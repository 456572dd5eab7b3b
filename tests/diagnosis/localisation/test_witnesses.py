"""Witnesses find, without a simulator, what tosses were made with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.diagnosis.tossed import recorded, seen
from tests.models.made import DT, thrown
from tossid.diagnosis.localisation.witnesses import Witness, witnesses
from tossid.objects import ObjectModel, load_object
from tossid.physics.contact.law import Law
from tossid.physics.effects import World, effect_named
from tossid.types import Toss

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


def made(world: World, cube: ObjectModel) -> list[Toss]:
    """Forty tosses that a world makes from the first states of `seen`, measured with other noise."""
    q, v = thrown(np.random.default_rng(3), 40)
    run = world.roll_out(q, v, n_steps=120, dt=DT, substeps=32, impact_parts=8)
    return recorded(run, cube, np.random.default_rng(4))


FAST, SLOW = "friction of fast sliding (0.3 to 0.6 m/s)", "friction of slow sliding (0.05 to 0.1 m/s)"
HEAVY = {"restitution": 0.4, "com": np.array([[0.0, 0.0, 0.005]])}


@pytest.mark.parametrize(
    ("changes", "law", "expected"),
    [
        # from lone corners
        (HEAVY, Law(), {"inertia over the stated": (1.3, 0.03), "rebound of a lone corner": (0.4, 0.03)}),
        # slow sliding has 0.14, fast sliding and impacts 0.22
        (
            {"restitution": 0.4, "friction": 0.22},
            Law(static_rel=0.14 / 0.22, slip_speed=0.15),
            {"friction of a hit corner": (0.22, 0.01), FAST: (0.22, 0.01), SLOW: (0.155, 0.015)},
        ),
        # each of four corners is pulled with 0.3 N, a third of the weight together
        ({}, Law(adhesion=0.3), {SLOW: (0.18 * (1 + 1.2 / (0.37 * 9.81)), 0.025)}),
    ],
)
def test_what_tosses_were_made_with_is_found(
    cube: ObjectModel, changes: dict[str, Any], law: Law, expected: dict[str, tuple[float, float]]
) -> None:
    inertia = cube.inertia * (1.3 if changes is HEAVY else 1.0)
    said = found(World(cube.with_changes(**changes, inertia=inertia), law=law), cube)
    for quantity, (value, off) in expected.items():
        assert said[quantity].found == pytest.approx(value, abs=0.01)
        assert said[quantity].measured.value == pytest.approx(said[quantity].found, abs=off)
        assert said[quantity].measured.low - off < value < said[quantity].measured.high + off


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


def test_made_tosses_show_what_biases_a_measurement(cube: ObjectModel) -> None:
    """Lone corners that fly on after an impact are chosen, and so rebound without restitution. Made tosses do alike."""
    truth = World(cube)
    tosses = seen(truth, cube, 40, seed=3, frames=120)
    said = {w.quantity: w for w in witnesses(tosses, truth, truth, made(truth, cube))}
    rebound = said["rebound of a lone corner"]
    assert rebound.found == 0.0
    assert rebound.measured.value > 0.03
    assert rebound.predicted.value == pytest.approx(rebound.measured.value, abs=0.02)
    assert not any(each.contradicts for each in said.values())


def test_a_wrong_rebound_is_contradicted(cube: ObjectModel) -> None:
    truth, wrong = (World(cube.with_changes(restitution=e)) for e in (0.4, 0.5))
    tosses = seen(truth, cube, 40, seed=3, frames=120)
    said = {w.quantity: w for w in witnesses(tosses, World(cube), wrong, made(wrong, cube))}
    assert said["rebound of a lone corner"].contradicts
    assert not said["inertia over the stated"].contradicts


def test_what_moves_in_a_plane_hits_with_an_edge(cube: ObjectModel) -> None:
    """No corner of it is ever alone: the middle of the edge is hit."""
    truth = World(cube.with_changes(restitution=0.5, inertia=1.2 * cube.inertia, friction=0.1))
    rng = np.random.default_rng(4)
    count, nothing = 24, np.zeros(24)
    tilt, spin = rng.uniform(0.2, 1.2, count), rng.uniform(-12, 12, count)
    q = np.stack([nothing, nothing, nothing + 0.25, np.cos(tilt / 2), nothing, np.sin(tilt / 2), nothing], axis=1)
    v = np.stack([rng.uniform(0.5, 1.5, count), nothing, nothing, nothing, spin, nothing], axis=1)
    run = truth.roll_out(q, v, n_steps=90, dt=DT, substeps=32, impact_parts=8)
    tosses = recorded(run, cube, rng)
    said = {w.quantity: w for w in witnesses(tosses, World(cube), truth)}
    assert said["inertia over the stated"].measured.value == pytest.approx(1.2, rel=0.04)
    assert said["rebound of a lone corner"].measured.value == pytest.approx(0.5, abs=0.03)
