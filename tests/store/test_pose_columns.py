"""Names of columns: spellings of many tools are read, and what is not known is refused with what was meant."""

from __future__ import annotations

import pytest

from tossid.store.pose_columns import is_header, pose_columns, split_names

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
        ("time_ms,x,y,z,q_w,q_x,q_y,q_z,", [(0, 1e-3)], (1, 2, 3), 1.0, (5, 6, 7, 4)),
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
def test_spellings(
    header: str,
    times: list[tuple[int, float]],
    position: tuple[int, ...],
    length: float,
    quaternion: tuple[int, ...],
) -> None:
    names = split_names(header)
    found = pose_columns(names)
    assert is_header(names, found.count)
    assert list(found.times) == times
    assert (found.position, found.length, found.quaternion) == (position, length, quaternion)


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
        ("time x y z qx [deg] qy qz qw", "not known ('qx [deg]')"),
    ],
)  # fmt: skip
def test_what_is_refused(header: str, says: str) -> None:
    with pytest.raises(ValueError, match="expected") as caught:
        pose_columns(split_names(header))
    assert says in str(caught.value)


@pytest.mark.parametrize("text", ["# ground truth trajectory", "# file: 'a b.bag'", "# recorded at 148 Hz", "# c", "#"])
def test_a_sentence_is_no_header(text: str) -> None:
    assert not is_header(split_names(text), 8)


def test_as_many_words_as_columns_are_a_header_that_is_not_known() -> None:
    assert is_header(split_names("# time a b c d e f g"), 8)
