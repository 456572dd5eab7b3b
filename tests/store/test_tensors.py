"""Published tensors: columns, units and joints; what is wrong names file and row, and nothing in a file is run."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.store.makers import HALF, pll_rows, save, scaled
from tossid.errors import FileError, InputError
from tossid.rotations import quat_boxminus, wxyz_to_xyzw
from tossid.store import read_contactnets, read_pll, read_tum


def test_contactnets_columns_and_units(cube_folder: Path) -> None:
    tracks = read_contactnets(cube_folder)
    assert [track.name for track in tracks] == ["1", "2", "10"]
    for track in tracks:
        rows = torch.load(cube_folder / f"{track.name}.pt", weights_only=True).reshape(-1, 19).numpy()
        np.testing.assert_allclose(track.q, np.concatenate([rows[:, :3] * HALF, rows[:, 3:7]], axis=1))
        np.testing.assert_allclose(track.v, np.concatenate([rows[:, 7:10] * HALF, rows[:, 10:13]], axis=1))
        np.testing.assert_allclose(np.diff(track.t), 1 / 148)
        # the velocities are those of the poses
        np.testing.assert_allclose(np.diff(track.q[:, :3], axis=0) * 148, track.v[1:, :3], atol=1e-9)


def test_pll_columns_and_joint(elbow_folder: Path, tmp_path: Path) -> None:
    for track in read_pll(elbow_folder, n_joints=1):
        np.testing.assert_allclose(np.diff(track.q[:, :3], axis=0) * 148, track.v[1:, :3], atol=1e-9)
        turned = quat_boxminus(track.q[1:, 3:7], track.q[:-1, 3:7]) * 148
        np.testing.assert_allclose(turned, track.v[1:, 3:6], atol=1e-9)
        np.testing.assert_allclose(np.diff(track.q[:, 7]) * 148, track.v[1:, 6], atol=1e-9)
    rows = pll_rows(30, np.random.default_rng(0))
    angle = 3.0 + 0.05 * np.arange(30)
    rows[:, 7], rows[:, 14] = (angle + np.pi) % (2 * np.pi) - np.pi, 0.05 * 148
    save(tmp_path / "0.pt", rows)
    np.testing.assert_allclose(read_pll(tmp_path, n_joints=1)[0].q[:, 7], angle)  # unwrapped


def test_every_published_toss_imports(shared_data: Path) -> None:
    cubes = read_contactnets(shared_data / "contactnets_cube")
    assert len(cubes) == len(list((shared_data / "contactnets_cube").glob("*.pt")))
    assert max(len(track.t) for track in cubes) == 442
    assert [int(track.name) for track in cubes] == sorted(int(track.name) for track in cubes)
    # what the format says of them: at rest on a face, about half a width above the ground
    assert np.median([track.q[-1, 2] for track in cubes]) == pytest.approx(HALF, abs=0.002)
    elbows = read_pll(shared_data / "pll_elbow", n_joints=1)
    assert len(elbows) == len(list((shared_data / "pll_elbow").glob("*.pt")))
    assert {track.q.shape for track in elbows} == {(121, 8)}
    assert max(np.abs(np.diff(track.q[:, 7])).max() for track in elbows) < np.pi


@pytest.mark.parametrize(
    ("read", "says"),
    [
        (lambda cube, elbow: read_contactnets(cube, rate_hz=float("nan")), "rate"),
        (lambda cube, elbow: read_contactnets(cube, half_width=0.0), "half width"),
        (lambda cube, elbow: read_pll(elbow, n_joints=0), "expected 13 for an object of 0 joints"),
        (lambda cube, elbow: read_pll(elbow, n_joints=2), "the object has 2"),
        (lambda cube, elbow: read_pll(elbow, n_joints=1, rate_hz=30.0), "disagree"),
    ],
)
def test_what_the_caller_states_wrongly_is_refused(
    cube_folder: Path, elbow_folder: Path, read: Callable[[Path, Path], object], says: str
) -> None:
    with pytest.raises(InputError, match=says):
        read(cube_folder, elbow_folder)


def test_other_units_and_orders_are_noticed(cube_folder: Path, tmp_path: Path) -> None:
    scaled(cube_folder, slice(7, 10), HALF)
    with pytest.raises(FileError, match="velocities disagree"):
        read_contactnets(cube_folder)
    scaled(cube_folder, slice(0, 3), HALF)
    with pytest.raises(FileError, match="half widths"):
        read_contactnets(cube_folder)
    rng = np.random.default_rng(0)
    for k in range(3):
        rows = pll_rows(40, rng)
        rows[:, :4] = wxyz_to_xyzw(rows[:, :4])
        save(tmp_path / f"{k}.pt", rows)
    with pytest.raises(FileError, match="quaternion order\\? they look like qx qy qz qw: read so, they agree"):
        read_pll(tmp_path, n_joints=1)


class Bomb:
    """A pickle that would run a command."""

    def __init__(self, witness: Path) -> None:
        self.witness = witness

    def __reduce__(self) -> tuple[Callable[[str], int], tuple[str]]:
        return os.system, (f"touch {self.witness}",)


def test_code_in_a_pickle_is_not_run(cube_folder: Path, tmp_path: Path) -> None:
    witness = tmp_path / "ran"
    (cube_folder / "3.pt").write_bytes(pickle.dumps(Bomb(witness)))
    with pytest.raises(FileError, match=r"3\.pt") as caught:
        read_contactnets(cube_folder)
    assert "\n" not in str(caught.value)
    torch.save(Bomb(witness), cube_folder / "3.pt")
    with pytest.raises(FileError, match=r"3\.pt: holds Python objects or code"):
        read_contactnets(cube_folder)
    assert not witness.exists()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        *((content, "") for content in (b"", b"hello", b"PK\x03\x04 not a zip", 0.1, 0.5, 0.99)),
        ({"a": torch.zeros(3, 19)}, "expected"),
        (torch.zeros(20, 18), "expected"),
        (torch.zeros(2, 20, 19), "expected"),
        (torch.zeros(1, 19), "expected"),
        (torch.zeros(20, 19, dtype=torch.int64), "expected"),
        (torch.zeros(20, 19, dtype=torch.complex64), "expected"),
        (torch.zeros(20, 19).to_sparse(), "expected"),
    ],
)
def test_what_is_no_tensor_of_a_toss_is_refused(cube_folder: Path, content: object, says: str) -> None:
    """Bytes, a share of a good file, or another object."""
    path = cube_folder / "2.pt"
    whole = path.read_bytes()
    if isinstance(content, bytes | float):
        path.write_bytes(whole[: int(content * len(whole))] if isinstance(content, float) else content)
    else:
        torch.save(content, path)
    with pytest.raises(FileError, match=rf"2\.pt.*{says}"):
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
    assert (caught.value.path.name, caught.value.row) == ("2.pt", row)


@pytest.mark.parametrize(
    "read",
    [read_contactnets, lambda folder: read_pll(folder, n_joints=1), lambda folder: read_tum(folder, n_joints=0)],
)
def test_empty_and_missing_folders(tmp_path: Path, read: Callable[[Path], object]) -> None:
    with pytest.raises(FileError, match="holds no"):
        read(tmp_path)
    with pytest.raises(FileError, match="no such folder"):
        read(tmp_path / "nowhere")
