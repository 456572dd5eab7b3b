"""Objects read from MJCF and URDF, and written back, are the objects that MuJoCo sees."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.physics.trees import random_tree
from tossid.errors import FileError, ObjectError
from tossid.objects import JointType, ObjectModel, load_object, object_from_mjcf, to_mjcf

TWO_BODIES = "<mujoco><worldbody>{}</worldbody></mujoco>"
BOX = '<geom type="box" size=".1 .1 .1" mass="1"/>'


def same_inertia(a: ObjectModel, b: ObjectModel, tolerance: float) -> None:
    np.testing.assert_array_equal(a.parent, b.parent)
    np.testing.assert_array_equal(a.joint_type, b.joint_type)
    for name in ("mass", "com", "inertia", "joint_pos", "joint_axis"):
        np.testing.assert_allclose(getattr(a, name)[1:], getattr(b, name)[1:], atol=tolerance, err_msg=name)
    np.testing.assert_allclose(a.mass, b.mass, atol=tolerance)
    np.testing.assert_allclose(a.com, b.com, atol=tolerance)
    np.testing.assert_allclose(a.inertia, b.inertia, atol=tolerance)


def same_corners(a: ObjectModel, b: ObjectModel, tolerance: float) -> None:
    for body in range(a.n_bodies):
        here, there = a.corner_pos[a.corner_body == body], b.corner_pos[b.corner_body == body]
        assert len(here) == len(there)
        gaps = np.linalg.norm(here[:, None] - there[None], axis=-1)
        assert gaps.min(axis=1).max() < tolerance


def test_the_cube_is_nominal(cube: ObjectModel) -> None:
    assert (cube.name, cube.n_bodies, cube.n_corners, cube.nq, cube.nv) == ("cube", 1, 8, 7, 6)
    assert cube.width == pytest.approx(0.1048)
    assert cube.mass[0] == 0.37
    assert (cube.friction, cube.restitution) == (0.18, 0.0)
    assert (cube.compliance, cube.relaxation, cube.cohesion) == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(cube.inertia[0], 0.00081 * np.eye(3))
    np.testing.assert_allclose(cube.com, 0)
    np.testing.assert_allclose(np.abs(cube.corner_pos), 0.0524)
    np.testing.assert_allclose(cube.center, 0)


def test_the_elbow_is_the_published_one(elbow: ObjectModel, shared_data: Path) -> None:
    urdf = load_object(shared_data / "pll_elbow" / "contactnets_elbow.urdf")
    assert urdf.joint_type[1] == JointType.HINGE
    same_inertia(urdf, elbow, 1e-12)
    same_corners(urdf, elbow, 1e-12)
    np.testing.assert_allclose(urdf.body_pos[1], elbow.body_pos[1])


@pytest.mark.parametrize("seed", range(6))
def test_what_is_written_is_read_back(seed: int) -> None:
    model = random_tree(np.random.default_rng(seed), n_bodies=1 + seed % 4)
    again = object_from_mjcf(to_mjcf(model, ground=False))
    same_inertia(model, again, 5e-6)
    same_corners(model, again, 5e-6)


def test_the_text_gives_the_very_same_arrays(cube: ObjectModel, elbow: ObjectModel) -> None:
    for model in (cube, elbow, random_tree(np.random.default_rng(7), n_bodies=3)):
        again = object_from_mjcf(model.mjcf)
        for name in ("mass", "com", "inertia", "corner_pos", "body_pos", "body_quat", "joint_axis"):
            np.testing.assert_array_equal(getattr(model, name), getattr(again, name), err_msg=name)


def test_learned_corners_survive_mjcf(cube: ObjectModel) -> None:
    rng = np.random.default_rng(3)
    learned = cube.with_changes(corner_pos=cube.corner_pos + rng.normal(size=(8, 3)) * 2e-3)
    same_corners(learned, object_from_mjcf(to_mjcf(learned)), 1e-6)


def test_the_scene_rests_on_its_ground(cube: ObjectModel) -> None:
    m = mujoco.MjModel.from_xml_string(to_mjcf(cube, timestep=1e-3))
    d = mujoco.MjData(m)
    d.qpos[2] = 0.0524
    mujoco.mj_step(m, d, 500)
    assert d.qpos[2] == pytest.approx(0.0524, abs=1e-4)
    assert np.abs(d.qvel).max() < 1e-3


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"nothing\.xml"):
        load_object(tmp_path / "nothing.xml")


def test_a_file_that_is_no_model_is_named(tmp_path: Path) -> None:
    path = tmp_path / "bad.xml"
    path.write_text("<mujoco><worldbody>")
    with pytest.raises(FileError, match=r"bad\.xml.*cannot parse"):
        load_object(path)


@pytest.mark.parametrize(
    ("bodies", "says"),
    [
        (f'<body name="a"><freejoint/>{BOX}</body><body name="b"><freejoint/>{BOX}</body>', "2 root bodies"),
        (f'<body name="a"><joint type="hinge"/>{BOX}</body>', "free joint"),
        (f'<body name="a"><freejoint/>{BOX}<body name="b">{BOX}</body></body>', "exactly one hinge or slide"),
        (f'<body name="a"><freejoint/>{BOX}<body name="b"><joint type="ball"/>{BOX}</body></body>', "hinge or slide"),
        ('<body name="a"><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>', "touch the ground"),
    ],
)
def test_an_object_that_cannot_be_simulated_is_refused(bodies: str, says: str) -> None:
    with pytest.raises(ObjectError, match=says):
        object_from_mjcf(TWO_BODIES.format(bodies))
