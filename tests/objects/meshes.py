"""Meshes as CAD programs and scanners leave them, and files of them."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]
"""Vertices (n, 3) [m] and triangles (m, 3), their normals outward."""

TURNED: NDArray[np.float64] = np.linalg.qr(np.random.default_rng(12).normal(size=(3, 3)))[0]
"""A rotation in no particular direction."""
URDF = """<robot name="thing"><link name="body">
  <inertial><origin xyz="0.001 0 0"/><mass value="0.37"/>
    <inertia ixx="0.00081" ixy="0" ixz="0" iyy="0.00081" iyz="0" izz="0.00081"/></inertial>
  {}
</link></robot>"""
COLLISION = '<collision><geometry><mesh filename="{}"/></geometry></collision>'
MJCF = """<mujoco model="thing"><asset>{assets}</asset><worldbody>
  <geom name="floor" type="plane" size="1 1 .1" friction="0.2"/>
  <body name="body"><freejoint/>{geoms}</body></worldbody></mujoco>"""


def divided_box(edges: tuple[float, float, float] = (0.1, 0.06, 0.08), parts: int = 4) -> Mesh:
    """A box whose faces are divided: each face has vertices of its own, most of them on no corner."""
    at = np.linspace(-0.5, 0.5, parts + 1)
    u, v = (each.ravel() for each in np.meshgrid(at, at, indexing="ij"))
    a = np.arange(len(u)).reshape(parts + 1, parts + 1)[:-1, :-1].reshape(-1, 1)
    upward = np.concatenate([a + np.array(each) for each in ((0, parts + 1, parts + 2), (0, parts + 2, 1))])
    vertices, triangles = [], []
    for axis in range(3):
        for side in (-0.5, 0.5):
            face = np.roll(np.column_stack([np.full_like(u, side), u, v]), axis, axis=1)
            triangles.append(len(u) * len(vertices) + (upward if side > 0 else upward[:, ::-1]))
            vertices.append(face * edges)
    return np.concatenate(vertices), np.concatenate(triangles)


def scan(seed: int, count: int = 400, *, rough: float = 0.1) -> Mesh:
    """A closed, dented surface with noise, most of whose vertices lie inside its hull."""
    rng = np.random.default_rng(seed)
    ways = rng.normal(size=(count, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    triangles = ConvexHull(ways).simplices.astype(np.int64)
    a, b, c = (ways[triangles[:, k]] for k in range(3))
    inward = np.einsum("ni,ni->n", np.cross(b - a, c - a), a) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return ways * (0.05 * (1 + rough * rng.normal(size=(count, 1)))) * [1.0, 0.8, 1.2], triangles


def obj(mesh: Mesh, *, normals: int = 0, coordinates: int = 0, first: int = 0) -> str:
    """OBJ. With normals or texture coordinates, corners name these in turn, whatever the number of the vertices."""
    vertices, triangles = mesh
    lines = ["v " + " ".join(f"{x:.9f}" for x in vertex) for vertex in vertices]
    lines += [f"vt {k / coordinates:.3f} 0.5" for k in range(coordinates)]
    lines += [f"vn {np.cos(k):.4f} {np.sin(k):.4f} 0" for k in range(normals)]
    for triangle in triangles:
        words = []
        for k in triangle:
            texture = f"{k % coordinates + 1}" if coordinates else ""
            normal = f"/{k % normals + 1}" if normals else ""
            words.append(f"{k + 1 + first}" + (f"/{texture}{normal}" if texture or normal else ""))
        lines.append("f " + " ".join(words))
    return "\n".join(lines) + "\n"


def stl(mesh: Mesh) -> bytes:
    """Binary STL."""
    vertices, triangles = mesh
    rows = np.zeros((len(triangles), 50), np.uint8)
    rows[:, 12:48] = vertices[triangles].astype("<f4").reshape(-1, 9).view(np.uint8)
    return b"made by a scanner".ljust(80) + struct.pack("<I", len(triangles)) + rows.tobytes()


def stl_in_words(mesh: Mesh) -> str:
    """ASCII STL."""
    vertices, triangles = mesh
    lines = ["solid thing"]
    for triangle in triangles:
        lines += ["  facet normal 0 0 0", "    outer loop"]
        lines += ["      vertex " + " ".join(f"{x:.8e}" for x in vertices[k]) for k in triangle]
        lines += ["    endloop", "  endfacet"]
    return "\n".join([*lines, "endsolid thing"]) + "\n"


def urdf(folder: Path, *files: str) -> Path:
    """A URDF of one link whose collision geometry these mesh files are."""
    path = folder / "thing.urdf"
    path.write_text(URDF.format("".join(COLLISION.format(file) for file in files)))
    return path


def _kinds() -> Iterator[tuple[str, dict[str, str | bytes], NDArray[np.float64]]]:
    box = divided_box()
    yield "divided box", {"box.obj": obj(box)}, box[0]
    yield "divided box, binary STL", {"box.stl": stl(box)}, box[0]
    yield "divided box, STL in words", {"box.STL": stl_in_words(box)}, box[0]
    mesh = vertices, triangles = scan(5)
    half, n = len(triangles) // 2, len(vertices)
    yield "scan", {"scan.obj": obj(mesh)}, vertices
    yield "scan, a normal a vertex", {"scan.obj": obj(mesh, normals=n)}, vertices
    yield "scan, normals and texture", {"scan.obj": obj(mesh, normals=n, coordinates=n)}, vertices
    some = obj((vertices, triangles[:half]), normals=9) + obj((vertices[:0], triangles[half:]))
    yield "scan, normals of some triangles", {"scan.obj": some}, vertices
    yield "scan, open", {"scan.obj": obj((vertices, triangles[:half]), normals=n)}, vertices
    faces = np.concatenate([triangles, triangles + n, [[4, 4, 9], [2, 2, 2]]])
    twice = obj((np.concatenate([vertices, vertices]), faces))
    yield "scan, vertices twice and triangles of no area", {"scan.obj": twice}, vertices
    turned = triangles.copy()
    turned[::3] = turned[::3, ::-1]
    yield "scan, some triangles turned over", {"scan.obj": obj((vertices, turned))}, vertices
    many = scan(8, 3000)
    yield "scan, binary STL", {"scan.stl": stl(many)}, many[0]
    away = [0.04 * k * np.array([1, 0.5, 0]) for k in range(5)]
    parts = [(points + off, faces) for off, (points, faces) in zip(away, (scan(k, 60) for k in range(5)), strict=True)]
    files = {f"part_{k}.obj": obj(part, normals=7) for k, part in enumerate(parts)}
    yield "decomposed", files, np.concatenate([points for points, _ in parts])
    beside = (box[0] + [0.09, 0, 0], box[1])
    both = "o one\n" + obj(mesh) + "o two\nusemtl paint\n" + obj(beside, first=n)
    yield "several in one file", {"both.obj": both}, np.concatenate([vertices, beside[0]])


KINDS = {name: (files, vertices) for name, files, vertices in _kinds()}
"""By name, files of meshes and all their vertices in the link's frame."""


def written(folder: Path, kind: str) -> Path:
    """A URDF beside the files of a kind of meshes."""
    files, _ = KINDS[kind]
    for name, content in files.items():
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return urdf(folder, *files)
