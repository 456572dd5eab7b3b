"""TagSLAM's poses as its files have them, and how far ours are from them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments.vision.against_tagslam import _apart, _reference_poses, main, markdown
from tossid.errors import FileError
from tossid.rotations import quat_exp, transform


def test_poses_are_read_by_body(tmp_path: Path) -> None:
    (tmp_path / "reference_poses.csv").write_text(
        "body,t_ns,x,y,z,qx,qy,qz,qw\nwand,1000000000,1,2,3,0,0,0,1\nrig,0,0,0,0,0,0,1,0\nwand,2000000000,1,2,4,0,0,0,1\n"
    )
    found = _reference_poses(tmp_path)
    t, T = found["wand"]
    np.testing.assert_array_equal(t, [1.0, 2.0])
    np.testing.assert_array_equal(T[1], transform(np.array([1.0, 2, 4]), np.array([1.0, 0, 0, 0])))
    np.testing.assert_allclose(np.diag(found["rig"][1][0]), [-1, -1, 1, 1])  # half a turn about z: xyzw, not wxyz


def test_distances_are_millimetres_and_degrees() -> None:
    one = transform(np.zeros(3), np.array([1.0, 0, 0, 0]))
    other = transform(np.array([0.0, 3e-3, 4e-3]), quat_exp([0.0, np.pi / 6, 0.0]))
    far, turn = _apart(one[None], other[None])
    assert (far[0], turn[0]) == (pytest.approx(5.0), pytest.approx(30.0))


def test_a_table_and_a_folder_without_recordings(tmp_path: Path) -> None:
    assert markdown(("a", "b"), [["1", "2"]]) == "| a | b |\n| --- | --- |\n| 1 | 2 |"
    with pytest.raises(FileError, match="has no folder tagslam_test/test_N"):
        main(tmp_path)
