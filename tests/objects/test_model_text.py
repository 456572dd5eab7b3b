"""Objects from MJCF and URDF, and back, are the objects that MuJoCo sees; what has no equations is refused."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.physics.trees import random_tree
from tossid.errors import FileError, ObjectError, TossidError
from tossid.objects import (
    JointLaw,
    JointType,
    ObjectModel,
    corner_positions,
    load_object,
    object_from_mjcf,
    to_mjcf,
    to_urdf,
)

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


HINGED = '<mujoco><worldbody><body name="a"><freejoint/>{box}<body name="b">{inside}</body></body></worldbody></mujoco>'


def written(model: ObjectModel, folder: Path, name: str) -> ObjectModel:
    text, meshes = to_urdf(model, meshes=name)
    for file, mesh in meshes.items():
        (folder / file).write_text(mesh)
    (folder / f"{name}.urdf").write_text(text)
    return load_object(folder / f"{name}.urdf")


@pytest.mark.parametrize("seed", range(4))
def test_a_tree_comes_back_from_urdf(tmp_path: Path, seed: int) -> None:
    model = random_tree(np.random.default_rng(seed), n_bodies=1 + seed)
    again = written(model, tmp_path, f"tree_{seed}")
    np.testing.assert_array_equal(again.joint_type, model.joint_type)
    np.testing.assert_allclose(again.mass, model.mass, rtol=1e-6)
    q = np.random.default_rng(9).normal(size=(5, model.nq))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    here, there = corner_positions(model, q), corner_positions(again, q)
    assert np.linalg.norm(here[:, :, None] - there[:, None], axis=-1).min(axis=2).max() < 5e-6
    # the text carries the meshes: a dataset needs no files
    np.testing.assert_array_equal(object_from_mjcf(again.mjcf).corner_pos, again.corner_pos)


def test_joints_damping_and_friction_go_along(tmp_path: Path, elbow: ObjectModel) -> None:
    law = JointLaw(*np.array([[0, 0.1], [0, 0.2], [0, 0.3], [0, 0.0], [0, 0.4]]))
    again = written(elbow.with_changes(joint_law=law), tmp_path, "elbow")
    assert (again.joints.damping[1], again.joints.friction[1]) == (0.1, 0.2)
    assert (again.joints.stiffness[1], again.joints.armature[1]) == (0.0, 0.0)


def test_a_mesh_file_s_inertia_stays_the_body_s(tmp_path: Path) -> None:
    (tmp_path / "wedge.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    path = tmp_path / "wedge.xml"
    path.write_text(
        '<mujoco><asset><mesh name="w" file="wedge.obj" scale=".1 .1 .1"/></asset><worldbody><body name="a">'
        '<freejoint/><geom type="mesh" mesh="w" mass="0.6"/></body></worldbody></mujoco>'
    )
    wedge = load_object(path)
    assert wedge.mass[0] == pytest.approx(0.6)
    np.testing.assert_allclose(wedge.com[0], 0.025, atol=1e-6)
    assert sorted(map(tuple, wedge.corner_pos.round(6).tolist())) == [
        (0.0, 0.0, 0.0), (0.0, 0.0, 0.1), (0.0, 0.1, 0.0), (0.1, 0.0, 0.0),
    ]  # fmt: skip
    np.testing.assert_array_equal(object_from_mjcf(wedge.mjcf).inertia, wedge.inertia)


@pytest.mark.parametrize(
    ("inside", "says"),
    [
        (f'<joint type="ball"/>{BOX}', "exactly one hinge or slide"),
        (f'<joint type="hinge"/><joint type="slide"/>{BOX}', "exactly one hinge or slide"),
        (f'<joint name="j" type="hinge" range="-60 60" limited="true"/>{BOX}', "joint 'j' has limits"),
        (f'<joint type="hinge" ref="20"/>{BOX}', "reference position"),
        ('<joint type="hinge"/>', "mass"),
        ('<joint type="hinge"/><geom type="box" size=".1 .1 .1" mass="0"/>', "mass"),
        (f"<freejoint/>{BOX}", "free joint"),
    ],
    ids=["ball", "two joints", "limits", "ref", "massless", "no mass", "two free bodies"],
)
def test_a_tree_that_tossid_has_no_equations_for_is_refused(inside: str, says: str) -> None:
    with pytest.raises(ObjectError, match=says):
        object_from_mjcf(HINGED.format(box=BOX, inside=inside))


def test_a_loop_is_refused() -> None:
    text = HINGED.format(box=BOX, inside=f'<joint type="hinge"/>{BOX}')
    loop = '<equality><weld body1="a" body2="b"/></equality></mujoco>'
    with pytest.raises(ObjectError, match="1 equality constraint"):
        object_from_mjcf(text.replace("</mujoco>", loop))


@pytest.mark.parametrize(
    "vertices", ["v 0 0 0\nv 1 0 0\nv 0 1 0\n", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\n"], ids=["three", "flat"]
)
def test_a_mesh_without_a_hull_is_refused(tmp_path: Path, vertices: str) -> None:
    (tmp_path / "flat.obj").write_text(vertices + "f 1 2 3\n")
    path = tmp_path / "flat.xml"
    path.write_text(
        '<mujoco><asset><mesh file="flat.obj"/></asset><worldbody><body name="a"><freejoint/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><geom type="mesh" mesh="flat"/>'
        "</body></worldbody></mujoco>"
    )
    with pytest.raises(TossidError, match=r"hull|volume|vert|faces|mesh") as refused:
        load_object(path)
    assert isinstance(refused.value, FileError | ObjectError)


def test_a_mesh_that_is_not_there_is_named(tmp_path: Path) -> None:
    path = tmp_path / "gone.xml"
    path.write_text(
        '<mujoco><asset><mesh file="gone.obj"/></asset><worldbody><body name="a"><freejoint/>'
        '<geom type="mesh" mesh="gone"/></body></worldbody></mujoco>'
    )
    with pytest.raises(FileError, match=r"gone\.obj"):
        load_object(path)
