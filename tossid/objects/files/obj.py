"""Meshes in OBJ that MuJoCo does not read: those of which some corners have no normal, or one that is not there."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tossid.errors import FileError

_NORMAL = re.compile(rb"^\s*vn\s", re.MULTILINE)
_FACE = re.compile(rb"^\s*f\s+(.+)$", re.MULTILINE)


def read_obj(path: Path) -> tuple[NDArray[np.float32], NDArray[np.int32]] | None:
    """The triangles of an OBJ file without its normals, if MuJoCo does not read these.

    Args:
        path: The file.

    Returns:
        Vertices (n, 3) and faces (m, 3); None where MuJoCo reads the file, or says why it does not.

    Raises:
        FileError: It holds a line that is no vertex or face, or a face without its vertices.
    """
    content = path.read_bytes()
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
