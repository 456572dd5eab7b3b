"""The law of one corner, in its limits; round corners by conserved quantities and beside MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests.objects.test_roundness import geom
from tests.physics.worlds import energy
from tossid.objects import corner_positions
from tossid.physics import make_system, simulate
from tossid.physics.effects import Law, World

DT = 1 / 148


def rolling(heading: float = 0.0) -> np.ndarray:
    """Velocity (6,) of a ball of 5 cm that rolls at 1 m/s."""
    along = np.array([np.cos(heading), np.sin(heading), 0.0])
    return np.concatenate([along, np.cross([0, 0, 20.0], along)])


@pytest.mark.parametrize(
    ("friction", "resists", "v", "ends", "off"),
    [
        (0.5, 0.0, rolling(), rolling(), 1e-9),  # for ever
        # sliding ends at 5/7 of its speed, whatever the friction
        (0.3, 0.0, np.eye(6)[0], 5 / 7 * rolling(), 1e-9),
        # resistance r slows by r g / (1.4 R) in all directions: r N is its torque, and 2/5 m R^2 the inertia
        *((0.5, 0.002, rolling(h), (1 - 0.002 * 9.81 / 0.07) * rolling(h), 4e-3) for h in (0.0, 0.7, 2.0)),
    ],
)
def test_a_ball_rolls_as_textbooks_say(
    friction: float, resists: float, v: np.ndarray, ends: np.ndarray, off: float
) -> None:
    """For a second."""
    ball = geom('type="sphere" size="0.05"').with_changes(friction=friction)
    q = np.array([[0, 0, 0.05, 1, 0, 0, 0.0]])
    run = simulate(World(ball, law=Law(rolling=resists)).system(), q, v[None], n_steps=148, dt=DT)
    np.testing.assert_allclose(run.v[0, -1] / np.repeat([1, 20], 3), ends / np.repeat([1, 20], 3), atol=off)
    assert run.q[0, -1, 2] == pytest.approx(0.05, abs=1e-9)


def test_a_cylinder_comes_to_rest_on_its_face_and_rolls_on_its_side() -> None:
    cylinder = geom('type="cylinder" size="0.05 0.03"').with_changes(friction=0.4)
    up = np.array([0, 0, 0.032, 1, 0, 0, 0.0])
    side = np.array([0, 0, 0.05, np.sqrt(0.5), np.sqrt(0.5), 0, 0])
    v = np.array([[0.3, 0.1, 0, 0, 0, 0.5], [1.0, 0, 0, 0, 0, -20.0]])
    run = simulate(make_system(cylinder), np.stack([up, side]), v, n_steps=148, dt=DT, substeps=2)
    assert np.abs(run.v[0, -1]).max() < 1e-6
    assert run.q[0, -1, 2] == pytest.approx(0.03, abs=1e-6)
    assert run.q[1, -1, 0] == pytest.approx(1.0, abs=1e-6)
    assert energy(cylinder, run.q[1], run.v[1]) == pytest.approx(float(energy(cylinder, side, v[1])), rel=1e-6)


@pytest.mark.parametrize("text", ['type="ellipsoid" size="0.06 0.045 0.035"', 'type="capsule" size="0.02 0.04"'])
def test_a_toss_gains_no_energy_and_stays_above_the_ground(text: str) -> None:
    model = geom(text).with_changes(friction=0.4)
    q, v = np.array([[0, 0, 0.12, 0.9, 0.3, -0.2, 0.2]]), np.array([[0.3, 0.1, 0, 3.0, -4.0, 2.0]])
    q[:, 3:] /= np.linalg.norm(q[:, 3:])
    run = simulate(make_system(model), q, v, n_steps=250, dt=DT, substeps=4)
    total = energy(model, run.q[0], run.v[0])
    assert np.diff(total).max() < 2e-3 * total[0]
    assert corner_positions(model, run.q[0])[..., 2].min() > -5e-4
    assert run.unsolved[0] == 0


@pytest.mark.parametrize(
    "text",
    [
        'type="sphere" size="0.04"',
        'type="ellipsoid" size="0.06 0.045 0.035"',
        'type="capsule" size="0.02 0.04"',
        'type="cylinder" size="0.05 0.03"',
    ],
)
def test_first_contact_goes_as_in_mujoco(text: str) -> None:
    model = geom(text).with_changes(friction=0.3)
    q, v = np.array([0, 0, 0.08, 0.9, 0.3, -0.2, 0.2]), np.array([0.2, 0.1, -0.3, 1.0, -2.0, 1.0])
    q[3:] /= np.linalg.norm(q[3:])
    frames, step = 24, 2.5e-5
    scene = (
        f'<mujoco><option timestep="{step}" cone="elliptic"/><default><geom solref="{2 * step} 10" '
        'solimp="0.9999 0.9999 0.001" friction="0.3 0 0" condim="3"/></default><worldbody>'
        '<geom type="plane" size="1 1 1"/>'
        f'<body><freejoint/><geom {text} mass="0.3"/></body></worldbody></mujoco>'
    )
    m = mujoco.MjModel.from_xml_string(scene)
    data = mujoco.MjData(m)
    data.qpos[:], data.qvel[:] = q, v
    mujoco.mj_step(m, data, round(frames * DT / step))
    run = simulate(make_system(model), q[None], v[None], n_steps=frames, dt=DT, substeps=8, impact_parts=8)
    assert corner_positions(model, run.q[0])[..., 2].min() < 1e-4  # it has touched
    assert run.q[0, -1, :3] == pytest.approx(data.qpos[:3], abs=3e-3)
    assert np.abs(run.q[0, -1, 3:] @ data.qpos[3:]) > np.cos(0.5 * np.deg2rad(4))
