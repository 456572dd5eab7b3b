"""The format `tum`: trajectories `timestamp tx ty tz qx qy qz qw`, one text file a toss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tossid.errors import ConfigError, FileError, InputError
from tossid.outputs import write_whole
from tossid.settings.kinds import advanced_part
from tossid.settings.limits import ImportLimits
from tossid.store.importers.registry import Imported, holds, register_importer

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from tossid.objects import ObjectModel
    from tossid.store.lost_rows import Lost
    from tossid.store.pose_columns import PoseColumns
    from tossid.types import PoseTrack, Toss

    Array = NDArray[np.float64]

_JOINTS = ".joints.txt"
_LINK = ".link_2.txt"
_FORM = "timestamp tx ty tz qx qy qz qw"
_SAME_TIME = 1e-6
"""[s] by which the times of poses and joints may differ (they are printed with some digits)."""


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
    limits: ImportLimits = advanced_part(ImportLimits)
    """values beyond which units are taken to be wrong"""


def read_tum(
    folder: Path, *, n_joints: int, limits: ImportLimits = ImportLimits(), columns: str | None = None
) -> Sequence[PoseTrack]:
    """The tracks in a folder of `NAME.txt`, and for an articulated object `NAME.joints.txt` beside each.

    A pose is that of the object's first link in a world with z up and ground
    z = 0; times [s] increase, but need not be uniform; `#` starts a comment.
    A first line that names columns is obeyed (`tossid.store.pose_columns`).
    Rows without a pose, where the tracker had lost the object, are left out.
    `NAME.joints.txt` holds `timestamp angle…` [rad] at the same times.

    Args:
        folder: Where the files lie.
        n_joints: Joints of the object.
        limits: Values beyond which units are taken to be wrong, and the share of rows that may hold no pose.
        columns: Names of the columns, whatever the files say; None: as their first line says, else
            `timestamp tx ty tz qx qy qz qw`.

    Returns:
        Tracks without velocities, 2 before 10.

    Raises:
        FileError: A file is missing or is not what it should be; names file and line.
    """
    return _read(folder, n_joints, limits, columns).tracks


def _read(folder: Path, n_joints: int, limits: ImportLimits, columns: str | None) -> Imported:
    """The tracks of a folder, and what is to be said of its files; every file is checked now."""
    from collections import Counter

    from tossid.store.import_checks import files_of, tracks_of
    from tossid.store.lost_rows import Lost

    files = files_of(Path(folder), ".txt", but_not=(_JOINTS, _LINK))
    lost, stated, w_first = Lost(0, Counter()), True, True

    def track(path: Path) -> PoseTrack:
        nonlocal stated, w_first
        read = _read_track(path, n_joints, limits, columns)
        lost.rows += read.lost.rows
        lost.by_kind.update(read.lost.by_kind)
        stated &= read.stated
        w_first &= read.w_first
        return read.track

    tracks = tracks_of(files, track)
    for _ in tracks:
        pass
    said = lost.words()
    remarks = () if said is None else (f"{said}: they are left out as lost frames",)
    return Imported(tracks, remarks=remarks, w_first=w_first, stated=stated)


def read_link_tum(
    folder: Path, *, limits: ImportLimits = ImportLimits(), columns: str | None = None
) -> tuple[Sequence[PoseTrack], ...]:
    """The tracks of both links of an object of which nothing is stated: `NAME.txt` and `NAME.link_2.txt` beside each.

    Args:
        folder: Where the files lie.
        limits: As `read_tum` has them. Frames without a pose of one link are left out of both.
        columns: As `read_tum` has them.

    Returns:
        Tracks of link 1 and of link 2 at the same times, (n, 7) each, without velocities, 2 before 10.

    Raises:
        FileError: A file is missing or is not what it should be; names file and line.
    """
    import numpy as np

    from tossid.store.import_checks import files_of
    from tossid.types import PoseTrack

    first, second = list[PoseTrack](), list[PoseTrack]()
    for path in files_of(Path(folder), ".txt", but_not=(_JOINTS, _LINK)):
        beside = path.with_name(path.name.removesuffix(".txt") + _LINK)
        if not beside.is_file():
            raise FileError(beside, "is missing; object.links=2 needs the poses of the second link")
        one, two = (_read_track(each, 0, limits, columns) for each in (path, beside))
        if len(one.all_t) != len(two.all_t) or not (abs(one.all_t - two.all_t) <= _SAME_TIME).all():
            raise FileError(beside, f"its times are not those of {path.name}; expected both links in every frame")
        shared = np.intersect1d(one.kept, two.kept)
        for read, links in ((one, first), (two, second)):
            links.append(PoseTrack(path.stem, one.all_t[shared], read.track.q[np.isin(read.kept, shared)]))
    return first, second


@dataclass(frozen=True)
class _Read:
    """What one file holds: its track, and which of its rows that is."""

    track: PoseTrack
    all_t: Array
    kept: NDArray[np.int64]
    lost: Lost
    w_first: bool
    stated: bool


def _read_track(path: Path, n_joints: int, limits: ImportLimits, columns: str | None) -> _Read:
    import numpy as np

    from tossid.rotations import xyzw_to_wxyz
    from tossid.store.import_checks import check_times, checked_track
    from tossid.store.lost_rows import lost_rows

    rows, lines, where = _read_poses(path, columns)
    t = _time(path, rows, lines, where)
    check_times(path, t, limits)
    poses = np.concatenate([where.length * rows[:, where.position], rows[:, where.quaternion]], axis=1)
    gone, lost = lost_rows(t, poses)
    if gone.mean() > limits.lost:
        said = f"{lost.words()}; at most {limits.lost:.0%} may be lost frames (source.limits.lost)"
        raise FileError(path, said, row=f"line {lines[int(np.argmax(gone))]}")
    kept = np.flatnonzero(~gone)
    q = np.concatenate([poses[:, :3], xyzw_to_wxyz(poses[:, 3:])], axis=1)
    beside = path.with_name(path.name.removesuffix(".txt") + _JOINTS)
    if n_joints:
        if not beside.is_file():
            raise FileError(beside, f"is missing; the object has {n_joints} joints")
        q = np.concatenate([q, _read_joints(beside, t, kept, n_joints)], axis=1)
    elif beside.exists():
        raise FileError(beside, "gives joint angles, but the object has no joints")
    names = [f"line {lines[row]}" for row in kept]
    track = checked_track(path, t[kept], q[kept], None, row_names=names, limits=limits)
    return _Read(track, t, kept, lost, min(where.quaternion) == where.quaternion[3], where.named)


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

    from tossid.rotations import wxyz_to_xyzw

    folder = Path(folder)
    for track in tracks:
        if not track.name or "/" in track.name or track.name.endswith((".joints", ".link_2")):
            raise InputError(
                f"a TUM file cannot be named after track {track.name!r} (empty, with '/', '.joints' or '.link_2')"
            )
        poses = np.column_stack([track.t, track.q[:, :3], wxyz_to_xyzw(track.q[:, 3:7])])
        write_whole(folder / f"{track.name}.txt", _text(_FORM, poses))
        if track.q.shape[1] > 7:
            joints = np.column_stack([track.t, track.q[:, 7:]])
            write_whole(folder / f"{track.name}{_JOINTS}", _text("timestamp angle", joints))
    for track in second or ():
        poses = np.column_stack([track.t, track.q[:, :3], wxyz_to_xyzw(track.q[:, 3:7])])
        write_whole(folder / f"{track.name}{_LINK}", _text(_FORM, poses))


def write_trajectory(path: Path, track: PoseTrack) -> None:
    """Write the poses of a track's base as one file, with nine decimals: `timestamp tx ty tz qx qy qz qw`.

    Args:
        path: The file.
        track: What is written.
    """
    import numpy as np

    from tossid.rotations import wxyz_to_xyzw

    rows = np.column_stack([track.t, track.q[:, :3], wxyz_to_xyzw(track.q[:, 3:7])])
    np.savetxt(path, rows, fmt="%.9f", header=_FORM)


def trajectory_info(path: Path) -> dict[str, Any]:
    """What is in one trajectory, for a person: its rows, their rate, their span in time and in space.

    Args:
        path: A file of rows `timestamp tx ty tz qx qy qz qw`.

    Raises:
        FileError: It is none, or its times do not increase, or a quaternion is no rotation.
    """
    import numpy as np

    read = _read_track(path, 0, ImportLimits(), None) if not path.name.endswith(_JOINTS) else None
    if read is None:
        raise FileError(path, f"gives joint angles, expected rows of '{_FORM}'")
    t, places = read.track.t, read.track.q[:, :3]
    return {
        "kind": "poses",
        "n_frames": len(t),
        "n_lost": read.lost.by_kind.total(),
        "rate_hz": float(1 / np.median(np.diff(t))),
        "duration_s": float(t[-1] - t[0]),
        "position_min_m": places.min(axis=0).tolist(),
        "position_max_m": places.max(axis=0).tolist(),
    }


def _text(header: str, rows: Array) -> bytes:
    lines = [f"# {header}", *(" ".join(repr(float(x)) for x in row) for row in rows)]
    return ("\n".join(lines) + "\n").encode()


def _read_joints(path: Path, t: Array, kept: NDArray[np.int64], n_joints: int) -> Array:
    """Angles (n, n_joints) [rad] at the times of all poses; only those of poses that are kept need to be numbers."""
    import numpy as np

    from tossid.store.pose_columns import column_of
    from tossid.store.text_rows import read_rows

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


def _read_poses(path: Path, columns: str | None) -> tuple[Array, list[int], PoseColumns]:
    """The rows of a file of poses, the line of each, and where they hold what."""
    from tossid.store.pose_columns import USUAL, pose_columns, split_names
    from tossid.store.text_rows import read_rows

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
            said = f"{rows[int(np.argmax(beyond)), at]:.9g} is no part of a second; expected one column of the time"
            raise FileError(path, said, row=f"line {lines[int(np.argmax(beyond))]}")
    t = np.sum([rows[:, at] * size for at, size in where.times], axis=0)
    if np.isnan(t).any():
        raise FileError(path, "has no time", row=f"line {lines[int(np.argmax(np.isnan(t)))]}")
    return np.asarray(t)


def _import(source: TumSource, model: ObjectModel) -> Imported:
    other = next(iter(sorted(Path(source.path).glob(f"*{_LINK}"))), None)
    if other is not None:
        raise FileError(other, "gives the poses of a second link, which object=unknown object.links=2 takes")
    return _read(source.path, model.n_joints, source.limits, source.columns)


def _import_links(source: TumSource) -> tuple[Sequence[PoseTrack], ...]:
    return read_link_tum(source.path, limits=source.limits, columns=source.columns)


register_importer(
    TumSource,
    _import,
    recognizes=lambda path: holds(path, ".txt") and not holds(path, ".pt"),
    cut_at_rest=True,
    read_links=_import_links,
)
