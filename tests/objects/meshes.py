"""Meshes as CAD programs and scanners leave them, and files of them."""

from __future__ import annotations

import struct
from collections.abc import Callable
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
    vertices, triangles = list[NDArray[np.float64]](), list[tuple[int, ...]]()
    at = np.linspace(-0.5, 0.5, parts + 1)
    for axis in range(3):
        for side in (-0.5, 0.5):
            first = len(vertices)
            for u in at:
                for v in at:
                    point = np.zeros(3)
                    point[axis], point[axis - 2], point[axis - 1] = side, u, v
                    vertices.append(point * edges)
            for i in range(parts):
                for j in range(parts):
                    a = first + i * (parts + 1) + j
                    two = [(a, a + parts + 1, a + parts + 2), (a, a + parts + 2, a + 1)]
                    triangles += two if side > 0 else [t[::-1] for t in two]
    return np.array(vertices), np.array(triangles)


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


def _decomposed(folder: Path) -> tuple[Path, NDArray[np.float64]]:
    parts = [scan(seed, 60) for seed in range(5)]
    moved = [(vertices + 0.04 * k * np.array([1, 0.5, 0]), faces) for k, (vertices, faces) in enumerate(parts)]
    for k, part in enumerate(moved):
        (folder / f"part_{k}.obj").write_text(obj(part, normals=7))
    return urdf(folder, *(f"part_{k}.obj" for k in range(5))), np.concatenate([vertices for vertices, _ in moved])


def _several_in_one_file(folder: Path) -> tuple[Path, NDArray[np.float64]]:
    first, second = scan(3, 90), divided_box()
    away = (second[0] + [0.09, 0, 0], second[1])
    text = "o one\n" + obj(first) + "o two\nusemtl paint\n" + obj(away, first=len(first[0]))
    (folder / "both.obj").write_text(text)
    return urdf(folder, "both.obj"), np.concatenate([first[0], away[0]])


def _one(name: str, made: Callable[[], tuple[Mesh, str | bytes]]) -> Callable[[Path], tuple[Path, NDArray[np.float64]]]:
    def make(folder: Path) -> tuple[Path, NDArray[np.float64]]:
        mesh, content = made()
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        return urdf(folder, name), mesh[0]

    return make


def _with(mesh: Mesh, **how: int) -> tuple[Mesh, str]:
    return mesh, obj(mesh, **how)


def _open() -> tuple[Mesh, str]:
    vertices, triangles = scan(5)
    return (vertices, triangles), obj((vertices, triangles[: len(triangles) // 2]), normals=len(vertices))


def _repeated() -> tuple[Mesh, str]:
    vertices, triangles = scan(6)
    none = [[4, 4, 9], [2, 2, 2]]
    twice = (np.concatenate([vertices, vertices]), np.concatenate([triangles, triangles + len(vertices), none]))
    return (vertices, triangles), obj(twice)


def _normals_of_some() -> tuple[Mesh, str]:
    mesh = scan(14)
    half = len(mesh[1]) // 2
    return mesh, obj((mesh[0], mesh[1][:half]), normals=9) + obj((mesh[0][:0], mesh[1][half:]))


def _normals_cut_off() -> tuple[Mesh, str]:
    mesh = scan(15)
    lines = obj(mesh, normals=400).splitlines()
    return mesh, "\n".join(line for k, line in enumerate(lines) if not (line.startswith("vn") and k % 2))


def _turned_over() -> tuple[Mesh, str]:
    vertices, triangles = scan(7)
    triangles[::3] = triangles[::3, ::-1]
    return (vertices, triangles), obj((vertices, triangles))


KINDS: dict[str, Callable[[Path], tuple[Path, NDArray[np.float64]]]] = {
    "divided box": _one("box.obj", lambda: _with(divided_box())),
    "divided box, turned": _one("box.obj", lambda: _with((divided_box()[0] @ TURNED.T, divided_box()[1]))),
    "divided box, binary STL": _one("box.stl", lambda: (divided_box(), stl(divided_box()))),
    "divided box, STL in words": _one("box.STL", lambda: (divided_box(), stl_in_words(divided_box()))),
    "scan": _one("scan.obj", lambda: _with(scan(0))),
    "scan, a normal a vertex": _one("scan.obj", lambda: _with(scan(1), normals=400)),
    "scan, normals and texture": _one("scan.obj", lambda: _with(scan(2), normals=400, coordinates=400)),
    "scan, six normals": _one("scan.obj", lambda: _with(scan(3), normals=6)),
    "scan, more normals than vertices": _one("scan.obj", lambda: _with(scan(4), normals=900, coordinates=3)),
    "scan, normals of some triangles": _one("scan.obj", _normals_of_some),
    "scan, normals cut off": _one("scan.obj", _normals_cut_off),
    "scan, open": _one("scan.obj", _open),
    "scan, vertices twice and triangles of no area": _one("scan.obj", _repeated),
    "scan, some triangles turned over": _one("scan.obj", _turned_over),
    "scan, binary STL": _one("scan.stl", lambda: (scan(8, 3000), stl(scan(8, 3000)))),
    "scan, STL in words": _one("scan.stl", lambda: (scan(9), stl_in_words(scan(9)))),
    "decomposed": _decomposed,
    "several in one file": _several_in_one_file,
}
"""By name, what leaves a URDF in a folder: its path, and all its meshes' vertices in the link's frame."""
