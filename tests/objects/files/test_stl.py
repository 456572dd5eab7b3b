"""STL in words and of many faces is read as the same triangles in binary are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.objects.meshes import divided_box, scan, stl, stl_in_words
from tossid.errors import FileError
from tossid.objects.files.stl import read_stl


def test_words_hold_the_same_triangles(tmp_path: Path) -> None:
    vertices, triangles = scan(31, 200)
    file = tmp_path / "scan.stl"
    text = stl_in_words((vertices, triangles))
    for each in (text, text.upper().replace("\n", "\r\n")):
        file.write_text(each)
        read = read_stl(file)
        assert read is not None
        found, faces = read
        assert len(found) == len(vertices)  # each vertex once
        np.testing.assert_allclose(found[faces], vertices[triangles], atol=1e-8)


def test_more_faces_than_mujoco_takes_are_read(tmp_path: Path) -> None:
    vertices, triangles = divided_box(parts=10)
    many = np.tile(triangles, (200_001 // len(triangles) + 1, 1))
    (tmp_path / "many.stl").write_bytes(stl((vertices, many)))
    read = read_stl(tmp_path / "many.stl")
    assert read is not None
    np.testing.assert_allclose(read[0][read[1]], vertices[many], atol=1e-8)


def test_what_mujoco_reads_is_left_to_it(tmp_path: Path) -> None:
    content = stl(divided_box())
    # a program may begin its binary files with the word of the others
    for name, each in (("box", content), ("solid", b"solid" + content[5:]), ("cut", content[:-7]), ("empty", b"")):
        (tmp_path / f"{name}.stl").write_bytes(each)
        assert read_stl(tmp_path / f"{name}.stl") is None


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("solid a\nfacet\nvertex 0 0 0\nvertex 1 0 0\nendsolid", "holds 2 vertices, expected three"),
        ("solid a\nendsolid", "holds 0 vertices"),
        ("solid a\nvertex 0 0 x\nvertex 1 0 0\nvertex 1 1 0\nendsolid", "no three numbers"),
    ],
)
def test_words_that_are_no_triangles_are_refused(text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "bad.stl").write_text(text)
    with pytest.raises(FileError, match=rf"bad\.stl: .*{says}"):
        read_stl(tmp_path / "bad.stl")
