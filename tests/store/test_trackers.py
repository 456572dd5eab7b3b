"""Text files of trackers: round trips to the last digit, headers obeyed, lost rows left out, errors with their line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import tossid
from tests.store.makers import make_toss, spinning
from tossid.errors import ConfigError, FileError, InputError, OutputError
from tossid.rotations import quat_exp, wxyz_to_xyzw
from tossid.store import read_tum, write_tum
from tossid.store.importers.tum import read_link_tum, trajectory_info, write_trajectory
from tossid.store.recorded_poses.columns import pose_columns, split_names
from tossid.store.recorded_poses.rows import NOT_FINITE, REPEATED, ZERO, lost_rows, lost_words, read_rows
from tossid.types import PoseTrack

Array = NDArray[np.float64]
NAN = float("nan")


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


def test_tosses_and_one_trajectory_are_written_in_tums_order(tmp_path: Path) -> None:
    toss = make_toss("a", 5, np.random.default_rng(0))
    write_tum(tmp_path, [toss])
    write_trajectory(tmp_path / "poses.txt", PoseTrack("cube", toss.t, toss.q))
    for name, digits in (("a.txt", 1e-15), ("poses.txt", 0.6e-9)):
        head, first, *_ = (tmp_path / name).read_text().splitlines()
        assert head == "# timestamp tx ty tz qx qy qz qw"
        row = [float(x) for x in first.split()]
        np.testing.assert_allclose(row, [toss.t[0], *toss.q[0, :3], *wxyz_to_xyzw(toss.q[0, 3:7])], atol=digits)
    with pytest.raises(InputError, match="named after"):
        write_tum(tmp_path, [replace(toss, name="a.joints")])
    with pytest.raises(OutputError, match="cannot be written"):
        write_tum(tmp_path / "a.txt", [toss])


GOOD = "0.0 0 0 1 0 0 0 1\n0.1 0 0 1 0 0 0 1\n0.25 0 0 1 0 0 0 1\n"


@pytest.mark.parametrize(
    ("content", "line", "says"),
    [
        (GOOD + "0.3 0 0 1 0 0 0\n", 4, "7 columns, expected 8"),
        ("# c\n" + GOOD + "0.3 0 0 1 0 0 0 1 9\n", 5, "9 columns"),
        (GOOD + "0.3 0 0 x 0 0 0 1\n", 4, "'x' is none, expected numbers"),
        (GOOD + "0.3 0 0 1_0 0 0 0 1\n", 4, "'1_0' is none"),
        ("0,5 0 0 1 0 0 0 1\n" * 2, 1, "decimals have a point, no comma"),
        (GOOD + "0.3 0 0 nan 0 0 0 1\n", 4, "finite"),
        (GOOD + "0.3 0 0 1 0 0 0 0.9\n", 4, "norm 0.9"),
        ("# c\n# c\n" + GOOD + "0.25 0 0 1 0 0 0 1\n", 6, "increase"),
        (GOOD + "0.3 0 0 1000 0 0 0 1\n", 4, "position"),
        ("", None, "has 0 rows of numbers, expected rows of"),
        ("0 0 0 1 0 0 0 1\n", None, "has 1 rows of numbers, expected rows of"),
        ("\ufffd\0 an image", None, "is not text"),
    ],
)
def test_a_bad_trajectory_is_refused_with_its_line(tmp_path: Path, content: str, line: int | None, says: str) -> None:
    (tmp_path / "a.txt").write_text(content)
    for read in (lambda: read_tum(tmp_path, n_joints=0), lambda: trajectory_info(tmp_path / "a.txt")):
        with pytest.raises(FileError, match=says) as caught:
            read()
        assert str(caught.value).startswith(f"{tmp_path / 'a.txt'}{'' if line is None else f', line {line}'}:")


@pytest.mark.parametrize(
    ("content", "n_joints", "says"),
    [
        (None, 1, r"a\.joints\.txt: is missing"),
        ("0.0 3.1\n0.1 -3.1\n0.25 -3.0\n", 0, "no joints"),
        ("0.0 3.1\n0.1 -3.1\n0.25 -3.0\n", 2, "2 columns, expected 3"),
        ("0.0 3.1\n0.1 -3.1\n", 1, "has 2 rows"),
        ("0.0 3.1\n0.2 -3.1\n0.25 -3.0\n", 1, r"line 2: time 0\.2"),
        ("0.0 3.1\n0.1 nan\n0.25 -3.0\n", 1, "line 2: is not finite"),
        ("0.0 3.1\n0.1 -3.1\n0.25 -3.0\n", 1, None),
    ],
)
def test_joints_beside_the_poses(tmp_path: Path, content: str | None, n_joints: int, says: str | None) -> None:
    (tmp_path / "a.txt").write_text(GOOD)
    if content is not None:
        (tmp_path / "a.joints.txt").write_text(content)
    if says is None:
        angles = read_tum(tmp_path, n_joints=n_joints)[0].q[:, 7]
        np.testing.assert_allclose(angles, [3.1, 2 * np.pi - 3.1, 2 * np.pi - 3.0])
    else:
        with pytest.raises(FileError, match=says):
            read_tum(tmp_path, n_joints=n_joints)


def test_poses_of_a_second_link_beside_those_of_the_first(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    first, second = (
        [PoseTrack(name, 0.01 * np.arange(15), spinning(15, rng)[1]) for name in ("9", "10")] for _ in range(2)
    )
    write_tum(tmp_path, first, second=second)
    for links, again in zip((first, second), read_link_tum(tmp_path), strict=True):
        assert [track.name for track in again] == ["9", "10"]
        for a, b in zip(links, again, strict=True):
            np.testing.assert_allclose(a.q, b.q, rtol=0, atol=1e-15)
    beside = tmp_path / "9.link_2.txt"
    with pytest.raises(FileError, match=r"second link, which object=unknown object\.links=2 takes"):
        tossid.ingest(tmp_path, source="tum", object="cube")
    beside.write_text(GOOD)
    with pytest.raises(FileError, match=r"its times are not those of 9\.txt"):
        read_link_tum(tmp_path)
    beside.unlink()
    with pytest.raises(FileError, match=r"9\.link_2\.txt: is missing; object\.links=2"):
        read_link_tum(tmp_path)


def _flight(n: int = 40, rate: float = 148.0) -> tuple[np.ndarray, np.ndarray]:
    _, q, _ = spinning(n, np.random.default_rng(1), n_joints=0)
    return np.arange(n) / rate, q


def _write(path: Path, header: str, columns: list[np.ndarray], *, separator: str = " ") -> None:
    rows = np.column_stack(columns)
    lines = [separator.join(f"{value:.9f}" for value in row) for row in rows]
    path.write_text("\n".join(([header] if header else []) + lines) + "\n")


def test_columns_can_be_named_where_files_do_not(tmp_path: Path) -> None:
    t, q = _flight()
    _write(tmp_path / "a.txt", "", [1e3 * t, q])
    again = read_tum(tmp_path, n_joints=0, columns="time_ms tx ty tz qw qx qy qz")[0]
    np.testing.assert_allclose(again.q, q, atol=1e-8)
    np.testing.assert_allclose(again.t, t, atol=1e-8)
    with pytest.raises(ConfigError, match=r"source\.columns: names no column for qw"):
        read_tum(tmp_path, n_joints=0, columns="time_ms tx ty tz qx qy qz")
    with pytest.raises(FileError, match=r"has 8 columns, expected 9, as source\.columns names them"):
        read_tum(tmp_path, n_joints=0, columns="time_ms frame tx ty tz qx qy qz qw")


@pytest.mark.parametrize(
    ("times", "says"),
    [
        (lambda t: 1e3 * t, r"frames are 6\.76 s apart \(median\), and it is 263\.5 s long; are the times in ms\?"),
        (lambda t: 1.7e12 + 1e3 * t, r"are the times in ms\?"),
        (lambda t: 1e6 * t * 0.148, r"are the times in µs\?"),
        (lambda t: 1.7e18 + 1e9 * t, r"are the times in ns\?"),
        (lambda t: np.arange(len(t)), r"are the times frame numbers\?"),
        (lambda t: t / 86400, r"are the times seconds, not hours or days\?"),
    ],
)
def test_times_are_asked_for_their_unit(tmp_path: Path, times: Any, says: str) -> None:
    t, q = _flight()
    rows = np.column_stack([times(t), q[:, :3], wxyz_to_xyzw(q[:, 3:7])])
    np.savetxt(tmp_path / "a.txt", rows, fmt="%.15g" if rows[0, 0] < 1e15 else "%.20g")
    for read in (lambda: read_tum(tmp_path, n_joints=0), lambda: trajectory_info(tmp_path / "a.txt")):
        with pytest.raises(FileError, match=says) as caught:
            read()
        assert "names the column's unit says so, such as time_ms" in str(caught.value)


def test_frames_in_which_the_object_was_lost_are_left_out_and_counted(tmp_path: Path) -> None:
    t, q = _flight()
    poses = np.concatenate([q[:, :3], wxyz_to_xyzw(q[:, 3:7])], axis=1)
    poses[5:8] = np.nan
    _write(tmp_path / "a.txt", "# timestamp tx ty tz qx qy qz qw", [t, poses])
    angles = np.column_stack([t, 0.1 + 0 * t])
    angles[6, 1] = np.nan
    track = read_tum(tmp_path, n_joints=0)[0]
    np.testing.assert_allclose(track.t, np.delete(t, [5, 6, 7]), atol=1e-9)
    assert trajectory_info(tmp_path / "a.txt")["n_lost"] == 3
    np.savetxt(tmp_path / "a.joints.txt", angles)
    np.testing.assert_allclose(read_tum(tmp_path, n_joints=1)[0].q[:, 7], 0.1)
    poses[10:16] = 0.0
    _write(tmp_path / "a.txt", "", [t, poses])
    with pytest.raises(FileError, match=r"line 6: 9 of 40 rows hold no pose \(3 not finite, 6 of zeros\); at most 20%"):
        read_tum(tmp_path, n_joints=1)
    assert len(read_tum(tmp_path, n_joints=1, most_lost=0.3)[0].t) == 31


def test_frames_that_one_link_lost_are_left_out_of_both(tmp_path: Path) -> None:
    t, q = _flight()
    poses = np.concatenate([q[:, :3], wxyz_to_xyzw(q[:, 3:7])], axis=1)
    for name, lost in (("a.txt", 5), ("a.link_2.txt", 9)):
        own = poses.copy()
        own[lost] = np.nan
        _write(tmp_path / name, "", [t, own])
    for links in read_link_tum(tmp_path):
        np.testing.assert_allclose(links[0].t, np.delete(t, [5, 9]), atol=1e-9)
        np.testing.assert_allclose(links[0].q[:, :3], np.delete(q, [5, 9], axis=0)[:, :3], atol=1e-8)


# ---------------------------------------------------------------- rows and lost rows


@pytest.mark.parametrize(
    ("text", "rows", "lines", "header"),
    [
        ("# c\n1 2\n\n3\t4 # after\n", [[1, 2], [3, 4]], [2, 4], []),
        ("1,2\n3,\n,null\n", [[1, 2], [3, NAN], [NAN, NAN]], [1, 2, 3], []),
        ("1;2,5\n0,25;-nan(ind)\n", [[1, 2.5], [0.25, NAN]], [1, 2], []),
        ("time,frame_id\n1,cam\n2,cam\n", [[1, NAN], [2, NAN]], [2, 3], ["time", "frame_id"]),
        ("# a note\n# timestamp angle\n0 NaN\n1 2\n", [[0, NAN], [1, 2]], [3, 4], ["timestamp", "angle"]),
        (
            "# time x y z of Take 3.csv t0=1.5\n0 1 2 3\n1 2 3 4\n",
            [[0, 1, 2, 3], [1, 2, 3, 4]],
            [2, 3],
            ["time", "x", "y", "z"],
        ),
        ("1, 2,\n3, 4,\n", [[1, 2], [3, 4]], [1, 2], []),
    ],
)
def test_rows_of_numbers(
    tmp_path: Path, text: str, rows: list[list[float]], lines: list[int], header: list[str]
) -> None:
    (tmp_path / "a.txt").write_text(text)
    found, at, names = read_rows(tmp_path / "a.txt", "a b")
    np.testing.assert_array_equal(found, rows)
    assert (at, names) == (lines, header)


T = np.arange(60) / 148.0


def thrown(*, decimals: int = 9) -> Array:
    """A tumbling flight of 0.27 s, and rest to the last digit."""
    fly = np.minimum(T, 0.27)[:, None]
    place = np.array([0.1, -0.2, 0.4]) + fly * [1.0, 0.5, 0.4] - 0.5 * 9.81 * fly**2 * [0, 0, 1]
    quat = quat_exp(fly * np.array([3.0, -7.0, 2.0]) + np.array([0.2, 0.1, 0.4]))
    return np.round(np.concatenate([place, wxyz_to_xyzw(quat)], axis=1), decimals)


def _with(rows: slice, value: float | list[float]) -> Callable[[Array], None]:
    def put(poses: Array) -> None:
        poses[rows] = value

    return put


def _held(poses: Array) -> None:
    poses[11:15] = poses[10]


@pytest.mark.parametrize(
    ("harm", "kind", "rows"),
    [
        (_with(slice(7, 10), np.nan), NOT_FINITE, [7, 8, 9]),
        (_with(slice(0, 2), np.inf), NOT_FINITE, [0, 1]),
        (_with(slice(20, 22), 0.0), ZERO, [20, 21]),
        (_with(slice(58, 60), [0, 0, 0, 0, 0, 0, 1]), ZERO, [58, 59]),
        (_with(slice(30, 31), [0, 0, 0, 1, 0, 0, 0]), ZERO, [30]),
        (_held, REPEATED, [11, 12, 13, 14]),
    ],
)
def test_lost_frames(harm: Callable[[Array], None], kind: str, rows: list[int]) -> None:
    poses = thrown()
    harm(poses)
    gone, lost = lost_rows(T, poses)
    assert np.flatnonzero(gone).tolist() == rows
    assert lost == {kind: len(rows)}
    assert lost_words(60, lost) == f"{len(rows)} of 60 rows hold no pose ({len(rows)} {kind})"


@pytest.mark.parametrize("decimals", [9, 3, 2])
def test_rest_and_few_digits_are_no_loss(decimals: int) -> None:
    from_origin = np.zeros((60, 7))
    from_origin[:, 0], from_origin[:, 6] = 2.0 * T, 1.0
    for poses in (thrown(decimals=decimals), from_origin):
        gone, lost = lost_rows(T, poses)
        assert not gone.any()
        assert not lost


# ---------------------------------------------------------------- names of columns

EUROC = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
STATES = EUROC + ",v_RS_R_x [m s^-1],b_w_RS_S_x [rad s^-1],b_a_RS_S_x [m s^-2]"
FIELD = "field.pose"
ROSTOPIC = ",".join(
    [
        "%time,field.header.seq,field.header.stamp,field.header.frame_id",
        *(f"{FIELD}.position.{axis}" for axis in "xyz"),
        *(f"{FIELD}.orientation.{axis}" for axis in "xyzw"),
    ]
)
POSE = "pose.position.x pose.position.y pose.position.z"
TURN = "pose.orientation.x pose.orientation.y pose.orientation.z pose.orientation.w"


@pytest.mark.parametrize(
    ("header", "times", "position", "length", "quaternion"),
    [
        ("# timestamp tx ty tz qx qy qz qw", [(0, 1.0)], (1, 2, 3), 1.0, (4, 5, 6, 7)),
        ("# timestamp tx ty tz qw qx qy qz", [(0, 1.0)], (1, 2, 3), 1.0, (5, 6, 7, 4)),
        ("time_ms,x,y,z,q_w,q_x,q_y,q_z", [(0, 1e-3)], (1, 2, 3), 1.0, (5, 6, 7, 4)),
        ("t x y z q_w q_x q_y q_z", [(0, 1.0)], (1, 2, 3), 1.0, (5, 6, 7, 4)),
        ("# columns: qw qx qy qz tx_mm ty_mm tz_mm Time(us)", [(7, 1e-6)], (4, 5, 6), 1e-3, (1, 2, 3, 0)),
        ("Time [s];Position X [cm];Position Y [cm];Position Z [cm];Rotation X;Rotation Y;Rotation Z;Rotation W",
         [(0, 1.0)], (1, 2, 3), 1e-2, (4, 5, 6, 7)),
        ("stamp (ns) x (mm) y (mm) z (mm) qi qj qk qr", [(0, 1e-9)], (1, 2, 3), 1e-3, (4, 5, 6, 7)),
        (f"header.stamp.sec header.stamp.nanosec {POSE} {TURN}", [(0, 1.0), (1, 1e-9)], (2, 3, 4), 1.0, (5, 6, 7, 8)),
        (f"sec nsec frame_id {POSE} {TURN}", [(0, 1.0), (1, 1e-9)], (3, 4, 5), 1.0, (6, 7, 8, 9)),
        (EUROC, [(0, 1e-9)], (1, 2, 3), 1.0, (5, 6, 7, 4)),
        (STATES, [(0, 1e-9)], (1, 2, 3), 1.0, (5, 6, 7, 4)),
        (ROSTOPIC, [(2, 1e-9)], (4, 5, 6), 1.0, (7, 8, 9, 10)),
    ],
)  # fmt: skip
def test_a_header_is_obeyed_however_it_is_spelt(
    tmp_path: Path,
    header: str,
    times: list[tuple[int, float]],
    position: tuple[int, ...],
    length: float,
    quaternion: tuple[int, ...],
) -> None:
    t, q = _flight()
    rows = np.zeros((len(t), len(split_names(header))))
    column, second = times[-1]
    rows[:, column] = t / second
    rows[:, position], rows[:, quaternion] = q[:, :3] / length, wxyz_to_xyzw(q[:, 3:7])
    separator = next(mark for mark in ";, " if mark in header.lstrip("# "))
    _write(tmp_path / "a.txt", header, [rows], separator=separator)
    track = read_tum(tmp_path, n_joints=0)[0]
    np.testing.assert_allclose(track.t, t, atol=1e-8)
    np.testing.assert_allclose(track.q, q, atol=1e-8)
    assert trajectory_info(tmp_path / "a.txt")["rate_hz"] == pytest.approx(148, rel=1e-5)


@pytest.mark.parametrize(
    ("header", "says"),
    [
        ("time x y z q0 q1 q2 q3", "not known ('q0', 'q1', 'q2', 'q3'), expected 'timestamp tx ty tz qx qy qz qw'"),
        ("time x y z roll pitch yaw", "not known ('roll', 'pitch', 'yaw')"),
        ("time x y z rot_x rot_y rot_z", "names no column for qw"),
        ("tx ty tz qx qy qz qw", "names no column for timestamp"),
        ("time x y z x qx qy qz qw", "two columns that could both be tx ('x' and 'x')"),
        ("time timestamp x y z qx qy qz qw", "each be the time ('time' and 'timestamp'), expected one"),
        ("time_s time_ms x y z qx qy qz qw", "each be the time ('time_s' and 'time_ms')"),
        ("time x_mm y_mm z qx qy qz qw", "other units for tx, ty and tz"),
        ("time x_inch y_inch z_inch qx qy qz qw", "not known ('x_inch'"),
    ],
)  # fmt: skip
def test_names_that_are_not_known_are_refused(header: str, says: str) -> None:
    with pytest.raises(ValueError, match="expected") as caught:
        pose_columns(split_names(header))
    assert says in str(caught.value)
