"""dair_pll's tensors: columns, joints, and every published toss."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.store.folders import save
from tests.store.makers import pll_rows
from tossid.errors import FileError, InputError
from tossid.rotations import quat_boxminus
from tossid.store import read_pll


def test_pll_columns_and_joint(elbow_folder: Path) -> None:
    for track in read_pll(elbow_folder, n_joints=1):
        assert track.v is not None
        np.testing.assert_allclose(np.diff(track.q[:, :3], axis=0) * 148, track.v[1:, :3], atol=1e-9)
        turned = quat_boxminus(track.q[1:, 3:7], track.q[:-1, 3:7]) * 148
        np.testing.assert_allclose(turned, track.v[1:, 3:6], atol=1e-9)
        np.testing.assert_allclose(np.diff(track.q[:, 7]) * 148, track.v[1:, 6], atol=1e-9)


def test_joint_angles_are_unwrapped(tmp_path: Path) -> None:
    rows = pll_rows(30, np.random.default_rng(0))
    angle = 3.0 + 0.05 * np.arange(30)
    rows[:, 7], rows[:, 14] = (angle + np.pi) % (2 * np.pi) - np.pi, 0.05 * 148
    save(tmp_path / "0.pt", rows)
    np.testing.assert_allclose(read_pll(tmp_path, n_joints=1)[0].q[:, 7], angle)


def test_every_published_elbow_toss_imports(shared_data: Path) -> None:
    folder = shared_data / "pll_elbow"
    tracks = read_pll(folder, n_joints=1)
    assert len(tracks) == len(list(folder.glob("*.pt")))
    assert {track.q.shape for track in tracks} == {(121, 8)}
    assert max(np.abs(np.diff(track.q[:, 7])).max() for track in tracks) < np.pi


def test_other_joints_than_the_object_has(elbow_folder: Path) -> None:
    with pytest.raises(FileError, match="expected 13 for an object of 0 joints"):
        read_pll(elbow_folder, n_joints=0)
    with pytest.raises(InputError, match="the object has 2"):
        read_pll(elbow_folder, n_joints=2)
