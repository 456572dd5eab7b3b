"""The engines by name: free flight and sliding as textbooks have them, and what each lacks."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tossid.errors import ConfigError, InputError
from tossid.objects import ObjectModel, load_object
from tossid.physics.effects import World, effect_named
from tossid.settings.synthesis import BulletEngine, DrakeEngine
from tossid.synthesis.engines import ENGINES
from tossid.synthesis.foreign_engines import (
    MODULES,
    box_of,
    check_installed,
    lacks_in_bullet,
    lacks_in_drake,
    toss_in,
)


@pytest.mark.parametrize("name", sorted(set(ENGINES) - set(MODULES)))
def test_an_object_falls_as_gravity_says(name: str) -> None:
    cube, entry = load_object("cube"), ENGINES[name]
    q0 = np.array([[0.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0]])
    done = entry.simulate(entry.settings(), World(cube, gravity=3.0), q0, np.zeros((1, 6)), n_steps=50, dt=0.01)
    assert (done.q.shape, done.v.shape, done.unsolved) == ((1, 51, 7), (1, 51, 6), 0)
    np.testing.assert_allclose(done.q[0, -1, :3], [0, 0, 2.0 - 0.5 * 3.0 * 0.5**2], atol=5e-3)
    np.testing.assert_allclose(done.v[0, -1, :3], [0, 0, -3.0 * 0.5], atol=1e-9)


DT, STEPS = 1 / 148, 20
BOTH = [
    pytest.param(engine, id=engine.name, marks=pytest.mark.skipif(missing, reason=f"{engine.name} is not installed"))
    for engine in (DrakeEngine(substeps=32), BulletEngine(substeps=32))
    for missing in [importlib.util.find_spec(MODULES[engine.name]) is None]
]


def with_effect(cube: ObjectModel, name: str, *values: float) -> World:
    return effect_named(name).at(World(cube), np.array(values))


def one(**at: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """A state (1, 7), (1, 6): place and velocity, without spin unless it is given."""
    q, v = np.zeros((1, 7)), np.zeros((1, 6))
    q[0, :3], q[0, 3], v[0, :3] = at["place"], 1.0, at["velocity"]
    v[0, 3:] = at.get("spin", [0.0, 0.0, 0.0])
    return q, v


@pytest.mark.parametrize("engine", BOTH)
def test_flight_is_a_parabola_with_an_even_turn(cube: ObjectModel, engine: Any) -> None:
    q0, v0 = one(place=[0.1, 0.2, 1.0], velocity=[0.5, -0.3, 1.0], spin=[0.0, 0.0, 3.0])
    q, v = toss_in(engine, World(cube, gravity=9.0), q0, v0, n_steps=STEPS, dt=DT)
    t = STEPS * DT
    np.testing.assert_allclose(v[0, -1], [0.5, -0.3, 1.0 - 9.0 * t, 0, 0, 3.0], atol=1e-9)
    fall = 0.5 * 9.0 * t * (t + DT / engine.substeps)  # semi-implicit Euler
    np.testing.assert_allclose(q[0, -1, :3], [0.1 + 0.5 * t, 0.2 - 0.3 * t, 1.0 + t - fall], atol=1e-9)
    turned = 2 * np.arctan2(q[0, -1, 6], q[0, -1, 3])
    assert turned == pytest.approx(3.0 * t, abs=1e-6)


@pytest.mark.parametrize("engine", BOTH)
def test_a_spinning_body_turns_about_its_centre_of_mass(cube: ObjectModel, engine: Any) -> None:
    world = with_effect(cube, "com_offset", 5e-3, 0.0, 0.0)
    q0, v0 = one(place=[0.0, 0.0, 1.0], velocity=[0.0, 0.0, 0.0], spin=[0.0, 0.0, 10.0])
    # the origin moves such that the centre of mass, 5 mm away along x, is at rest sideways
    v0[0, :3] = -np.cross([0.0, 0.0, 10.0], [5e-3, 0.0, 0.0])
    q, _ = toss_in(engine, world, q0, v0, n_steps=STEPS, dt=DT)
    angle = 10.0 * DT * np.arange(STEPS + 1)
    np.testing.assert_allclose(q[0, :, 0], 5e-3 * (1 - np.cos(angle)), atol=2e-5)
    np.testing.assert_allclose(q[0, :, 1], -5e-3 * np.sin(angle), atol=2e-5)


@pytest.mark.parametrize("engine", BOTH)
def test_friction_brakes_what_slides(cube: ObjectModel, engine: Any) -> None:
    q0, v0 = one(place=[0.0, 0.0, 0.0524], velocity=[1.0, 0.0, 0.0])
    _, v = toss_in(engine, World(cube), q0, v0, n_steps=2 * STEPS, dt=DT)
    braked = (v[0, STEPS, 0] - v[0, -1, 0]) / (STEPS * DT)
    assert braked == pytest.approx(cube.friction * 9.81, rel=0.03)


@pytest.mark.parametrize("engine", BOTH)
def test_a_motion_depends_on_its_first_state_alone(cube: ObjectModel, engine: Any) -> None:
    q0, v0 = one(place=[0.0, 0.0, 0.12], velocity=[1.0, 0.0, -1.0], spin=[6.0, 2.0, 0.0])
    q, v = toss_in(engine, World(cube), q0, v0, n_steps=60, dt=DT)
    # frames in contact, in the order of the motion and against it
    frames = [toss_in(engine, World(cube), q[0, ::way], v[0, ::way], n_steps=1, dt=DT) for way in (1, -1)]
    for ahead, back in zip(*frames, strict=True):
        np.testing.assert_array_equal(ahead, back[::-1])


@pytest.mark.parametrize("engine", BOTH)
def test_drag_is_applied_from_outside(cube: ObjectModel, engine: Any) -> None:
    q0, v0 = one(place=[0.0, 0.0, 2.0], velocity=[2.0, 0.0, 0.0])
    _, v = toss_in(engine, with_effect(cube, "linear_drag", 0.2), q0, v0, n_steps=STEPS, dt=DT)
    left = 2.0 * np.exp(-0.2 / float(cube.mass[0]) * STEPS * DT)
    assert v[0, -1, 0] == pytest.approx(left, rel=1e-3)


def test_engines_say_what_they_lack(cube: ObjectModel) -> None:
    bounce, slow = with_effect(cube, "restitution", 0.4), with_effect(cube, "velocity_friction", 0.3, 0.1, 0.2)
    assert lacks_in_drake(bounce) == lacks_in_bullet(bounce) == ("restitution",)
    rounded = with_effect(cube, "rounded_corners", 5e-3)
    assert (lacks_in_drake(rounded), lacks_in_bullet(rounded)) == ((), ("rounded_corners",))
    assert lacks_in_drake(slow) == lacks_in_bullet(slow) == ("velocity_friction",)
    assert ENGINES["drake"].lacks(World(cube)) == ()


def test_a_missing_engine_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"drake is not installed here; pip install 'tossid\[engines\]'"):
        check_installed("drake", "engines")
    check_installed("lcp", "engines")


def test_only_boxes_are_tossed(cube: ObjectModel) -> None:
    middle, half = box_of(cube)
    np.testing.assert_allclose([middle, half], [[0, 0, 0], [0.0524] * 3], atol=1e-12)
    bent = cube.corner_pos.copy()
    bent[0, 0] *= 0.9
    with pytest.raises(InputError, match="is no box along its axes"):
        box_of(replace(cube, corner_pos=bent))
