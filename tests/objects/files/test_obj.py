"""OBJ whose normals are not those of all corners is read without them, and other OBJ is left to MuJoCo."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.objects.meshes import divided_box, obj, scan
from tossid.errors import FileError
from tossid.objects.files.obj import read_obj


def test_normals_of_some_corners_are_left_aside(tmp_path: Path) -> None:
    vertices, triangles = scan(41, 100)
    file = tmp_path / "scan.obj"
    file.write_text(obj((vertices, triangles[:50]), normals=4) + obj((vertices[:0], triangles[50:])))
    read = read_obj(file)
    assert read is not None
    np.testing.assert_allclose(read[0], vertices, atol=1e-8)
    np.testing.assert_array_equal(read[1], triangles)


def test_quads_and_counts_from_the_end_are_read(tmp_path: Path) -> None:
    file = tmp_path / "quad.obj"
    file.write_text("v 0 0 0 1 1 1\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 0 0 1\nf -4//1 -3//1 -2//1 -1\nv 0 0 1\nf 1 2 5\n")
    read = read_obj(file)
    assert read is not None
    assert read[0].shape == (5, 3)
    np.testing.assert_array_equal(read[1], [[0, 1, 2], [0, 2, 3], [0, 1, 4]])


def test_what_mujoco_reads_is_left_to_it(tmp_path: Path) -> None:
    for text in (obj(divided_box()), obj(scan(1), normals=3), obj(scan(1), normals=3, coordinates=9), ""):
        (tmp_path / "a.obj").write_text(text)
        assert read_obj(tmp_path / "a.obj") is None


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("f 1 2 9", r"row 5: a face names vertex \[1, 2, 9\], of 3"),
        ("f 1 x 2", "row 5: is no vertex"),
        ("v 1 2", "row 5: is no vertex"),
    ],
)
def test_a_damaged_file_is_refused_with_its_line(line: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\n{line}\nf 1 2 3\n")
    with pytest.raises(FileError, match=rf"a\.obj, {says}"):
        read_obj(tmp_path / "a.obj")
