"""Whatever can be diagnosed is read as a world; what cannot be is refused with the reason."""

from __future__ import annotations

import logging
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tests.objects.meshes import obj, scan
from tossid.diagnosis import simulators
from tossid.diagnosis.inference.hypothesis import COULOMB, RELAXED, ROUTH, Hypothesis
from tossid.diagnosis.patch.make import make_patch
from tossid.diagnosis.simulators import (
    Simulator,
    checked,
    nominal,
    read_simulator,
    reader,
    world_of_mjcf,
)
from tossid.errors import InputError
from tossid.objects import ObjectModel, load_object
from tossid.physics.contact.law import Law
from tossid.physics.effects import World
from tossid.settings.diagnosis.diagnose import DiagnoseSettings

MJCF = """<mujoco model="mine">
  <option timestep="0.001" gravity="0.37 0 -9.7"/>
  <worldbody>
    <geom type="plane" size="5 5 .1" pos="0 0 0.01" euler="0 3 0" friction="0.2 0.005 0.0001"/>
    <body><freejoint/><inertial pos="0 0 0" mass="0.37" diaginertia="0.00081 0.00081 0.00081"/>
      <geom type="box" size="0.0524 0.0524 0.0524" friction="0.25 0.005 0.0001"/></body>
  </worldbody>
</mujoco>
"""


def trained(model: ObjectModel) -> Any:
    """What `diagnose` asks a trained model for."""
    return SimpleNamespace(
        learned_object=lambda: model.with_changes(friction=0.3),
        mechanics=lambda: SimpleNamespace(object=model.with_changes(friction=0.3), gravity=9.5, k_res=None),
        measurement=SimpleNamespace(length_scale=1.01),
    )


PAIR = '</worldbody><contact><pair geom1="floor" geom2="box" friction="0.4 0.4"/></contact>'


@pytest.mark.parametrize(
    ("edits", "words", "made"),
    [
        ({}, "the object states 0.25, the ground 0.2, and MuJoCo takes the larger", 0.25),
        ({' friction="0.2 0.005 0.0001"': ""}, "the object states 0.25, the ground 1, and MuJoCo takes the larger", 1),
        ({"0.25": "0.2"}, "both geoms have it", 0.2),
        ({"plane": 'plane" priority="1'}, "the object states 0.25, the ground 0.2, and the geom with the higher", 0.2),
        (
            {"geom type=\"plane": 'geom name="floor" type="plane', "geom type=\"box": 'geom name="box" type="box',
             "</worldbody>": PAIR},
            "their pair states it; the object states 0.25, the ground 0.2", 0.4,
        ),
    ],
)  # fmt: skip
def test_what_mujoco_makes_of_two_frictions_is_said(
    cube: ObjectModel, tmp_path: Path, edits: dict[str, str], words: str, made: float
) -> None:
    text = MJCF
    for old, new in edits.items():
        text = text.replace(old, new)
    (tmp_path / "mine.xml").write_text(text)
    read = read_simulator(tmp_path / "mine.xml", cube)
    assert read.reads.startswith(f"friction of object and ground is {made:g} ({words}")
    assert read.world.object.friction == made


def test_each_kind_is_read(cube: ObjectModel, tmp_path: Path) -> None:
    (tmp_path / "mine.xml").write_text(MJCF)
    stated = read_simulator("nominal", cube)
    assert (stated.kind, stated.world) == ("nominal", World(cube))
    assert (stated.law, stated.laws) == (COULOMB, (ROUTH, RELAXED))
    world = World(cube, gravity=3.0)
    assert read_simulator(world, cube).world is world
    relaxed = read_simulator(World(cube, law=Law(lifting=2e-4)), cube)
    assert (relaxed.law.name, relaxed.law.lifting, relaxed.laws) == ("relaxed", 2e-4, (COULOMB, ROUTH))
    ready = nominal(cube, gravity=0.0)
    assert read_simulator(ready, cube) is ready
    for given in (trained(cube), SimpleNamespace(model=trained(cube))):
        run = read_simulator(given, cube)
        assert run.kind == "run"
        assert (run.world.object.friction, run.world.gravity, run.world.recording.length_scale) == (0.3, 9.5, 1.01)


def test_an_mjcf_file_is_read_as_a_world(cube: ObjectModel, tmp_path: Path) -> None:
    (tmp_path / "mine.xml").write_text(MJCF)
    found = read_simulator(str(tmp_path / "mine.xml"), cube)
    assert (found.kind, found.mjcf) == ("mjcf", tmp_path / "mine.xml")
    assert [law.name for law in (found.law, *found.laws)] == ["own", "coulomb", "routh", "relaxed"]
    assert found.law.engine.patched is not None
    world = found.world
    assert world.gravity == pytest.approx(9.7)
    assert world.forces.x == pytest.approx(0.37 * 0.37)
    assert world.object.friction == 0.25  # MuJoCo takes the larger of two geoms'
    np.testing.assert_allclose(world.ground_tilt, [0.0, np.deg2rad(3)], atol=1e-9)
    assert world.ground_height == pytest.approx(0.01 * np.cos(np.deg2rad(3)))


def test_a_new_kind_is_one_registered_function(cube: ObjectModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulators, "_READERS", dict(simulators._READERS))

    @reader("moon", lambda given: given == ("moon",))
    def moon(given: object, recorded: ObjectModel) -> Simulator:
        return Simulator("moon", "the stated object on the moon", World(recorded, gravity=1.62))

    assert read_simulator(("moon",), cube).world.gravity == 1.62


def test_what_is_no_simulator_is_refused(cube: ObjectModel) -> None:
    with pytest.raises(InputError, match="3 is no simulator"):
        read_simulator(3, cube)
    with pytest.raises(InputError, match="has no object and no contact"):
        read_simulator(SimpleNamespace(learned_object=lambda: cube, mechanics=lambda: None), cube)


def test_a_world_that_diverges_is_refused(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 3, seed=1, frames=20)
    assert checked(nominal(cube), tosses, DiagnoseSettings()) == (nominal(cube), [])
    with pytest.raises(InputError, match=r"diverges .* on 3 of 3 tosses, the first of them '0'"):
        checked(nominal(cube.with_changes(inertia=-cube.inertia)), tosses, DiagnoseSettings())


def test_a_scene_with_a_scan_is_diagnosed_as_it_is(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "scan.obj").write_text(obj(scan(1), normals=5))
    scene = """<mujoco><asset><mesh name="m" file="scan.obj"/></asset><worldbody>{}<body name="a"><freejoint/>
      <geom type="mesh" mesh="m" mass="0.2" friction="0.3"/></body></worldbody></mujoco>"""
    path = tmp_path / "scene.xml"
    path.write_text(scene.format('<geom type="plane" size="1 1 .1"/>'))
    caplog.set_level(logging.INFO, "tossid")
    world, _ = world_of_mjcf(path, width=None)
    given = load_object(path, friction=0.3)
    np.testing.assert_array_equal(world.object.corner_pos, given.corner_pos)
    # the floor's, which is MuJoCo's default: what that simulator does holds, and is said
    assert (given.friction, world.object.friction) == (0.3, 1.0)
    assert "states friction 0.3; 1 holds instead" in caplog.text
    patch = make_patch(Hypothesis(world), mjcf=path)
    np.testing.assert_allclose(patch.model.body_mass[1], 0.2)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "</body>",
            '<geom type="sphere" size="0.06" friction="0.4"/></body>',
            r"meet .* friction 0\.25 and 0\.4, expected",
        ),
        (MJCF.splitlines()[3], "", "0 geoms to land on"),
    ],
    ids=["several frictions", "no ground"],
)
def test_a_scene_that_says_too_much_or_too_little_is_refused(tmp_path: Path, old: str, new: str, says: str) -> None:
    path = tmp_path / "mine.xml"
    path.write_text(MJCF.replace(old, new))
    with pytest.raises(InputError, match=says):
        world_of_mjcf(path, width=None)
