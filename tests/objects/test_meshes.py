"""People's meshes load, touch the ground where their files say."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from tests.objects.meshes import KINDS, MJCF, TURNED, divided_box, obj, scan, stl, stl_in_words, urdf, written
from tests.store.makers import make_dataset
from tossid.errors import FileError, ObjectError
from tossid.objects import load_object
from tossid.objects.files.mesh import read_mesh
from tossid.objects.files.outline import hull_vertices, outline
from tossid.objects.roundness import directions
from tossid.rotations import quat_to_matrix
from tossid.store import open_dataset, write_dataset

WAYS = directions(500)


def reach(points: Any) -> Any:
    """How far points reach in many directions [m]."""
    return (np.asarray(points) @ WAYS.T).max(axis=0)


def compiled(path: Path) -> mujoco.MjModel:
    """A model as MuJoCo alone has it."""
    spec = mujoco.MjSpec.from_file(str(path))
    spec.worldbody.bodies[0].add_freejoint() if not list(spec.worldbody.bodies[0].joints) else None
    return spec.compile()


@pytest.mark.parametrize("kind", KINDS)
def test_a_mesh_touches_the_ground_where_its_file_says(kind: str, tmp_path: Path) -> None:
    vertices = KINDS[kind][1]
    model = load_object(written(tmp_path, kind), friction=0.3)
    size = np.ptp(vertices, axis=0).max()
    np.testing.assert_allclose(reach(model.corner_pos), reach(vertices), atol=2e-6 * size)
    if "box" in kind:
        assert model.n_corners == 8
    np.testing.assert_allclose(model.com, [[0.001, 0, 0]])
    np.testing.assert_allclose(model.inertia, [0.00081 * np.eye(3)])


FRAMES = {
    "scale": ('<mesh name="m" file="scan.obj" scale="2 1 0.5"/>', '<geom type="mesh" mesh="m" mass="0.2"/>'),
    "mirrored": ('<mesh name="m" file="scan.obj" scale="1 -1 1"/>', '<geom type="mesh" mesh="m" mass="0.2"/>'),
    "reference frame": (
        '<mesh name="m" file="scan.obj" refpos="0.1 0.2 -0.3" refquat="0.6 0.8 0 0"/>',
        '<geom type="mesh" mesh="m" mass="0.2"/>',
    ),
    "geom's frame": (
        '<mesh name="m" file="scan.obj" inertia="exact"/>',
        '<geom type="mesh" mesh="m" density="700" pos="0.3 0 0.1" euler="20 30 40"/>',
    ),
    "two geoms, one only seen": (
        '<mesh name="m" file="scan.obj" inertia="convex"/><mesh name="n" file="scan.obj" scale="3 3 3"/>',
        '<geom type="mesh" mesh="m" mass="0.2"/><geom type="mesh" mesh="n" contype="0" conaffinity="0" mass="0.1"/>',
    ),
    "a box that is fitted to a mesh": (
        '<mesh name="m" file="scan.obj"/>',
        '<geom type="box" mesh="m" mass="0.2"/><geom type="box" size="0.01 0.01 0.09" mass="0.1"/>',
    ),
}


@pytest.mark.parametrize("name", FRAMES)
def test_position_and_inertia_are_those_of_the_file(name: str, tmp_path: Path) -> None:
    (tmp_path / "scan.obj").write_text(obj(scan(21), normals=5))
    path = tmp_path / "thing.xml"
    assets, geoms = FRAMES[name]
    path.write_text(MJCF.format(assets=assets, geoms=geoms))
    m, model = compiled(path), load_object(path, friction=0.3)
    R = quat_to_matrix(m.body_iquat[1])
    inertia = R @ np.diag(m.body_inertia[1]) @ R.T
    np.testing.assert_allclose(model.mass, m.body_mass[1:], rtol=1e-5)
    np.testing.assert_allclose(model.com, m.body_ipos[1:], atol=1e-6)
    np.testing.assert_allclose(model.inertia[0], inertia, atol=2e-5 * inertia.max())
    corners = []
    for geom in range(1, m.ngeom):
        if m.geom_contype[geom]:
            local = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * m.geom_size[geom]
            if m.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
                mesh = m.mesh(int(m.geom_dataid[geom])).id
                first = m.mesh_vertadr[mesh]
                local = m.mesh_vert[first : first + m.mesh_vertnum[mesh]]
            corners.append(local @ quat_to_matrix(m.geom_quat[geom]).T + m.geom_pos[geom])
    np.testing.assert_allclose(reach(model.corner_pos), reach(np.concatenate(corners)), atol=1e-6)


def test_a_thin_sheet_loads(tmp_path: Path) -> None:
    (tmp_path / "sheet.obj").write_text(obj(divided_box((0.1, 0.06, 0.0001))))
    path = tmp_path / "thing.xml"
    path.write_text(
        MJCF.format(assets='<mesh name="m" file="sheet.obj"/>', geoms='<geom type="mesh" mesh="m" mass="0.01"/>')
    )
    model = load_object(path, friction=0.3)
    np.testing.assert_allclose(np.ptp(model.corner_pos, axis=0), [0.1, 0.06, 0.0001], atol=1e-8)
    expected = 0.01 / 12 * np.array([0.06**2, 0.1**2, 0.1**2 + 0.06**2])
    np.testing.assert_allclose(np.diag(model.inertia[0]), expected, rtol=1e-4)


def test_a_dataset_carries_a_scan_without_its_files(tmp_path: Path) -> None:
    path = written(tmp_path, "scan, normals and texture")
    model = load_object(path, friction=0.3)
    write_dataset(make_dataset(model, tosses=1), tmp_path / "tosses.h5")
    for file in (path, tmp_path / "scan.obj"):
        file.unlink()
    with open_dataset(tmp_path / "tosses.h5") as dataset:
        np.testing.assert_allclose(reach(dataset.object.corner_pos), reach(model.corner_pos), atol=1e-7)


def test_a_mesh_that_changed_is_read_anew(tmp_path: Path) -> None:
    path = written(tmp_path, "divided box")
    load_object(path, friction=0.3)
    mesh = tmp_path / "box.obj"
    mesh.write_text(obj(divided_box((0.2, 0.1, 0.1))))
    os.utime(mesh, (mesh.stat().st_atime, mesh.stat().st_mtime + 2))  # MuJoCo takes a file's version by its seconds
    assert load_object(path, friction=0.3).width == pytest.approx(0.2)


PACKAGES = {
    "beside the file's folder": ("thing/urdf", "thing/meshes/box.stl", None),
    "beside the file": ("src", "src/thing/meshes/box.stl", None),
    "a neighbour of a folder above": ("robots/all/urdf", "robots/thing/meshes/box.stl", None),
    "under another name": ("thing-main/urdf", "thing-main/meshes/box.stl", "thing-main/package.xml"),
}


@pytest.mark.parametrize("where", PACKAGES)
@pytest.mark.parametrize("scheme", ["package", "model"])
def test_a_package_is_found_beside_the_file(where: str, scheme: str, tmp_path: Path) -> None:
    folder, mesh, manifest = PACKAGES[where]
    for each in (tmp_path / folder, (tmp_path / mesh).parent):
        each.mkdir(parents=True, exist_ok=True)
    (tmp_path / mesh).write_text(stl_in_words(divided_box()))
    if manifest is not None:
        (tmp_path / manifest).write_text("<package><name>thing</name></package>")
    model = load_object(urdf(tmp_path / folder, f"{scheme}://thing/meshes/box.stl"), friction=0.3)
    np.testing.assert_allclose(np.ptp(model.corner_pos, axis=0), [0.1, 0.06, 0.08], atol=1e-7)


def test_an_address_of_a_file_and_names_without_folders_are_read(tmp_path: Path) -> None:
    (tmp_path / "a b.obj").write_text(obj(divided_box()))
    assert load_object(urdf(tmp_path, f"file://{tmp_path}/a%20b.obj"), friction=0.3).n_corners == 8
    (tmp_path / "box.obj").write_text(obj(divided_box()))
    path = urdf(tmp_path, "package://elsewhere/box.obj")
    bare = '<robot name="thing"><mujoco><compiler strippath="true"/></mujoco>'
    path.write_text(path.read_text().replace('<robot name="thing">', bare))
    assert load_object(path, friction=0.3).n_corners == 8


def test_a_package_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"thing\.urdf: names 'package://arm/box\.stl', and no folder 'arm' with that"):
        load_object(urdf(tmp_path, "package://arm/box.stl"))
    with pytest.raises(FileError, match=r"thing\.urdf: MuJoCo cannot compile it.*'.*box\.stl'"):
        load_object(urdf(tmp_path, "box.stl"))


# ---------------------------------------------------------------- what MuJoCo does not read


def test_normals_of_some_corners_are_left_aside(tmp_path: Path) -> None:
    vertices, triangles = scan(41, 100)
    file = tmp_path / "scan.obj"
    file.write_text(obj((vertices, triangles[:50]), normals=4) + obj((vertices[:0], triangles[50:])))
    read = read_mesh(file)
    np.testing.assert_allclose(read[0], vertices, atol=1e-8)
    np.testing.assert_array_equal(read[1], triangles)
    # quads, and counts from the end
    file.write_text("v 0 0 0 1 1 1\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 0 0 1\nf -4//1 -3//1 -2//1 -1\nv 0 0 1\nf 1 2 5\n")
    read = read_mesh(file)
    assert read[0].shape == (5, 3)
    np.testing.assert_array_equal(read[1], [[0, 1, 2], [0, 2, 3], [0, 1, 4]])


def test_stl_in_words_and_of_many_faces_is_read_as_binary_is(tmp_path: Path) -> None:
    vertices, triangles = scan(31, 200)
    box, faces = divided_box(parts=10)
    many = np.tile(faces, (200_001 // len(faces) + 1, 1))
    text = stl_in_words((vertices, triangles))
    for content, expected in (
        (text.encode(), vertices[triangles]),
        (text.upper().replace("\n", "\r\n").encode(), vertices[triangles]),
        (stl((box, many)), box[many]),
    ):
        (tmp_path / "a.stl").write_bytes(content)
        read = read_mesh(tmp_path / "a.stl")
        assert len(np.unique(read[0], axis=0)) == len(read[0])  # each vertex once
        np.testing.assert_allclose(read[0][read[1]], expected, atol=1e-8)


BINARY = stl(divided_box())


@pytest.mark.parametrize(
    ("name", "content"),
    [
        *(("a.obj", text.encode()) for text in (obj(divided_box()), obj(scan(1), normals=3), "")),
        ("a.obj", obj(scan(1), normals=3, coordinates=9).encode()),
        # a program may begin its binary files with the word of the others
        *(("a.stl", content) for content in (BINARY, b"solid" + BINARY[5:], BINARY[:-7], b"")),
    ],
)
def test_what_mujoco_reads_is_left_to_it(name: str, content: bytes, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    assert read_mesh(tmp_path / name) is None


OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\n{}\nf 1 2 3\n"


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("a.obj", OBJ.format("f 1 2 9"), r", row 5: a face names vertex \[1, 2, 9\], of 3"),
        ("a.obj", OBJ.format("f 1 x 2"), ", row 5: is no vertex"),
        ("a.obj", OBJ.format("v 1 2"), ", row 5: is no vertex"),
        ("a.stl", "solid a\nfacet\nvertex 0 0 0\nvertex 1 0 0\nendsolid", ": holds 2 vertices, expected three"),
        ("a.stl", "solid a\nendsolid", ": holds 0 vertices"),
        ("a.stl", "solid a\nvertex 0 0 x\nvertex 1 0 0\nvertex 1 1 0\nendsolid", ": .*no three numbers"),
    ],
)
def test_a_damaged_mesh_is_refused(name: str, text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(FileError, match=name + says):
        read_mesh(tmp_path / name)


# ---------------------------------------------------------------- the corners that stand out


@pytest.mark.parametrize("size", [1e-3, 0.1, 50.0])
def test_divided_faces_leave_the_box(size: float) -> None:
    corners = size * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) @ TURNED
    points = (divided_box((2 * size, 2 * size, 2 * size), 9)[0] @ TURNED).astype(np.float32).astype(float)
    assert len(hull_vertices(points)) > 8  # single precision bends the faces
    found = outline(points)
    assert len(found) == 8
    assert np.linalg.norm(found[:, None] - corners[None], axis=-1).min(axis=0).max() < 1e-6 * size


def test_a_cylinder_keeps_its_rims() -> None:
    angle = np.arange(48) * np.pi / 24
    rings = [np.column_stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), z + 0 * angle]) for z in (-0.04, 0.01, 0.04)]
    assert len(outline(np.concatenate(rings))) == 96


def test_of_a_ball_the_farthest_of_many_vertices_stay() -> None:
    ball = 0.05 * directions(20_000)
    found = outline(ball)
    assert len(found) <= 2000
    lower = reach(ball) - reach(found)
    assert lower.min() >= -1e-12
    assert lower.max() < 1e-3 * 0.1


def test_what_spans_no_volume_is_refused() -> None:
    flat = np.random.default_rng(0).normal(size=(30, 3)) * [1, 1, 0]
    for points in (flat, flat[:3], flat[:1]):
        with pytest.raises(ObjectError, match="span no volume"):
            outline(points)
