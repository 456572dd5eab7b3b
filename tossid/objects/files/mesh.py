"""Meshes that MuJoCo does not read: OBJ with normals of some corners alone, STL in words, and STL of many faces."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tossid.errors import FileError

Mesh = tuple[NDArray[np.float32], NDArray[np.int32]]
"""Vertices (n, 3) and faces (m, 3)."""
_NORMAL = re.compile(rb"^\s*vn\s", re.MULTILINE)
_FACE = re.compile(rb"^\s*f\s+(.+)$", re.MULTILINE)
_VERTEX = re.compile(rb"^\s*vertex\s+(\S+)\s+(\S+)\s+(\S+)", re.MULTILINE | re.IGNORECASE)
_STL_HEAD, _STL_FACE = 84, 50
"""Bytes before the faces of a binary STL file, and of each face."""
_MUJOCOS = 200_000
"""Faces up to which MuJoCo reads a binary STL file."""


def read_mesh(path: Path) -> Mesh | None:
    """The triangles of a mesh's file, if MuJoCo does not read it.

    Args:
        path: The file; its suffix says what it is.

    Returns:
        None where MuJoCo reads the file, or says why it does not.

    Raises:
        FileError: It holds a line that is no vertex or face, a face without its vertices, or no whole triangles.
    """
    reader = {".obj": _read_obj, ".stl": _read_stl}.get(path.suffix.lower())
    return None if reader is None else reader(path, path.read_bytes())


def _read_obj(path: Path, content: bytes) -> Mesh | None:
    """An OBJ file without its normals, where some corner of a face has none, or one that is not there."""
    count = len(_NORMAL.findall(content))
    corners = b" ".join(_FACE.findall(content)).split()
    if not count or all(_has_normal(corner, count) for corner in corners):
        return None
    vertices, faces = list[list[float]](), list[tuple[int, int, int]]()
    for number, line in enumerate(content.decode("utf-8", "replace").splitlines(), start=1):
        kind, *words = line.split() or [""]
        try:
            if kind == "v":
                x, y, z = words[:3]
                vertices.append([float(x), float(y), float(z)])
            elif kind == "f":
                named = [int(word.split("/")[0]) for word in words]
                of = [k - 1 if k > 0 else len(vertices) + k for k in named]
                if min(of) < 0 or max(of) >= len(vertices):
                    raise FileError(path, f"a face names vertex {named}, of {len(vertices)}", row=number)
                faces += [(of[0], of[k], of[k + 1]) for k in range(1, len(of) - 1)]
        except ValueError as error:
            raise FileError(path, f"is no vertex or face: {error}", row=number) from error
    return np.array(vertices, dtype=np.float32).reshape(-1, 3), np.array(faces, dtype=np.int32).reshape(-1, 3)


def _has_normal(corner: bytes, count: int) -> bool:
    """Whether a face's corner names a normal that is there."""
    parts = corner.split(b"/")
    try:
        return len(parts) == 3 and 0 < abs(int(parts[2])) <= count
    except ValueError:
        return False


def _read_stl(path: Path, content: bytes) -> Mesh | None:
    """An STL file in words, or a binary one of more faces than MuJoCo takes; each vertex once."""
    count = int.from_bytes(content[80:_STL_HEAD], "little")
    if len(content) == _STL_HEAD + _STL_FACE * count:
        if count <= _MUJOCOS:
            return None
        rows = np.frombuffer(content, np.uint8, offset=_STL_HEAD).reshape(count, _STL_FACE)
        corners = np.ascontiguousarray(rows[:, 12:48]).view("<f4").reshape(-1, 3)
    elif content.lstrip()[:5].lower() == b"solid":
        try:
            corners = np.array(_VERTEX.findall(content), dtype="S32").astype(np.float32).reshape(-1, 3)
        except ValueError as error:
            raise FileError(path, f"holds a vertex that is no three numbers: {error}") from error
        if not len(corners) or len(corners) % 3:
            raise FileError(path, f"holds {len(corners)} vertices, expected three for each triangle")
    else:
        return None
    vertices, faces = np.unique(corners, axis=0, return_inverse=True)
    return vertices, faces.reshape(-1, 3).astype(np.int32)
