"""Two engines agree in flight and differ in contact; a model moves by its own time step."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.inference.evidence import collect
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.likelihood.engine_discrepancy import Engine, MujocoWorld
from tossid.diagnosis.likelihood.windows import Windows, make_windows
from tossid.diagnosis.localisation.disagreement import solver_disagreement
from tossid.diagnosis.simulators import read_simulator
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.physics.effects.in_mujoco import scene, scene_text


@pytest.fixture(scope="module")
def windows(cube: ObjectModel) -> Windows:
    return make_windows(seen(World(cube), cube, 4, seed=2), cube)


def test_between_two_time_steps_a_body_goes_straight_on(cube: ObjectModel) -> None:
    world = World(cube)
    q0, v0 = np.array([[0.0, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0, 1.0, 0.5, 2.0]])
    m = scene(world, 1e-3)
    coarse = MujocoWorld(m, world).roll_out(q0, v0, n_steps=np.array([80]), dt=0.0025)[0]
    fine = MujocoWorld(m, world).roll_out(q0, v0, n_steps=np.array([200]), dt=0.001)[0]
    np.testing.assert_allclose(coarse[::2], fine[::5], atol=1e-12)
    np.testing.assert_allclose(coarse[1::2, :3], (fine[2::5, :3] + fine[3::5, :3]) / 2, atol=1e-9)
    assert m.opt.timestep == 1e-3


def test_engines_differ_in_contact_alone(cube: ObjectModel, windows: Windows) -> None:
    found = Engine().difference(windows, Hypothesis(World(cube)))
    assert found.expected == 0.0
    assert not found.values[windows.free | windows.steady].any()
    size = (np.abs(found.values) / windows.noise).max(axis=(1, 2))
    assert (size > 1).any()


def test_the_evidence_under_a_users_engine_is_that_of_the_users_model_with_the_changes_in_it(
    cube: ObjectModel, windows: Windows, tmp_path: Path
) -> None:
    (tmp_path / "cube.xml").write_text(scene_text(cube, gravity=9.81, step=4e-4))
    simulator = read_simulator(str(tmp_path / "cube.xml"), cube)
    h = Hypothesis(simulator.world, simulator.law).plus(EFFECTS["friction"], np.array([0.3]))
    found = h.law.engine.difference(windows, h)
    assert found.expected == 1.0
    # ours and what is expected once are what MuJoCo makes of the model whose friction is 0.3
    theirs = MujocoWorld(scene(World(cube.with_changes(friction=0.3)), 4e-4), World(cube))
    n_steps, dt = windows.steps, windows.dt
    run = theirs.roll_out(windows.at_q, windows.at_v, n_steps=n_steps, dt=dt)[:, 1:]
    ours = windows.residuals(windows.predicted(h.world()))
    np.testing.assert_allclose(ours - found.values, windows.residuals(run), atol=1e-6)


def test_they_differ_beyond_noise_where_corners_hit(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 6, seed=2)
    found = solver_disagreement(collect(make_windows(tosses, cube), Hypothesis(World(cube))), seed=0)
    assert 1.0 < found.gap < 4.0
    assert 0.05 < found.position_mm < 10.0
    assert found.rotation_deg < 20.0
    assert found.as_json() == {
        "gap": found.gap,
        "position_mm": found.position_mm,
        "rotation_deg": found.rotation_deg,
    }
