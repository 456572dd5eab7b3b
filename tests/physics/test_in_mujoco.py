"""Worlds in MuJoCo against theory and against our engine, and edits of an MJCF model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.models.made import DT, thrown
from tossid.errors import DivergedError, InputError, MotionError, ObjectError
from tossid.objects import OBJECT_FILES, ObjectModel, corner_positions, load_object, to_mjcf
from tossid.physics import simulate
from tossid.physics.effects import LIBRARY, Forces, Law, RecordingErrors, World
from tossid.physics.effects.in_mujoco import inexpressible, toss_in_mujoco
from tossid.physics.effects.mjcf_edit import Edit
from tossid.physics.effects.mujoco_contact import SOFT_IMPEDANCE, bouncing_solref, damping_ratio, soft_contact
from tossid.rotations import quat_exp

HALF = 0.0524

FLAT = np.array([[0, 0, HALF, 1, 0, 0, 0.0]])


def above(height: float) -> np.ndarray:
    """A cube that lies flat in the air."""
    return np.array([[0, 0, HALF + height, 1, 0, 0, 0.0]])


def test_bodies_gravity_ground_and_forces_fly_as_in_our_engine(cube: ObjectModel) -> None:
    """Every force at once, on a body with its centre off, over tilted ground."""
    forces = Forces(0.1, 0.1, 0.002, 2.0, -1.0, 0.03, 0.3, -0.2, 0.5, 4.0, 0.3, 0.2, 1.0, 2.0, 1.5)
    body = cube.with_changes(com=np.array([[0.01, -0.005, 0.02]]), inertia=1.3 * cube.inertia)
    world = World(body, gravity=9.0, forces=forces, ground_tilt=(0.1, -0.05), ground_height=0.02)
    q, v = above(3.0), np.array([[1.0, -0.5, 1.0, 4.0, -3.0, 5.0]])
    pushed = toss_in_mujoco(world, q, v, 60, DT)
    ours = simulate(world.system(), q, v, n_steps=60, dt=DT, substeps=400)
    none = simulate(World(body, gravity=9.0).system(), q, v, n_steps=60, dt=DT, substeps=20)
    assert np.abs(ours.q - none.q)[0, -1, :3].max() > 0.2
    np.testing.assert_allclose(pushed[0][0, :, :3], ours.q[0, :, :3], atol=3e-4)
    np.testing.assert_allclose(pushed[0][0, :, 3:], ours.q[0, :, 3:], atol=3e-3)


@pytest.mark.parametrize("e", [0.05, 0.5, 0.8])
def test_impacts_bounce(cube: ObjectModel, e: float) -> None:
    """On four corners at once and on one, straight above it."""
    axis = np.array([1.0, 1, 1]) / np.sqrt(3)
    turn = quat_exp(np.arccos(axis[2]) * np.cross(axis, [0, 0, 1]) / np.linalg.norm(np.cross(axis, [0, 0, 1])))
    landing = np.sqrt(2 * 9.81 * 0.1)
    for start in (above(0.1), np.array([[0, 0, np.sqrt(3) * HALF + 0.1, *turn]])):
        _, v = toss_in_mujoco(World(cube.with_changes(restitution=e)), start, np.zeros((1, 6)), 26, DT)
        assert v[0, :, 2].max() == pytest.approx(e * landing, abs=0.03 * landing + 9.81 * DT)


@pytest.mark.parametrize(("stiffness", "damping"), [(2000.0, 5.0), (20000.0, 40.0)])
def test_a_compliant_corner_has_its_stiffness_and_damping(cube: ObjectModel, stiffness: float, damping: float) -> None:
    """At rest it sinks by m g / (4 k); landing, it does as in our engine."""
    body = cube.with_changes(compliance=1 / stiffness, relaxation=damping / stiffness)
    world = World(body)
    q, _ = toss_in_mujoco(world, FLAT, np.zeros((1, 6)), 120, DT)
    assert HALF - q[0, -1, 2] == pytest.approx(0.37 * 9.81 / (4 * stiffness), rel=1e-3)
    start = above(0.02)
    q, _ = toss_in_mujoco(world, start, np.zeros((1, 6)), 40, DT)
    ours = simulate(world.system(), start, np.zeros((1, 6)), n_steps=40, dt=DT, substeps=200)
    np.testing.assert_allclose(q[0, :, 2], ours.q[0, :, 2], atol=0.06 * (HALF - ours.q[0, :, 2].min()) + 2e-4)


@pytest.mark.parametrize(("angle", "moves"), [(0.16, False), (0.2, True)])
def test_a_cube_on_a_slope(cube: ObjectModel, angle: float, moves: bool) -> None:
    world = World(cube, ground_tilt=(0.0, angle))
    q, _ = toss_in_mujoco(world, FLAT, np.zeros((1, 6)), 60, DT)
    way = 0.5 * 9.81 * max(np.sin(angle) - 0.18 * np.cos(angle), 0.0) * (60 * DT) ** 2
    assert q[0, -1, 0] == pytest.approx(way, abs=0.05 * way + 1e-4)
    assert (way > 0) == moves


def test_torsional_friction_stops_a_spin_in_time(cube: ObjectModel) -> None:
    world = World(cube.with_changes(friction=0.0), law=Law(torsional=0.01))
    predicted = 0.00081 * 8.0 / (0.01 * 0.37 * 9.81)
    _, v = toss_in_mujoco(world, FLAT, np.array([[0, 0, 0, 0, 0, 8.0]]), 50, DT)
    still = np.flatnonzero(np.abs(v[0, :, 5]) < 0.02)
    assert still[0] * DT == pytest.approx(predicted, rel=0.05, abs=DT)


def test_rolling_resistance_slows_a_tumble(cube: ObjectModel) -> None:
    lean = np.array([[0, 0, 0.0735, np.cos(0.35), 0, np.sin(0.35), 0]])
    v0 = np.array([[0.15, 0, 0, 0, 2.0, 0.0]])
    body = cube.with_changes(friction=1.0)
    (_, free), (_, held) = (toss_in_mujoco(World(body, law=Law(rolling=r)), lean, v0, 12, DT) for r in (0.0, 0.01))
    assert abs(held[0, -1, 4]) < abs(free[0, -1, 4]) - 0.05


def test_what_it_cannot_express_is_named(cube: ObjectModel) -> None:
    world = World(cube.with_changes(cohesion=0.1), law=Law(static_rel=2.0, y_rel=2.0, adhesion=1.0))
    assert inexpressible(world) == ("velocity_friction", "anisotropic_friction", "cohesion", "adhesion")
    with pytest.raises(InputError, match="velocity_friction"):
        toss_in_mujoco(world, FLAT, np.zeros((1, 6)), 2, DT)
    assert inexpressible(World(cube, recording=RecordingErrors(length_scale=1.1))) == ()


HELD = {"stiffness_npm": 925.0, "damping_nspm": 37.0, "impedance_rel": 0.95}
"""What MuJoCo's contact of a time constant of 0.02 s and an impedance of 0.95 is for a mass of 0.37 kg."""


def landings() -> tuple[np.ndarray, np.ndarray]:
    """Cubes that fall on a face, an edge and a corner, slowly across and without spin."""
    turns = np.array([[0.0, 0, 0], [0.5, 0, 0], [0.6, 0.5, 0]])
    q = np.array([[0, 0, 0.12, *quat_exp(turn)] for turn in turns])
    v = np.zeros((3, 6))
    v[:, 0] = 0.3
    return q, v


@pytest.mark.parametrize(("friction", "lifting", "atol"), [(0.0, 0.0, 3e-5), (0.18, 1e-4, 2e-4)])
def test_an_impedance_gives_mujoco_s_own_soft_contact(
    cube: ObjectModel, friction: float, lifting: float, atol: float
) -> None:
    """A user's scene with a time constant and a damping ratio, through landing and the first turn after it."""
    body = cube.with_changes(friction=friction)
    m = mujoco.MjModel.from_xml_string(
        to_mjcf(body, timestep=2.5e-5, solref=(0.02, 1.0), solimp=(0.95, 0.95, 0.001, 0.5, 2.0))
    )
    world = {e.name: e for e in LIBRARY}["compliance"].apply(World(body), HELD)
    world = replace(world, law=world.law._replace(lifting=lifting))
    q0, v0 = landings()
    ours = simulate(world.system(), q0, v0, n_steps=28, dt=0.005, substeps=200)
    for i in range(3):
        d = mujoco.MjData(m)
        d.qpos[:], d.qvel[:] = q0[i], v0[i]
        path = []
        for _ in range(28):
            mujoco.mj_step(m, d, 200)
            path.append(d.qpos.copy())
        np.testing.assert_allclose(ours.q[i, 1:, :3], np.array(path)[:, :3], atol=atol)
    assert ours.q[:, :, 2].min() < HALF - 1e-3, "softness shows"


def test_default_contact_sinks_in(cube: ObjectModel) -> None:
    """A cube that falls flat at 1 m/s sinks in by millimetres by default, by tenths where contact is near rigid."""
    q, v = np.array([[0.0, 0, 0.0524 + 1e-3, 1, 0, 0, 0]]), np.array([[0.0, 0, -1.0, 0, 0, 0]])
    depth = [
        0.0524 - toss_in_mujoco(World(cube), q, v, 30, 1 / 592, soft=soft)[0][0, :, 2].min() for soft in (True, False)
    ]
    assert 2e-3 < depth[0] < 1e-2
    assert depth[1] < 3e-4
    with pytest.raises(InputError, match="default contact"):
        toss_in_mujoco(World(cube.with_changes(restitution=0.3)), q, v, 2, 1 / 592, soft=True)


def test_landing_neither_sinks_in_nor_bounces(cube: ObjectModel) -> None:
    q0, v0 = thrown(np.random.default_rng(1), 6)
    q, v = toss_in_mujoco(World(cube), q0, v0, 222, DT)
    lowest = corner_positions(cube, q)[..., 2].min(axis=-1)
    assert lowest.min() > -1e-4
    energy = (
        0.5 * 0.37 * (v[..., :3] ** 2).sum(-1) + 0.5 * 0.00081 * (v[..., 3:] ** 2).sum(-1) + 0.37 * 9.81 * q[..., 2]
    )
    assert np.diff(energy, axis=1).max() < 1e-4 * energy[:, 0].max()
    np.testing.assert_allclose(q[:, -1, 2], HALF, atol=1e-6)
    assert np.abs(v[:, -1]).max() < 1e-6


def test_the_elbow_lands_and_threads_and_chunks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    elbow = load_object(OBJECT_FILES / "elbow.xml", friction=0.3)
    q0, v0 = thrown(np.random.default_rng(2), 4, 1)
    q, v = toss_in_mujoco(World(elbow), q0, v0, 60, DT, substeps=40)
    assert q.shape == (4, 61, 8)
    assert v.shape == (4, 61, 7)
    np.testing.assert_allclose(np.linalg.norm(q[..., 3:7], axis=-1), 1, atol=1e-12)
    monkeypatch.setattr("tossid.physics.mujoco_engine._ROWS_AT_ONCE", 1)
    again = toss_in_mujoco(World(elbow), q0, v0, 60, DT, substeps=40, n_threads=2)
    np.testing.assert_array_equal(again[0], q)
    np.testing.assert_array_equal(again[1], v)


def test_what_diverges_or_is_no_start_is_told(
    cube: ObjectModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    q0, v0 = thrown(np.random.default_rng(3), 2)
    fast = v0.copy()
    fast[1, 3:] = 1e11
    with pytest.raises(DivergedError, match="toss 1") as error:
        toss_in_mujoco(World(cube), q0, fast, 10, DT)
    np.testing.assert_array_equal(np.asarray(error.value.state)[7:], fast[1])
    with pytest.raises(DivergedError, match="toss 1"):
        toss_in_mujoco(World(cube), q0, fast, 10, DT, n_threads=2)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(MotionError, match="row 0"):
        toss_in_mujoco(World(cube), q0 * np.nan, v0, 10, DT)
    with pytest.raises(MotionError, match="shapes"):
        toss_in_mujoco(World(cube), q0[:, :6], v0, 10, DT)
    with pytest.raises(InputError, match="positive"):
        toss_in_mujoco(World(cube), q0, v0, 10, DT, substeps=0)


# ---------------------------------------------------------------- contact in MuJoCo's numbers, and edits


def test_the_damping_ratio_of_no_bounce_and_of_all() -> None:
    assert damping_ratio(0.999) < 1e-3
    assert damping_ratio(np.exp(-2.0)) == pytest.approx(1.0)  # critical damping
    assert damping_ratio(0.02) > 2.0


@pytest.mark.parametrize("e", [0.1, 0.5, 0.9])
def test_a_bouncing_contact_leaves_with_its_share_of_the_speed(e: float) -> None:
    """The oscillator x'' = -k x - d x' from x = 0, until its force would become a pull."""
    k, d = (-number for number in bouncing_solref(e, 1e-3))
    x, v, h = 0.0, -1.0, 1e-6
    while -k * x - d * v > 0:
        v += h * (-k * x - d * v)
        x += h * v
    assert v == pytest.approx(e, abs=5e-3)
    assert np.sqrt(k) * 1e-3 <= 0.5  # the time step resolves it


def test_a_yielding_contact_has_its_stiffness_damping_and_added_mass(cube: ObjectModel) -> None:
    inverse, stiffness, relaxation = 5.0, 2e4, 3e-3
    body = cube.with_changes(compliance=1 / stiffness, relaxation=relaxation)
    plain, held = (soft_contact(World(body, law=Law(added_mass=mass)), inverse) for mass in (0.0, 0.8))
    assert plain.impedance == SOFT_IMPEDANCE
    assert held.impedance / (1 - held.impedance) == pytest.approx(0.8 * inverse)
    for soft in (plain, held):
        D, R = soft.impedance, (1 - soft.impedance) / soft.impedance * inverse
        K, B = -soft.solref[0] / D**2, -soft.solref[1] / D  # as MuJoCo scales them
        assert pytest.approx(stiffness) == K * D / R
        assert pytest.approx(relaxation * stiffness) == B / R


LINKS = """<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1"/>
    <geom name="wall" type="box" size="1 1 1" contype="0" conaffinity="0"/>
    <body name="a"><freejoint/><geom name="own" size=".1" mass="1"/>
      <body><joint name="hinge" type="hinge"/><geom size=".05" mass="1"/></body>
    </body>
  </worldbody>
</mujoco>"""


def test_an_edit_is_made_and_recorded_of_what_collides_and_turns() -> None:
    made = Edit(mujoco.MjSpec.from_string(LINKS), effect="friction")
    assert [geom.name for geom in made.grounds] == ["floor"]
    assert (len(made.own), [joint.name for joint in made.joints], made.body.name) == (2, ["hinge"], "a")
    made.set(made.spec.option, "timestep", made.spec.option.timestep, "option")  # what stays is no change
    made.set(made.own[0], "friction", [0.4, 0.005, 0.0001], "geom 'own'", exact=False, note="a note")
    (change,) = made.changes
    assert change.as_json() == {
        "effect": "friction",
        "where": "geom 'own'",
        "attribute": "friction",
        "before": "1 0.005 0.0001",
        "after": "0.4 0.005 0.0001",
        "exact": False,
        "note": "a note",
    }
    compiled = made.compiled()
    assert compiled.geom_friction[compiled.geom("own").id, 0] == 0.4
    made.own[0].size = [-1.0, 0.0, 0.0]
    with pytest.raises(ObjectError, match="cannot compile the patched model"):
        made.compiled()
