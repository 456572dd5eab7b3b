"""Meshes in STL that MuJoCo does not read: those written in words, and those of many faces."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tossid.errors import FileError

_HEAD, _FACE = 84, 50
"""Bytes before the faces of a binary file, and of each face."""
_MUJOCOS = 200_000
"""Faces up to which MuJoCo reads a binary file."""
_VERTEX = re.compile(rb"^\s*vertex\s+(\S+)\s+(\S+)\s+(\S+)", re.MULTILINE | re.IGNORECASE)


def read_stl(path: Path) -> tuple[NDArray[np.float32], NDArray[np.int32]] | None:
    """The triangles of an STL file, if MuJoCo does not read it itself.

    Args:
        path: The file.

    Returns:
        Vertices (n, 3), each once, and faces (m, 3); None where MuJoCo reads the file, or says why it does not.

    Raises:
        FileError: A file in words holds a vertex that is no three numbers, or no whole triangles.
    """
    content = path.read_bytes()
    count = int.from_bytes(content[80:_HEAD], "little")
    if len(content) == _HEAD + _FACE * count:
        if count <= _MUJOCOS:
            return None
        rows = np.frombuffer(content, np.uint8, offset=_HEAD).reshape(count, _FACE)
        corners = np.ascontiguousarray(rows[:, 12:48]).view("<f4").reshape(-1, 3)
    elif content.lstrip()[:5].lower() == b"solid":
        words = _VERTEX.findall(content)
        try:
            corners = np.array(words, dtype="S32").astype(np.float32).reshape(-1, 3)
        except ValueError as error:
            raise FileError(path, f"holds a vertex that is no three numbers: {error}") from error
        if not len(corners) or len(corners) % 3:
            raise FileError(path, f"holds {len(corners)} vertices, expected three for each triangle")
    else:
        return None
    vertices, faces = np.unique(corners, axis=0, return_inverse=True)
    return vertices, faces.reshape(-1, 3).astype(np.int32)
