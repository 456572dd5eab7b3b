"""The engines by name: both drop an object as gravity does, and each says what it lacks."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from tossid.objects import load_object
from tossid.physics.effects import World, effects_for
from tossid.settings.contact import ContactSettings
from tossid.settings.synthesis import LcpEngine
from tossid.synthesis.engines import ENGINES, able
from tossid.synthesis.foreign_engines import MODULES


@pytest.mark.parametrize("name", [name for name in ENGINES if name not in MODULES or find_spec(MODULES[name])])
def test_an_object_falls_as_gravity_says(name: str) -> None:
    cube, entry = load_object("cube"), ENGINES[name]
    q0 = np.array([[0.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0]])
    done = entry.simulate(entry.settings(), World(cube, gravity=3.0), q0, np.zeros((1, 6)), n_steps=50, dt=0.01)
    assert (done.q.shape, done.v.shape, done.unsolved) == ((1, 51, 7), (1, 51, 6), 0)
    np.testing.assert_allclose(done.q[0, -1, :3], [0, 0, 2.0 - 0.5 * 3.0 * 0.5**2], atol=5e-3)
    np.testing.assert_allclose(done.v[0, -1, :3], [0, 0, -3.0 * 0.5], atol=1e-9)


@pytest.mark.parametrize("speed", [0.02, 0.05])
def test_lcp_takes_the_thresholds_of_contact(speed: float) -> None:
    """What begins 1 mm in the ground comes out at the recovery speed."""
    cube = load_object("cube")
    q0 = np.array([[0.0, 0.0, cube.width / 2 - 1e-3, 1.0, 0.0, 0.0, 0.0]])
    engine = LcpEngine(contact=ContactSettings(recovery_speed=speed))
    done = ENGINES["lcp"].simulate(engine, World(cube), q0, np.zeros((1, 6)), n_steps=4, dt=0.005)
    assert done.q[0, -1, 2] - q0[0, 2] == pytest.approx(0.02 * speed, rel=0.15)


def test_an_effect_that_mujoco_lacks_leaves_lcp() -> None:
    cube = load_object("cube")
    adhesion = next(effect for effect in effects_for(cube) if effect.name == "adhesion")
    sticky = adhesion.at(World(cube), np.array([0.3]))
    assert set(able(World(cube))) == set(ENGINES)
    assert set(able(sticky)) == {"lcp"}


def test_an_engines_settings_have_its_name() -> None:
    assert {entry.settings().name for entry in ENGINES.values()} == set(ENGINES)
