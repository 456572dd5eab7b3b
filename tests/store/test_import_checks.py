"""What is wrong in a file is one error that names file and row; nothing in a tensor file is run."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.store.folders import save, scaled
from tests.store.makers import HALF, pll_rows
from tossid.errors import FileError
from tossid.rotations import wxyz_to_xyzw
from tossid.store import read_contactnets, read_pll, read_tum


def test_quaternions_slightly_off_are_normalised(elbow_folder: Path) -> None:
    rows = torch.load(elbow_folder / "0.pt", weights_only=True).numpy()
    rows[:, :4] *= 1.0008
    save(elbow_folder / "0.pt", rows)
    track = read_pll(elbow_folder, n_joints=1)[0]
    np.testing.assert_allclose(np.linalg.norm(track.q[:, 3:7], axis=1), 1.0, atol=1e-15)


class Bomb:
    """A pickle that would run a command."""

    def __init__(self, witness: Path) -> None:
        self.witness = witness

    def __reduce__(self) -> tuple[Callable[[str], int], tuple[str]]:
        return os.system, (f"touch {self.witness}",)


def test_code_in_a_pickle_is_not_run(cube_folder: Path, tmp_path: Path) -> None:
    witness = tmp_path / "ran"
    with open(cube_folder / "3.pt", "wb") as stream:
        pickle.dump(Bomb(witness), stream)
    with pytest.raises(FileError, match=r"3\.pt") as caught:
        read_contactnets(cube_folder)
    assert "\n" not in str(caught.value)
    torch.save(Bomb(witness), cube_folder / "3.pt")
    with pytest.raises(FileError, match=r"3\.pt: holds Python objects or code"):
        read_contactnets(cube_folder)
    assert not witness.exists()


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04 not a zip", bytes(1000)])
def test_what_is_no_tensor_is_refused(cube_folder: Path, content: bytes) -> None:
    (cube_folder / "3.pt").write_bytes(content)
    with pytest.raises(FileError, match=r"3\.pt"):
        read_contactnets(cube_folder)


def test_a_truncated_tensor_is_refused(cube_folder: Path) -> None:
    whole = (cube_folder / "2.pt").read_bytes()
    for share in (0.1, 0.5, 0.9, 0.99):
        (cube_folder / "2.pt").write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(FileError, match=r"2\.pt"):
            read_contactnets(cube_folder)


@pytest.mark.parametrize(
    "content",
    [
        {"a": torch.zeros(3, 19)},
        torch.zeros(20, 18),
        torch.zeros(2, 20, 19),
        torch.zeros(1, 19),
        torch.zeros(20, 19, dtype=torch.int64),
        torch.zeros(20, 19, dtype=torch.complex64),
        torch.zeros(20, 19).to_sparse(),
    ],
    ids=["a dict", "18 columns", "two tosses", "one row", "integers", "complex", "sparse"],
)
def test_another_tensor_is_refused(cube_folder: Path, content: object) -> None:
    torch.save(content, cube_folder / "3.pt")
    with pytest.raises(FileError, match=r"3\.pt.*expected"):
        read_contactnets(cube_folder)


@pytest.mark.parametrize(
    ("row", "column", "value", "says"),
    [
        (7, 0, np.nan, "finite"),
        (7, 12, np.inf, "finite"),
        (3, 4, 2.0, "norm"),
        (5, 0, 1e4, "position"),
        (5, 8, 2e3, "speed"),
        (9, 11, 1e3, "angular velocity"),
    ],
)
def test_a_bad_row_is_named(cube_folder: Path, row: int, column: int, value: float, says: str) -> None:
    rows = torch.load(cube_folder / "2.pt", weights_only=True).numpy()
    rows[0, row, column] = value
    save(cube_folder / "2.pt", rows)
    with pytest.raises(FileError, match=says) as caught:
        read_contactnets(cube_folder)
    assert caught.value.path.name == "2.pt"
    assert caught.value.row == row


def test_velocities_in_other_units_are_noticed(cube_folder: Path) -> None:
    scaled(cube_folder, slice(7, 10), HALF)
    with pytest.raises(FileError, match="velocities disagree"):
        read_contactnets(cube_folder)


def test_a_wrong_rate_is_noticed(elbow_folder: Path) -> None:
    with pytest.raises(FileError, match="disagree"):
        read_pll(elbow_folder, n_joints=1, rate_hz=30.0)


def test_another_quaternion_order_is_noticed(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for k in range(3):
        rows = pll_rows(40, rng)
        rows[:, :4] = wxyz_to_xyzw(rows[:, :4])
        save(tmp_path / f"{k}.pt", rows)
    with pytest.raises(FileError, match="quaternion order\\? they look like qx qy qz qw: read so, they agree"):
        read_pll(tmp_path, n_joints=1)


@pytest.mark.parametrize(
    "read",
    [read_contactnets, lambda folder: read_pll(folder, n_joints=1), lambda folder: read_tum(folder, n_joints=0)],
)
def test_empty_and_missing_folders(tmp_path: Path, read: Callable[[Path], object]) -> None:
    with pytest.raises(FileError, match="holds no"):
        read(tmp_path)
    with pytest.raises(FileError, match="no such folder"):
        read(tmp_path / "nowhere")
