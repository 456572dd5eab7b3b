"""The patched MJCF, run by MuJoCo itself, shows the effect: forces, masses, friction, bounce, drag."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import mujoco
import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS, diagnosis, hypothesis
from tests.diagnosis.tossed import recorded, sample_of
from tests.models.made import DT, thrown
from tests.objects.meshes import obj, scan, stl
from tossid.diagnosis.inference.hypothesis import COULOMB, ContactLaw, Hypothesis
from tossid.diagnosis.likelihood.engine_discrepancy import MujocoWorld
from tossid.diagnosis.localisation.rollouts import distances, first_states
from tossid.diagnosis.patch import rerun as module
from tossid.diagnosis.patch.make import Patch, make_patch
from tossid.diagnosis.patch.rerun import rerun, runs_in_mujoco
from tossid.diagnosis.simulators import read_simulator, world_of_mjcf
from tossid.objects import ObjectModel
from tossid.physics.effects import RecordingErrors, World
from tossid.physics.effects.in_mujoco import toss_in_mujoco
from tossid.rotations import geodesic_angle, quat_exp
from tossid.types import Toss

USER = """<mujoco model="my cube">
  <option timestep="0.002"/>
  <worldbody>
    <light pos="0 0 3"/>
    <geom name="floor" type="plane" size="5 5 .1" friction="0.18 0.005 0.0001"/>
    <body name="cube" pos="0 0 0.3">
      <freejoint/>
      <geom type="box" size="0.0524 0.0524 0.0524" mass="0.37" friction="0.18 0.005 0.0001"/>
    </body>
  </worldbody>
</mujoco>
"""

HALF = 0.0524

OWN = ContactLaw("own", lifting=1e-4)


@pytest.fixture
def users(tmp_path: Path) -> Path:
    path = tmp_path / "cube.xml"
    path.write_text(USER)
    return path


def patched(users: Path, **values: list[float]) -> Patch:
    world, _ = world_of_mjcf(users, width=0.1048)
    made = Hypothesis(world, OWN)
    for name, numbers in values.items():
        made = made.plus(EFFECTS[name], np.array(numbers, dtype=float))
    return make_patch(made, mjcf=users)


def fly(m: mujoco.MjModel, v: list[float], seconds: float, *, z: float = 10.0) -> mujoco.MjData:
    d = mujoco.MjData(m)
    d.qpos[:] = [0, 0, z, 1, 0, 0, 0]
    d.qvel[:] = v
    for _ in range(round(seconds / m.opt.timestep)):
        mujoco.mj_step(m, d)
    return d


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_effect_is_changed_recorded_or_refused_with_a_reason(cube: ObjectModel, users: Path, name: str) -> None:
    effect = EFFECTS[name]
    values = np.array([p.low + 0.3 * (p.high - p.low) for p in effect.parameters])
    for file in (None, users):
        base = World(cube) if file is None else world_of_mjcf(users, width=0.1048)[0]
        patch = make_patch(Hypothesis(base, OWN).plus(effect, values), mjcf=file)
        listed = {change.effect for change in patch.changes}, set(patch.recording), set(patch.not_expressed)
        assert sum(name in each for each in listed) == 1
        assert patch.keys
        if patch.changes:
            mujoco.MjModel.from_xml_string(patch.mjcf)


def slide(m: mujoco.MjModel, v: list[float], seconds: float) -> mujoco.MjData:
    """Of a cube that has come to rest."""
    d = fly(m, [0] * 6, 0.3, z=HALF)
    d.qvel[:] = v
    mujoco.mj_step(m, d, round(seconds / m.opt.timestep))
    return d


def test_keys_say_the_objects_numbers_and_no_effect_changes_nothing(cube: ObjectModel, users: Path) -> None:
    patch = make_patch(hypothesis(cube, friction=[0.3], gravity=[9.6]))
    assert patch.keys == {
        "object.friction": {"before": 0.18, "after": 0.3},
        "gravity": {"before": 9.81, "after": 9.6},
    }
    nothing = patched(users)
    assert (len(nothing.changes), nothing.keys, nothing.as_json()["mjcf"]) == (0, {}, None)


# ---------------------------------------------------------------- what MuJoCo then does


MASS, G, SPIN = 0.37, 9.81, mujoco.MjModel.from_xml_string(USER).body_inertia[1, 2]
SLOWED = np.exp(-0.1 / MASS)
"""Share of the speed that is left after a second of drag of 0.1 N s/m."""


def drag(m: mujoco.MjModel) -> float:
    """At 2 m/s, on average over directions [N]."""
    forces = []
    for v in np.random.default_rng(0).normal(size=(400, 3)):
        d = mujoco.MjData(m)
        d.qpos[:], d.qvel[:3] = [0, 0, 5, 1, 0, 0, 0], 2.0 * v / np.linalg.norm(v)
        mujoco.mj_forward(m, d)
        forces.append(-d.qfrc_fluid[:3] @ d.qvel[:3] / 2.0)
    return float(np.mean(forces))


def over_tilted_ground(m: mujoco.MjModel) -> list[float]:
    """Height over the plane, which was turned about +y, and whether it slid downhill, along +x."""
    d = fly(m, [0] * 6, 0.4, z=HALF + 0.012)
    return [d.qpos[2] - HALF - (0.01 / np.cos(0.05) - np.tan(0.05) * d.qpos[0]), d.qvel[0] > 0.4 * G * 0.5 * 0.03]


def rebound(m: mujoco.MjModel) -> float:
    """Share of the speed straight down on a corner, the centre of mass above it."""
    d, axis = mujoco.MjData(m), np.cross([1, 1, 1], [0, 0, -1]) / np.sqrt(2)
    d.qpos[:] = [0, 0, np.sqrt(3) * HALF + 0.02, *quat_exp(np.arccos(-1 / np.sqrt(3)) * axis)]
    d.qvel[2], hit = -1.0, 0.0
    while d.qvel[2] < 0.05:
        hit = min(hit, d.qvel[2])
        mujoco.mj_step(m, d)
    while d.ncon:
        mujoco.mj_step(m, d)
    return float(d.qvel[2] / -hit)


def slid(along: int) -> Callable[[mujoco.MjModel], float]:
    return lambda m: slide(m, np.eye(6)[along].tolist(), 0.1).qvel[along]


@pytest.mark.parametrize(
    ("effects", "measured", "expected", "off"),
    [
        ({"gravity": [9.0], "uniform_force": [MASS, 0.0, 2 * MASS]}, lambda m: fly(m, [0] * 6, 0.5).qvel[:3],
         [0.5, 0, -3.5], 4e-3),
        ({"gravity": [0.0], "linear_drag": [0.1]}, lambda m: fly(m, [2.0, 0, 0, 0, 0, 0], 1.0).qvel[:3],
         [2.0 * SLOWED, 0, 0], 2e-3),
        ({"gravity": [0.0], "wind": [3.0, 0.0, 0.1]}, lambda m: fly(m, [0] * 6, 1.0).qvel[:3],
         [3.0 * (1 - SLOWED), 0, 0], 1e-3),
        ({"gravity": [0.0], "quadratic_drag": [0.05]}, drag, 0.05 * 4.0, 4e-3),
        # a quarter of a period takes it to the centre
        ({"gravity": [0.0], "position_force": [2.0, 1.0, 0.0, 10.0]},
         lambda m: fly(m, [0] * 6, 0.5 * np.pi * np.sqrt(MASS / 2.0)).qpos[0], 1.0, 0.01),
        # (soft contact makes friction slow to act)
        ({"friction": [0.1]}, slid(0), 1.0 - 0.1 * G * 0.1, 0.02),
        ({"friction": [0.3]}, slid(0), 1.0 - 0.3 * G * 0.1, 0.02),
        ({"anisotropic_friction": [0.1, 0.3]}, slid(0), 1.0 - 0.1 * G * 0.1, 0.02),
        ({"anisotropic_friction": [0.1, 0.3]}, slid(1), 1.0 - 0.3 * G * 0.1, 0.02),
        # friction that is found after compliance reaches the pair of geoms
        ({"compliance": [20000.0, 60.0, 0.0], "friction": [0.3]}, slid(0), 1.0 - 0.3 * G * 0.1, 0.02),
        ({"friction": [0.005], "torsional_friction": [0.02]}, lambda m: slide(m, [0, 0, 0, 0, 0, 5.0], 0.05).qvel[5],
         5.0 - 0.02 * MASS * G / SPIN * 0.05, 0.7),
        ({"ground_height": [0.01], "ground_tilt": [0.0, 0.05], "friction": [0.02]}, over_tilted_ground, [0, 1], 2e-3),
        ({"restitution": [0.5], "friction": [0.005]}, rebound, 0.5, 0.02),
        *(
            ({"compliance": [k, c, held]}, lambda m: HALF - fly(m, [0] * 6, 1.0, z=HALF).qpos[2],
             (1 - held) * MASS * G / 4 / k, 0.03 * (1 - held) * MASS * G / 4 / k)
            for k, c, held in ((2000.0, 20.0, 0.0), (1000.0, 60.0, 0.9))
        ),
    ],
)  # fmt: skip
def test_mujoco_shows_each_effect_at_its_size(
    users: Path, effects: dict[str, list[float]], measured: Callable[[mujoco.MjModel], Any], expected: Any, off: float
) -> None:
    np.testing.assert_allclose(measured(patched(users, **effects).model), expected, rtol=0, atol=off)


def test_mass_inertia_and_size_are_the_bodys(users: Path, cube: ObjectModel) -> None:
    before = mujoco.MjModel.from_xml_string(USER)
    m = patched(users, com_offset=[0.005, 0.0, -0.01], inertia=[1.5]).model
    np.testing.assert_allclose(m.body_ipos[1], [0.005, 0, -0.01], atol=1e-12)
    np.testing.assert_allclose(m.body_inertia[1], 1.5 * before.body_inertia[1], rtol=1e-5)
    assert m.body_mass[1] == before.body_mass[1]
    # size changes the corners but not the inertia
    m = patched(users, geometry=[1.02]).model
    np.testing.assert_allclose(m.geom_size[1], 1.02 * HALF)
    np.testing.assert_allclose(m.body_inertia[1], before.body_inertia[1], rtol=1e-5)
    rest = fly(make_patch(hypothesis(cube, geometry=[1.02])).model, [0] * 6, 0.3, z=1.02 * HALF)
    assert abs(rest.qpos[2] - 1.02 * HALF) < 2e-5


def test_a_contact_that_tosses_do_not_follow_is_made_rigid(users: Path) -> None:
    world, _ = world_of_mjcf(users, width=0.1048)
    patch = make_patch(Hypothesis(world, COULOMB), mjcf=users)
    assert {change.effect for change in patch.changes} == {"rigid contact"}
    hit = fly(patch.model, [0] * 6, 0.2, z=HALF + 0.02)
    assert abs(hit.qpos[2] - HALF) < 1e-4
    across = np.sqrt(0.5)
    sinks, slides = ({}, {})
    for name, m in (("before", make_patch(Hypothesis(world, OWN), mjcf=users).model), ("after", patch.model)):
        sinks[name] = HALF - fly(m, [0] * 6, 0.06, z=HALF + 1e-3).qpos[2]
        slides[name] = np.linalg.norm(slide(m, [across, across, 0, 0, 0, 0], 0.2).qvel[:2])
    assert abs(sinks["after"]) < 0.2 * abs(sinks["before"])
    assert slides["after"] == pytest.approx(1 - 0.18 * 9.81 * 0.2, abs=0.05)
    assert slides["before"] > slides["after"] + 0.05  # a pyramid's edge holds less


def test_the_file_keeps_what_the_user_wrote_and_names_no_folder(users: Path) -> None:
    keys = '<keyframe><key name="up" qpos="0 0 1 1 0 0 0"/></keyframe>'
    users.write_text(
        USER.replace("</mujoco>", keys + "</mujoco>").replace('0.18 0.005 0.0001"/>\n    <body', '0.1"/><body')
    )
    patch = patched(users, friction=[0.3])
    assert str(users.parent) not in patch.mjcf
    m = mujoco.MjModel.from_xml_string(patch.mjcf)
    assert m.key("up").qpos[2] == 1.0
    np.testing.assert_allclose(m.geom_friction[:, 0], 0.3)  # MuJoCo would take the larger
    np.testing.assert_allclose(m.geom("floor").size, [5, 5, 0.1])
    assert m.opt.timestep == 0.002


@pytest.mark.parametrize("kind", ["stl", "obj"])
def test_the_patched_file_takes_its_meshes_and_textures_along(tmp_path: Path, cube: ObjectModel, kind: str) -> None:
    for name in ("mine/sub", "tex/other"):
        (tmp_path / name).mkdir(parents=True)
    mesh = {"stl": stl(scan(1)), "obj": obj(scan(1), normals=5).encode()}[kind]
    (tmp_path / f"mine/sub/scan.{kind}").write_bytes(mesh)
    pixels = np.zeros((4, 4, 3), dtype=np.uint8)
    for name, shade in (("a.png", 0), ("other/a.png", 255)):
        cv2.imwrite(str(tmp_path / "tex" / name), pixels + np.uint8(shade))
    files = f'<mesh name="m" file="sub/scan.{kind}"/><texture name="t" type="2d" file="a.png"/>'
    files += '<texture name="u" type="2d" file="other/a.png"/>'
    head = f'<compiler meshdir="mine" texturedir="tex"/><asset>{files}</asset><worldbody>'
    text = USER.replace("<worldbody>", head).replace('type="box" size="0.0524 0.0524 0.0524"', 'type="mesh" mesh="m"')
    (tmp_path / "cube.xml").write_text(text)
    world, _ = world_of_mjcf(tmp_path / "cube.xml", width=None)
    made = Hypothesis(world, OWN).plus(EFFECTS["friction"], np.array([0.3]))
    patch = make_patch(made, mjcf=tmp_path / "cube.xml")
    found = replace(diagnosis(cube), patch=patch.as_json()).save(tmp_path / "gap").rename(tmp_path / "elsewhere")
    shutil.rmtree(tmp_path / "mine")
    shutil.rmtree(tmp_path / "tex")
    text = (found / "patched.xml").read_text()
    assert str(tmp_path) not in text
    m = mujoco.MjModel.from_xml_path(str(found / "patched.xml"))
    assert m.nmesh == 1
    assert m.nmeshvert == patch.model.nmeshvert
    assert sorted(m.tex_data[m.tex_adr].tolist()) == [0, 255]


def test_recorded_motion_of_a_mujoco_world_is_that_of_a_world(cube: ObjectModel) -> None:
    """In flight both simulators are exact: only the recording can differ."""
    recording = RecordingErrors(1.05, 1.02, (0.004, -0.003, 0.002), (0.01, -0.02))
    ours = World(cube, recording=recording)
    theirs = MujocoWorld(make_patch(Hypothesis(World(cube))).model, ours)
    q0 = np.array([[0.0, 0.0, 3.0, 0.6, 0.0, 0.8, 0.0]])
    v0 = np.array([[0.5, -0.3, 0.4, 2.0, -1.0, 3.0]])
    steps = np.array([40])
    one = ours.roll_out(q0, v0, n_steps=steps, dt=1 / 148, substeps=4)
    other = theirs.roll_out(q0, v0, n_steps=steps, dt=1 / 148)
    np.testing.assert_allclose(other, one, atol=2e-4)


def test_a_motion_that_explodes_is_lost_and_said(cube: ObjectModel) -> None:
    m = make_patch(Hypothesis(World(cube))).model
    q0 = np.tile([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0], (2, 1))
    v0 = np.zeros((2, 6))
    v0[1, 0] = 1e9
    run = MujocoWorld(m, World(cube)).roll_out(q0, v0, n_steps=np.array([5, 5]), dt=0.01)
    assert np.isfinite(run[0]).all()
    assert np.isnan(run[1, -1]).all()


# ---------------------------------------------------------------- whole tosses in MuJoCo


FRAMES = 60


@pytest.fixture(scope="module")
def slippery(cube: ObjectModel) -> list[Toss]:
    """Tosses by MuJoCo's nearly rigid contact, of a cube with friction 0.4."""
    rng = np.random.default_rng(5)
    world = World(cube.with_changes(friction=0.4))
    run, _ = toss_in_mujoco(world, *thrown(rng, 6), FRAMES, DT, substeps=68)
    return recorded(run, cube, rng)


def errors_of(made: Hypothesis, tosses: list[Toss], path: Path | None = None) -> np.ndarray:
    runs = runs_in_mujoco(path)(made, tosses, sample_of(tosses, made.base.object))
    return distances(runs, [toss.q for toss in tosses], made.base.object.width)


def by_hand(m: mujoco.MjModel, toss: Toss, q: np.ndarray, v: np.ndarray, width: float) -> tuple[float, float]:
    """What a person computes: steps of the model's own, and between two of them a straight line."""
    d = mujoco.MjData(m)
    d.qpos[:], d.qvel[:] = q, v
    far, turned, before = [], [], q.copy()
    for t, pose in zip(toss.t - toss.t[0], toss.q, strict=True):
        while d.time < t - 1e-9:
            before = d.qpos.copy()
            mujoco.mj_step(m, d)
        now = before + (d.qpos - before) * (1 - (d.time - t) / m.opt.timestep) if d.time > t else d.qpos.copy()
        far.append(np.linalg.norm(now[:3] - pose[:3]))
        turned.append(geodesic_angle(now[3:] / np.linalg.norm(now[3:]), pose[3:]))
    return 100 * float(np.mean(far)) / width, float(np.rad2deg(np.mean(turned)))


@pytest.mark.parametrize("found", [{}, {"friction": [0.4], "com_offset": [0.002, 0.0, -0.003]}])
@pytest.mark.parametrize("own", [True, False])
def test_errors_are_those_of_the_file_in_plain_mujoco(
    cube: ObjectModel, slippery: list[Toss], tmp_path: Path, found: dict[str, list[float]], own: bool
) -> None:
    path, out = tmp_path / "cube.xml", tmp_path / "patched.xml"
    path.write_text(USER)
    simulator, sample = read_simulator(path, cube), sample_of(slippery, cube)
    made = Hypothesis(simulator.world, simulator.law if own else simulator.laws[0])
    for name, values in found.items():
        made = made.plus(EFFECTS[name], np.array(values))
    errors = errors_of(made, slippery, path)
    patch = make_patch(made, mjcf=path)
    out.write_text(patch.mjcf)
    # nothing to change: the user's own file
    m = mujoco.MjModel.from_xml_path(str(out if patch.changes else path))
    q, v = first_states(slippery, made.world(), sample.windows)
    for i in (0, 3):
        # (contact amplifies rounding of the time at which a frame is)
        assert errors[i] == pytest.approx(by_hand(m, slippery[i], q[i], v[i], cube.width), rel=2e-3)


def test_the_right_patch_closes_the_gap_in_mujoco_and_what_mjcf_lacks_takes_no_part(
    cube: ObjectModel, slippery: list[Toss]
) -> None:
    found = hypothesis(cube, friction=[0.4], vortex=[2.0])
    run = rerun(found, Hypothesis(World(cube)), slippery, sample_of(slippery, cube))
    assert (run["n_tosses"], run["not_in_it"]) == (6, ["vortex"])
    for key, least in (("position_error_pct", 1.0), ("rotation_error_deg", 0.8)):
        assert run[key]["after"]["value"] < least < run[key]["before"]["value"]
    without = errors_of(hypothesis(cube, friction=[0.4]), slippery)
    np.testing.assert_array_equal(errors_of(found, slippery), without)


def test_a_recording_in_other_lengths_is_predicted_in_them(cube: ObjectModel, slippery: list[Toss]) -> None:
    longer = [replace(toss, q=toss.q * ([1.05] * 3 + [1] * 4), v=toss.v * ([1.05] * 3 + [1] * 3)) for toss in slippery]
    found = {"friction": [0.4]}
    plain = errors_of(hypothesis(cube, **found), slippery)
    scaled = errors_of(hypothesis(cube, **found, length_scale=[1.05]), longer)
    np.testing.assert_allclose(scaled, plain * [1.05, 1.0], atol=0.1)


def test_of_many_tosses_some_are_run_and_counted(
    cube: ObjectModel, slippery: list[Toss], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MOST_SECONDS", 2.5 * FRAMES * DT)
    sample = sample_of(slippery, cube)
    errors = errors_of(Hypothesis(World(cube)), slippery)
    assert np.isfinite(errors).all(1).sum() == 2
    assert rerun(hypothesis(cube, friction=[0.4]), Hypothesis(World(cube)), slippery, sample)["n_tosses"] == 2
