"""The format `tum`: trajectories `timestamp tx ty tz qx qy qz qw`, one text file a toss."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from tossid.errors import ConfigError, FileError, InputError
from tossid.outputs import write_whole
from tossid.settings.kinds import Fraction
from tossid.store.importers.registry import Imported, holds, register_importer

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from tossid.objects import ObjectModel
    from tossid.store.recorded_poses.columns import PoseColumns
    from tossid.types import PoseTrack, Toss

    Array = NDArray[np.float64]

_JOINTS, _LINK = ".joints.txt", ".link_2.txt"
_FORM = "timestamp tx ty tz qx qy qz qw"
_SAME_TIME = 1e-6
"""[s] by which the times of poses and joints may differ (they are printed with some digits)."""
MOST_LOST = 0.2
"""Largest share of a file's rows that may hold no pose."""


@dataclass(frozen=True, kw_only=True)
class TumSource:
    """Tracked poses, one TUM trajectory file a toss."""

    name: Literal["tum"] = "tum"
    """TUM trajectories"""
    path: Path
    """folder of NAME.txt files (beside them NAME.joints.txt for joints, NAME.link_2.txt for an unknown second link)"""
    columns: str | None = None
    """names of the columns, whatever the files say, such as "time_ms tx ty tz qw qx qy qz"; null: as their first line
    names them, else "timestamp tx ty tz qx qy qz qw\""""
    most_lost: Fraction = MOST_LOST
    """largest share of a file's rows that may hold no pose, because the tracker had lost the object"""


class _File(NamedTuple):
    """What one file holds: its track, which of its rows that is, and what is to be said of it."""

    track: PoseTrack
    t: Array
    kept: NDArray[np.int64]
    lost: Counter[str]
    columns: PoseColumns


def read_tum(
    folder: Path, *, n_joints: int, columns: str | None = None, most_lost: float = MOST_LOST
) -> Sequence[PoseTrack]:
    """The tracks in a folder of `NAME.txt`, and for an articulated object `NAME.joints.txt` beside each.

    A pose is that of the object's first link in a world with z up and ground z = 0; times [s] increase, but need not be
    uniform; `#` starts a comment. A first line that names columns is obeyed (`recorded_poses.columns`). Rows without a
    pose, where the tracker had lost the object, are left out. `NAME.joints.txt` holds `timestamp angle…` [rad] at the
    same times.

    Args:
        folder: Where the files lie.
        n_joints: Joints of the object.
        columns: Names of the columns, whatever the files say; None: as their first line says, else
            `timestamp tx ty tz qx qy qz qw`.
        most_lost: Largest share of a file's rows that may hold no pose.

    Returns:
        Tracks without velocities, 2 before 10.

    Raises:
        FileError: A file is missing or is not what it should be; names file and line.
    """
    return _read_folder(folder, n_joints, columns, most_lost).tracks


def read_link_tum(
    folder: Path, *, columns: str | None = None, most_lost: float = MOST_LOST
) -> tuple[Sequence[PoseTrack], ...]:
    """The tracks of both links of an object of which nothing is stated: `NAME.txt` and `NAME.link_2.txt` beside each.

    Args:
        folder: Where the files lie.
        columns: As `read_tum` has them.
        most_lost: As `read_tum` has it. Frames without a pose of one link are left out of both.

    Returns:
        Tracks of link 1 and of link 2 at the same times, (n, 7) each, without velocities, 2 before 10.

    Raises:
        FileError: A file is missing or is not what it should be; names file and line.
    """
    import numpy as np

    from tossid.types import PoseTrack

    links: tuple[list[PoseTrack], list[PoseTrack]] = ([], [])
    for path in _pose_files(folder):
        beside = _beside(path, _LINK)
        if not beside.is_file():
            raise FileError(beside, "is missing; object.links=2 needs the poses of the second link")
        both = [_read_file(each, 0, columns, most_lost) for each in (path, beside)]
        t, other = (file.t for file in both)
        if len(t) != len(other) or not (abs(t - other) <= _SAME_TIME).all():
            raise FileError(beside, f"its times are not those of {path.name}; expected both links in every frame")
        shared = np.intersect1d(both[0].kept, both[1].kept)
        for file, tracks in zip(both, links, strict=True):
            tracks.append(PoseTrack(path.stem, file.t[shared], file.track.q[np.isin(file.kept, shared)]))
    return links


def write_tum(
    folder: Path, tracks: Sequence[PoseTrack | Toss], *, second: Sequence[PoseTrack | Toss] | None = None
) -> None:
    """Write `NAME.txt` (and `NAME.joints.txt` where there are joints) for each track, to the last digit.

    Args:
        folder: Where the files go; it is made where it is missing.
        tracks: What is written.
        second: Tracks of a second link under the same names, for `NAME.link_2.txt`.

    Raises:
        InputError: A track's name cannot be a file's.
        OutputError: The folder cannot be written.
    """
    import numpy as np

    folder = Path(folder)
    for track in tracks:
        if not track.name or "/" in track.name or track.name.endswith((".joints", ".link_2")):
            raise InputError(
                f"a TUM file cannot be named after track {track.name!r} (empty, with '/', '.joints' or '.link_2')"
            )
        write_whole(folder / f"{track.name}.txt", _text(_FORM, _pose_rows(track)))
        if track.q.shape[1] > 7:
            joints = np.column_stack([track.t, track.q[:, 7:]])
            write_whole(folder / f"{track.name}{_JOINTS}", _text("timestamp angle", joints))
    for track in second or ():
        write_whole(folder / f"{track.name}{_LINK}", _text(_FORM, _pose_rows(track)))


def write_trajectory(path: Path, track: PoseTrack) -> None:
    """Write the poses of a track's base as one file, with nine decimals: `timestamp tx ty tz qx qy qz qw`."""
    import numpy as np

    np.savetxt(path, _pose_rows(track), fmt="%.9f", header=_FORM)


def trajectory_info(path: Path) -> dict[str, Any]:
    """What is in one trajectory, for a person: its rows, their rate, their span in time and in space.

    Args:
        path: A file of rows `timestamp tx ty tz qx qy qz qw`.

    Raises:
        FileError: It is none, or its times do not increase, or a quaternion is no rotation.
    """
    import numpy as np

    if path.name.endswith(_JOINTS):
        raise FileError(path, f"gives joint angles, expected rows of '{_FORM}'")
    file = _read_file(path, 0, None, MOST_LOST)
    t, places = file.track.t, file.track.q[:, :3]
    return {
        "kind": "poses",
        "n_frames": len(t),
        "n_lost": file.lost.total(),
        "rate_hz": float(1 / np.median(np.diff(t))),
        "duration_s": float(t[-1] - t[0]),
        "position_min_m": places.min(axis=0).tolist(),
        "position_max_m": places.max(axis=0).tolist(),
    }


def _pose_files(folder: Path) -> list[Path]:
    from tossid.store.recorded_poses.checks import files_of

    return files_of(Path(folder), ".txt", but_not=(_JOINTS, _LINK))


def _beside(path: Path, ending: str) -> Path:
    return path.with_name(path.name.removesuffix(".txt") + ending)


def _pose_rows(track: PoseTrack | Toss) -> Array:
    import numpy as np

    from tossid.rotations import wxyz_to_xyzw

    return np.column_stack([track.t, track.q[:, :3], wxyz_to_xyzw(track.q[:, 3:7])])


def _text(header: str, rows: Array) -> bytes:
    lines = [f"# {header}", *(" ".join(repr(float(x)) for x in row) for row in rows)]
    return ("\n".join(lines) + "\n").encode()


def _read_folder(folder: Path, n_joints: int, columns: str | None, most_lost: float) -> Imported:
    """The tracks of a folder, and what is to be said of its files; every file is checked now."""
    from tossid.store.recorded_poses.checks import tracks_of
    from tossid.store.recorded_poses.rows import lost_words

    said: dict[Path, tuple[int, Counter[str], PoseColumns]] = {}

    def track(path: Path) -> PoseTrack:
        file = _read_file(path, n_joints, columns, most_lost)
        said[path] = len(file.t), file.lost, file.columns
        return file.track

    tracks = tracks_of(_pose_files(folder), track)
    for _ in tracks:
        pass
    rows, lost, names = zip(*said.values(), strict=True)
    together = sum(lost, Counter[str]())
    return Imported(
        tracks,
        remarks=(f"{lost_words(sum(rows), together)}: they are left out as lost frames",) if together else (),
        w_first=all(each.w_first for each in names),
        stated=all(each.named for each in names),
    )


def _read_file(path: Path, n_joints: int, columns: str | None, most_lost: float) -> _File:
    import numpy as np

    from tossid.rotations import xyzw_to_wxyz
    from tossid.store.recorded_poses.checks import check_times, checked_track
    from tossid.store.recorded_poses.rows import lost_rows, lost_words

    rows, lines, where = _read_poses(path, columns)
    t = _time(path, rows, lines, where)
    check_times(path, t)
    poses = np.concatenate([where.length * rows[:, where.position], rows[:, where.quaternion]], axis=1)
    gone, lost = lost_rows(t, poses)
    if gone.mean() > most_lost:
        problem = f"{lost_words(len(t), lost)}; at most {most_lost:.0%} may be lost frames (source.most_lost)"
        raise FileError(path, problem, row=f"line {lines[int(np.argmax(gone))]}")
    kept = np.flatnonzero(~gone)
    q = np.concatenate([poses[:, :3], xyzw_to_wxyz(poses[:, 3:])], axis=1)
    beside = _beside(path, _JOINTS)
    if n_joints:
        if not beside.is_file():
            raise FileError(beside, f"is missing; the object has {n_joints} joints")
        q = np.concatenate([q, _read_joints(beside, t, kept, n_joints)], axis=1)
    elif beside.exists():
        raise FileError(beside, "gives joint angles, but the object has no joints")
    track = checked_track(path, t[kept], q[kept], None, row_names=[f"line {lines[row]}" for row in kept])
    return _File(track, t, kept, lost, where)


def _read_poses(path: Path, columns: str | None) -> tuple[Array, list[int], PoseColumns]:
    """The rows of a file of poses, the line of each, and where they hold what."""
    from tossid.store.recorded_poses.columns import USUAL, pose_columns, split_names
    from tossid.store.recorded_poses.rows import read_rows

    rows, lines, names = read_rows(path, _FORM)
    if columns is not None:
        names = split_names(columns)
    try:
        where = pose_columns(names) if names else USUAL
    except ValueError as error:
        if columns is not None:
            raise ConfigError("source.columns", str(error)) from error
        raise FileError(path, f"the header {error}") from error
    if rows.shape[1] != where.count:
        who = "source.columns" if columns is not None else "the header"
        expected = f"{where.count}, as {who} names them" if names else f"rows of '{_FORM}'"
        raise FileError(path, f"has {rows.shape[1]} columns, expected {expected}", row=f"line {lines[0]}")
    return rows, lines, where


def _time(path: Path, rows: Array, lines: list[int], where: PoseColumns) -> Array:
    """Times (n,) [s], of whole seconds and nanoseconds too."""
    import numpy as np

    for at, size in where.times[1:] if where.times[0][1] == 1.0 else where.times[:-1]:
        beyond = ~((rows[:, at] >= 0) & (rows[:, at] * size < 1))
        if beyond.any():
            row = int(np.argmax(beyond))
            problem = f"{rows[row, at]:.9g} is no part of a second; expected one column of the time"
            raise FileError(path, problem, row=f"line {lines[row]}")
    t = np.sum([rows[:, at] * size for at, size in where.times], axis=0)
    if np.isnan(t).any():
        raise FileError(path, "has no time", row=f"line {lines[int(np.argmax(np.isnan(t)))]}")
    return np.asarray(t)


def _read_joints(path: Path, t: Array, kept: NDArray[np.int64], n_joints: int) -> Array:
    """Angles (n, n_joints) [rad] at the times of all poses; only those of poses that are kept need to be numbers."""
    import numpy as np

    from tossid.store.recorded_poses.columns import column_of
    from tossid.store.recorded_poses.rows import read_rows

    form = "timestamp" + " angle" * n_joints
    rows, lines, names = read_rows(path, form)
    if rows.shape[1] != 1 + n_joints:
        raise FileError(path, f"{rows.shape[1]} columns, expected {1 + n_joints}: '{form}'", row=f"line {lines[0]}")
    time = column_of(names[0]) if names else None
    if names and (time is None or time.part != "timestamp"):
        raise FileError(path, f"names its first column '{names[0]}', expected '{form}'")
    rows[:, 0] *= 1.0 if time is None else time.size
    for joint, name in enumerate(names[1:], start=1):
        rows[:, joint] *= np.pi / 180 if "deg" in name.lower() else 1.0
    if len(rows) != len(t):
        raise FileError(path, f"has {len(rows)} rows, the poses beside it have {len(t)}")
    off = ~(np.abs(rows[:, 0] - t) <= _SAME_TIME)
    if off.any():
        row = int(np.argmax(off))
        raise FileError(path, f"time {rows[row, 0]:.9g} s, the pose has {t[row]:.9g} s", row=f"line {lines[row]}")
    bad = ~np.isfinite(rows[kept]).all(axis=1)
    if bad.any():
        row = int(kept[np.argmax(bad)])
        raise FileError(path, "is not finite (NaN or infinity)", row=f"line {lines[row]}")
    rows[kept, 1:] = np.unwrap(rows[kept, 1:], axis=0)
    return rows[:, 1:]


def _import(source: TumSource, model: ObjectModel) -> Imported:
    other = next(iter(sorted(Path(source.path).glob(f"*{_LINK}"))), None)
    if other is not None:
        raise FileError(other, "gives the poses of a second link, which object=unknown object.links=2 takes")
    return _read_folder(source.path, model.n_joints, source.columns, source.most_lost)


register_importer(
    TumSource,
    _import,
    recognizes=lambda path: holds(path, ".txt") and not holds(path, ".pt"),
    cut_at_rest=True,
    read_links=lambda source: read_link_tum(source.path, columns=source.columns, most_lost=source.most_lost),
)
