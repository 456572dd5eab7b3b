"""URDF: what is written is read back, with meshes in files; what cannot be an object is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.physics.trees import random_tree
from tossid.errors import FileError, ObjectError, TossidError
from tossid.objects import JointLaw, ObjectModel, corner_positions, load_object, object_from_mjcf, to_urdf

BOX = '<geom type="box" size=".1 .1 .1" mass="1"/>'
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
