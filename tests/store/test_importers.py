"""Published recordings import whole; what is wrong in a file is one error that names file and row."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.store.makers import HALF, contactnets_rows, make_toss, pll_rows, spinning
from tossid.errors import FileError, InputError, OutputError
from tossid.rotations import quat_boxminus, wxyz_to_xyzw
from tossid.store import read_contactnets, read_pll, read_tum, write_tum
from tossid.types import PoseTrack


def save(path: Path, rows: np.ndarray) -> None:
    torch.save(torch.from_numpy(rows.copy()), path)


@pytest.fixture
def cube_folder(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    folder = tmp_path / "cube"
    folder.mkdir()
    for name in ("10", "2", "1"):
        rows = contactnets_rows(20, rng)
        save(folder / f"{name}.pt", rows[None] if name == "2" else rows)
    return folder


@pytest.fixture
def elbow_folder(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    folder = tmp_path / "elbow"
    folder.mkdir()
    for name in ("0", "1"):
        save(folder / f"{name}.pt", pll_rows(20, rng))
    return folder


# --- what is right ---


def test_contactnets_columns_and_units(cube_folder: Path) -> None:
    tracks = read_contactnets(cube_folder)
    assert [track.name for track in tracks] == ["1", "2", "10"]
    for track in tracks:
        rows = torch.load(cube_folder / f"{track.name}.pt", weights_only=True).reshape(-1, 19).numpy()
        np.testing.assert_allclose(track.q[:, :3], rows[:, :3] * HALF)
        np.testing.assert_allclose(track.q[:, 3:], rows[:, 3:7])
        assert track.v is not None
        np.testing.assert_allclose(track.v[:, :3], rows[:, 7:10] * HALF)
        np.testing.assert_allclose(track.v[:, 3:], rows[:, 10:13])
        np.testing.assert_allclose(np.diff(track.t), 1 / 148)
        # the velocities are those of the poses
        np.testing.assert_allclose(np.diff(track.q[:, :3], axis=0) * 148, track.v[1:, :3], atol=1e-9)


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


def test_quaternions_slightly_off_are_normalised(elbow_folder: Path) -> None:
    rows = torch.load(elbow_folder / "0.pt", weights_only=True).numpy()
    rows[:, :4] *= 1.0008
    save(elbow_folder / "0.pt", rows)
    track = read_pll(elbow_folder, n_joints=1)[0]
    np.testing.assert_allclose(np.linalg.norm(track.q[:, 3:7], axis=1), 1.0, atol=1e-15)


def test_every_published_cube_toss_imports(shared_data: Path) -> None:
    folder = shared_data / "contactnets_cube"
    tracks = read_contactnets(folder)
    assert len(tracks) == len(list(folder.glob("*.pt")))
    assert max(len(track.t) for track in tracks) == 442
    assert [int(track.name) for track in tracks] == sorted(int(track.name) for track in tracks)
    # what the format says of them: at rest on a face, about half a width above the ground
    rest = np.median([track.q[-1, 2] for track in tracks])
    assert rest == pytest.approx(HALF, abs=0.002)


def test_every_published_elbow_toss_imports(shared_data: Path) -> None:
    folder = shared_data / "pll_elbow"
    tracks = read_pll(folder, n_joints=1)
    assert len(tracks) == len(list(folder.glob("*.pt")))
    assert {track.q.shape for track in tracks} == {(121, 8)}
    assert max(np.abs(np.diff(track.q[:, 7])).max() for track in tracks) < np.pi


# --- what is wrong ---


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


def scaled(folder: Path, columns: slice, factor: float) -> None:
    for path in folder.glob("*.pt"):
        rows = torch.load(path, weights_only=True).numpy()
        rows[..., columns] *= factor
        save(path, rows)


def test_lengths_in_metres_are_noticed(cube_folder: Path) -> None:
    scaled(cube_folder, slice(0, 3), HALF)
    scaled(cube_folder, slice(7, 10), HALF)
    with pytest.raises(FileError, match="half widths"):
        read_contactnets(cube_folder)


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
    with pytest.raises(FileError, match="quaternion order"):
        read_pll(tmp_path, n_joints=1)


def test_other_joints_than_the_object_has(elbow_folder: Path) -> None:
    with pytest.raises(FileError, match="expected 13 for an object of 0 joints"):
        read_pll(elbow_folder, n_joints=0)
    with pytest.raises(InputError, match="the object has 2"):
        read_pll(elbow_folder, n_joints=2)


@pytest.mark.parametrize(
    "read",
    [read_contactnets, lambda folder: read_pll(folder, n_joints=1), lambda folder: read_tum(folder, n_joints=0)],
)
def test_empty_and_missing_folders(tmp_path: Path, read: Callable[[Path], object]) -> None:
    with pytest.raises(FileError, match="holds no"):
        read(tmp_path)
    with pytest.raises(FileError, match="no such folder"):
        read(tmp_path / "nowhere")


@pytest.mark.parametrize("rate", [0.0, -148.0, float("nan")])
def test_rates_and_widths_must_be_positive(cube_folder: Path, rate: float) -> None:
    with pytest.raises(InputError, match="rate"):
        read_contactnets(cube_folder, rate_hz=rate)
    with pytest.raises(InputError, match="half width"):
        read_contactnets(cube_folder, half_width=rate)


# --- TUM ---


@pytest.mark.parametrize("n_joints", [0, 1, 2])
def test_tum_survives_to_the_last_digit(tmp_path: Path, n_joints: int) -> None:
    rng = np.random.default_rng(0)
    tracks = []
    for name in ("9", "10", "toss.a"):
        _, q, _ = spinning(15, rng, n_joints=n_joints)
        tracks.append(PoseTrack(name, 1.7e9 + np.sort(rng.random(15)), q))
    write_tum(tmp_path, tracks)
    again = read_tum(tmp_path, n_joints=n_joints)
    assert [track.name for track in again] == ["9", "10", "toss.a"]
    for a, b in zip(tracks, again, strict=True):
        np.testing.assert_array_equal(a.t, b.t)
        np.testing.assert_allclose(a.q, b.q, rtol=0, atol=1e-15)
        assert b.v is None


def test_tosses_can_be_written_as_tum(tmp_path: Path) -> None:
    toss = make_toss("a", 5, np.random.default_rng(0))
    write_tum(tmp_path, [toss])
    first = (tmp_path / "a.txt").read_text().splitlines()
    assert first[0] == "# timestamp tx ty tz qx qy qz qw"
    np.testing.assert_allclose(
        [float(x) for x in first[1].split()], [toss.t[0], *toss.q[0, :3], *wxyz_to_xyzw(toss.q[0, 3:7])]
    )
    with pytest.raises(InputError, match="named after"):
        write_tum(tmp_path, [replace(toss, name="a.joints")])
    with pytest.raises(OutputError, match="cannot be written"):
        write_tum(tmp_path / "a.txt", [toss])


GOOD = "0.0 0 0 1 0 0 0 1\n0.1 0 0 1 0 0 0 1\n0.25 0 0 1 0 0 0 1\n"


def test_tum_comments_blanks_and_commas(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("# header\n\n0,0,0,1,0,0,0,1\n  \n0.5 0 0 2 0 0 1 0  # turned\n")
    track = read_tum(tmp_path, n_joints=0)[0]
    np.testing.assert_array_equal(track.t, [0.0, 0.5])
    np.testing.assert_array_equal(track.q[1], [0, 0, 2, 0, 0, 0, 1])


@pytest.mark.parametrize(
    ("content", "line", "says"),
    [
        (GOOD + "0.3 0 0 1 0 0 0\n", 4, "7 columns, expected 8"),
        ("# c\n" + GOOD + "0.3 0 0 1 0 0 0 1 9\n", 5, "9 columns"),
        (GOOD + "0.3 0 0 x 0 0 0 1\n", 4, "'x'"),
        (GOOD + "0.3 0 0 1_0 0 0 0 1\n", 4, "expected numbers"),
        (GOOD + "0.3 0 0 nan 0 0 0 1\n", 4, "finite"),
        (GOOD + "0.3 0 0 1 0 0 0 0.9\n", 4, "norm 0.9"),
        ("# c\n# c\n" + GOOD + "0.25 0 0 1 0 0 0 1\n", 6, "increase"),
        (GOOD + "0.3 0 0 1000 0 0 0 1\n", 4, "position"),
    ],
)
def test_a_bad_tum_line_is_named(tmp_path: Path, content: str, line: int, says: str) -> None:
    (tmp_path / "a.txt").write_text(content)
    with pytest.raises(FileError, match=says) as caught:
        read_tum(tmp_path, n_joints=0)
    assert str(caught.value).startswith(f"{tmp_path / 'a.txt'}, line {line}:")


@pytest.mark.parametrize("content", [b"", b"# nothing\n", b"0 0 0 1 0 0 0 1\n", b"\xff\xd8\xff\xe0 an image"])
def test_what_is_no_trajectory_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.txt").write_bytes(content)
    with pytest.raises(FileError, match=r"a\.txt"):
        read_tum(tmp_path, n_joints=0)


def test_joints_beside_the_poses(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(GOOD)
    with pytest.raises(FileError, match=r"a\.joints\.txt: is missing"):
        read_tum(tmp_path, n_joints=1)
    joints = tmp_path / "a.joints.txt"
    joints.write_text("0.0 3.1\n0.1 -3.1\n0.25 -3.0\n")
    np.testing.assert_allclose(read_tum(tmp_path, n_joints=1)[0].q[:, 7], [3.1, 2 * np.pi - 3.1, 2 * np.pi - 3.0])
    with pytest.raises(FileError, match="no joints"):
        read_tum(tmp_path, n_joints=0)
    with pytest.raises(FileError, match="2 columns, expected 3"):
        read_tum(tmp_path, n_joints=2)
    joints.write_text("0.0 3.1\n0.1 -3.1\n")
    with pytest.raises(FileError, match="has 2 rows"):
        read_tum(tmp_path, n_joints=1)
    joints.write_text("0.0 3.1\n0.2 -3.1\n0.25 -3.0\n")
    with pytest.raises(FileError, match=r"line 2: time 0\.2"):
        read_tum(tmp_path, n_joints=1)
    joints.write_text("0.0 3.1\n0.1 nan\n0.25 -3.0\n")
    with pytest.raises(FileError, match="line 2: is not finite"):
        read_tum(tmp_path, n_joints=1)
