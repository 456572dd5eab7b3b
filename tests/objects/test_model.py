"""Objects as values and as text: sizes, MJCF and URDF and back, kinematics as MuJoCo's, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.physics.trees import random_state, random_tree
from tossid.errors import ConfigError, FileError, InputError, ObjectError
from tossid.objects import (
    JointLaw,
    JointType,
    ObjectModel,
    body_poses,
    box,
    center_positions,
    corner_heights,
    corner_positions,
    free_joints,
    load_object,
    need_stated,
    object_from_mjcf,
    to_mjcf,
    to_urdf,
    unstated_object,
)
from tossid.objects.unstated import hinge_of
from tossid.rotations import geodesic_angle


def test_the_centre_is_that_of_the_bases_corners(elbow: ObjectModel) -> None:
    shift = np.array([0.01, 0, 0])
    moved = np.where((elbow.corner_body == 0)[:, None], elbow.corner_pos + shift, elbow.corner_pos + 1.0)
    np.testing.assert_allclose(elbow.with_changes(corner_pos=moved).center, elbow.center + shift)


def test_it_has_the_inertia_of_a_solid_box() -> None:
    edges = np.array([0.2, 0.1, 0.06])
    model = box("brick", edges, 0.5, friction=0.3)
    # the second moments of points that fill it evenly
    axis = (np.arange(60) + 0.5) / 60 - 0.5
    points = np.array(list(product(axis, axis, axis))) * edges
    inertia = 0.5 * np.mean((points**2).sum(axis=1)) * np.eye(3) - 0.5 * points.T @ points / len(points)
    np.testing.assert_allclose(model.inertia[0], inertia, rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(np.ptp(model.corner_pos, axis=0), edges, rtol=1e-12)
    assert (model.mass.item(), model.friction, model.width) == (0.5, 0.3, 0.2)
    assert box("brick", edges, 0.5, com=(0.02, 0, -0.01)).com[0].tolist() == [0.02, 0, -0.01]


def test_two_links_have_a_hinge_and_no_shape(elbow: ObjectModel) -> None:
    hinge = hinge_of(elbow)
    single, model = unstated_object(com=(0.01, 0.0, 0.0), gyration=0.03), unstated_object(hinge=hinge)
    assert (single.nq, single.nv, single.n_corners, single.is_stated) == (7, 6, 0, False)
    assert not load_object("unknown").is_stated
    assert (model.nq, model.nv, model.n_corners, model.mass.sum()) == (8, 7, 0, 1.0)
    q = np.array([0.1, 0.2, 0.3, 0.5, 0.5, -0.5, 0.5, 1.2])
    for one, other in zip(body_poses(model, q), body_poses(elbow, q), strict=True):
        assert one == pytest.approx(other)
    assert hinge_of(unstated_object()) is None
    slide = elbow.with_changes(joint_type=np.array([0, 2]))
    with pytest.raises(InputError, match="two links on a hinge"):
        hinge_of(slide)


def with_joints(model: ObjectModel, part: str, values: object) -> ObjectModel:
    return model.with_changes(joint_law=JointLaw(**{**free_joints(2)._asdict(), part: np.array(values)}))


@pytest.mark.parametrize(
    ("call", "says"),
    [
        *(
            (lambda cube, name=name, x=x: cube.with_changes(**{name: x}), name)
            for name in ("compliance", "relaxation", "cohesion")
            for x in (-1e-9, float("nan"), float("inf"))
        ),
        *(
            (lambda cube, name=name, x=x: replace(cube, **{name: x}), name)
            for name, x in (
                *(("friction", x) for x in (-0.1, np.nan, 1e300)),
                *(("mass", np.array([x])) for x in (np.inf, -1.0)),
                *(("restitution", 50.0), ("width", np.inf), ("com", np.full((1, 3), np.nan))),
            )
        ),
        *(
            (lambda _, part=part, values=values: with_joints(load_object("elbow"), part, values), part)
            for part in ("damping", "friction", "stiffness", "armature")
            for values in ([0.0, -1.0], [0.0, float("nan")], [0.0] * 3)
        ),
        (lambda _: box("brick", (0.2, 0.1, 0.06), 0.5, com=(0.2, 0, 0)), "com: .* lies outside the box"),
        (lambda _: box("a b", (0.2, 0.1, 0.06), 0.5), "name: 'a b' will not do"),
        (lambda _: need_stated(unstated_object(), "a diagnosis"), "a diagnosis needs a stated object"),
    ],
)
def test_values_that_cannot_be_are_refused(cube: ObjectModel, call: Callable[[ObjectModel], object], says: str) -> None:
    with pytest.raises((ObjectError, ConfigError, InputError), match=says):
        call(cube)


# ---------------------------------------------------------------- MJCF and URDF


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


def scene(*bodies: str, after: str = "", assets: str = "") -> str:
    return f"<mujoco><asset>{assets}</asset><worldbody>{''.join(bodies)}</worldbody>{after}</mujoco>"


def hinged(inside: str, **parts: str) -> str:
    return scene(f'<body name="a"><freejoint/>{BOX}<body name="b">{inside}</body></body>', **parts)


FREE = '<body name="{}"><freejoint/>{}</body>'


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (scene(FREE.format("a", BOX), FREE.format("b", BOX)), "2 root bodies"),
        (scene(f'<body name="a"><joint type="hinge"/>{BOX}</body>'), "free joint"),
        (scene(FREE.format("a", '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>')), "touch the ground"),
        (hinged(BOX), "exactly one hinge or slide"),
        (hinged(f'<joint type="ball"/>{BOX}'), "exactly one hinge or slide"),
        (hinged(f'<joint type="hinge"/><joint type="slide"/>{BOX}'), "exactly one hinge or slide"),
        (hinged(f'<joint name="j" type="hinge" range="-60 60" limited="true"/>{BOX}'), "joint 'j' has limits"),
        (hinged(f'<joint type="hinge" ref="20"/>{BOX}'), "reference position"),
        (hinged('<joint type="hinge"/>'), "mass"),
        (hinged('<joint type="hinge"/><geom type="box" size=".1 .1 .1" mass="0"/>'), "mass"),
        (hinged(f"<freejoint/>{BOX}"), "free joint"),
        (
            hinged(f'<joint type="hinge"/>{BOX}', after='<equality><weld body1="a" body2="b"/></equality>'),
            "1 equality constraint",
        ),
    ],
)
def test_a_tree_that_tossid_has_no_equations_for_is_refused(text: str, says: str) -> None:
    with pytest.raises(ObjectError, match=says):
        object_from_mjcf(text)


MESHED = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><geom type="mesh" mesh="flat"/>'


@pytest.mark.parametrize(
    ("text", "vertices", "says"),
    [
        (None, None, r"thing\.xml"),
        ("<mujoco><worldbody>", None, r"thing\.xml.*cannot parse"),
        (scene(FREE.format("a", MESHED), assets='<mesh file="flat.obj"/>'), None, r"flat\.obj"),
        (scene(FREE.format("a", MESHED), assets='<mesh file="flat.obj"/>'), 3, "hull|volume|vert|faces|mesh"),
        (scene(FREE.format("a", MESHED), assets='<mesh file="flat.obj"/>'), 4, "hull|volume|vert|faces|mesh"),
    ],
    ids=["no file", "no model", "no mesh", "a triangle", "a square"],
)
def test_a_file_that_is_no_object_is_refused(tmp_path: Path, text: str | None, vertices: int | None, says: str) -> None:
    if text is not None:
        (tmp_path / "thing.xml").write_text(text)
    if vertices is not None:
        square = ["v 0 0 0", "v 1 0 0", "v 0 1 0", "v 1 1 0"][:vertices]
        (tmp_path / "flat.obj").write_text("\n".join([*square, "f 1 2 3", ""]))
    with pytest.raises((FileError, ObjectError), match=says):
        load_object(tmp_path / "thing.xml")


# ---------------------------------------------------------------- kinematics


@pytest.mark.parametrize("seed", range(10))
def test_poses_and_corners_are_mujocos(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_tree(rng, n_bodies=1 + seed % 5)
    m = mujoco.MjModel.from_xml_string(model.mjcf)
    d = mujoco.MjData(m)
    q, _ = random_state(rng, model)
    d.qpos[:] = q
    mujoco.mj_kinematics(m, d)
    pos, quat = body_poses(model, q)
    np.testing.assert_allclose(pos, d.xpos[1:], atol=1e-12)
    assert geodesic_angle(quat, d.xquat[1:]).max() < 1e-7

    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    boxes = [signs * m.geom_size[g] @ d.geom_xmat[g].reshape(3, 3).T + d.geom_xpos[g] for g in range(m.ngeom)]
    corners = corner_positions(model, q)
    np.testing.assert_allclose(corner_heights(model, q), corners[..., 2], atol=1e-12)
    for body in range(model.n_bodies):
        mine = corners[model.corner_body == body]
        gaps = np.linalg.norm(mine[:, None] - boxes[body][None], axis=-1)
        assert gaps.min(axis=1).max() < 1e-12


def test_batches_are_their_members_and_the_centre_follows_the_base(cube: ObjectModel) -> None:
    rng = np.random.default_rng(0)
    model = random_tree(rng, n_bodies=3)
    q = np.array([random_state(rng, model)[0] for _ in range(6)]).reshape(2, 3, -1)
    for positions in (corner_positions, center_positions):
        found = positions(model, q)
        for i in np.ndindex(2, 3):
            np.testing.assert_allclose(found[i], positions(model, q[i]), atol=1e-15)
    moved = cube.with_changes(corner_pos=cube.corner_pos + np.array([0.01, 0.0, 0.0]))
    turned = np.array([1.0, 2.0, 3.0, np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])  # by a quarter about z
    np.testing.assert_allclose(center_positions(moved, turned), [1.0, 2.01, 3.0], atol=1e-15)
