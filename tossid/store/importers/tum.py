"""The format `tum`: trajectories `timestamp tx ty tz qx qy qz qw`, one text file a toss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tossid import budget
from tossid.errors import FileError, InputError
from tossid.outputs import write_whole
from tossid.settings.kinds import advanced_part
from tossid.settings.limits import ImportLimits
from tossid.store.importers.registry import Imported, holds, register_importer

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from tossid.objects import ObjectModel
    from tossid.types import PoseTrack, Toss

    Array = NDArray[np.float64]

_JOINTS = ".joints.txt"
_LINK = ".link_2.txt"
_FORM = "timestamp tx ty tz qx qy qz qw"
_SAME_TIME = 1e-6
"""[s] by which the times of poses and joints may differ (they are printed with some digits)."""
_MAX_FILE = 1 << 28


@dataclass(frozen=True, kw_only=True)
class TumSource:
    """Tracked poses, one TUM trajectory file a toss."""

    name: Literal["tum"] = "tum"
    """TUM trajectories"""
    path: Path
    """folder of NAME.txt files (beside them NAME.joints.txt for joints, NAME.link_2.txt for an unknown second link)"""
    limits: ImportLimits = advanced_part(ImportLimits)
    """values beyond which units are taken to be wrong"""


def read_tum(folder: Path, *, n_joints: int, limits: ImportLimits = ImportLimits()) -> Sequence[PoseTrack]:
    """The tracks in a folder of `NAME.txt`, and for an articulated object `NAME.joints.txt` beside each.

    A pose is that of the object's first link in a world with z up and ground
    z = 0; times [s] increase, but need not be uniform; `#` starts a comment.
    `NAME.joints.txt` holds `timestamp angle…` [rad] at the same times.

    Args:
        folder: Where the files lie.
        n_joints: Joints of the object.
        limits: Values beyond which units are taken to be wrong.

    Returns:
        Tracks without velocities, 2 before 10.

    Raises:
        FileError: A file is missing or is not what it should be; names file and line.
    """
    from tossid.store.import_checks import files_of, tracks_of

    folder = Path(folder)
    tracks = tracks_of(
        files_of(folder, ".txt", but_not=(_JOINTS, _LINK)), lambda path: _read_track(path, n_joints, limits)
    )
    for _ in tracks:  # every file is checked now
        pass
    return tracks


def read_link_tum(folder: Path, *, limits: ImportLimits = ImportLimits()) -> tuple[Sequence[PoseTrack], ...]:
    """The tracks of both links of an object of which nothing is stated: `NAME.txt` and `NAME.link_2.txt` beside each.

    Args:
        folder: Where the files lie.
        limits: Values beyond which units are taken to be wrong.

    Returns:
        Tracks of link 1 and of link 2 at the same times, (n, 7) each, without velocities, 2 before 10.

    Raises:
        FileError: A file is missing or is not what it should be; names file and line.
    """
    from tossid.store.import_checks import files_of
    from tossid.types import PoseTrack

    def second(path: Path, one: PoseTrack) -> PoseTrack:
        beside = path.with_name(path.name.removesuffix(".txt") + _LINK)
        if not beside.is_file():
            raise FileError(beside, "is missing; object.links=2 needs the poses of the second link")
        two = _read_track(beside, 0, limits)
        if len(two.t) != len(one.t) or not (abs(two.t - one.t) <= _SAME_TIME).all():
            raise FileError(beside, f"its times are not those of {path.name}; expected both links in every frame")
        return PoseTrack(one.name, one.t, two.q)

    first = read_tum(folder, n_joints=0, limits=limits)
    files = files_of(Path(folder), ".txt", but_not=(_JOINTS, _LINK))
    return first, [second(path, one) for path, one in zip(files, first, strict=True)]


def _read_track(path: Path, n_joints: int, limits: ImportLimits) -> PoseTrack:
    import numpy as np

    from tossid.rotations import xyzw_to_wxyz
    from tossid.store.import_checks import checked_track

    rows, lines = _read_rows(path, 8, _FORM)
    t = rows[:, 0].copy()
    q = np.concatenate([rows[:, 1:4], xyzw_to_wxyz(rows[:, 4:8])], axis=1)
    beside = path.with_name(path.name.removesuffix(".txt") + _JOINTS)
    if n_joints:
        if not beside.is_file():
            raise FileError(beside, f"is missing; the object has {n_joints} joints")
        q = np.concatenate([q, _read_joints(beside, t, n_joints)], axis=1)
    elif beside.exists():
        raise FileError(beside, "gives joint angles, but the object has no joints")
    return checked_track(path, t, q, None, row_names=[f"line {line}" for line in lines], limits=limits)


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

    from tossid.errors import MotionError
    from tossid.types import check_motion

    form = f"rows of '{_FORM}'"
    try:
        rows = np.loadtxt(path, comments="#", ndmin=2)
    except (ValueError, UnicodeDecodeError) as error:
        raise FileError(path, f"expected {form} ({' '.join(str(error).split())})") from error
    if rows.shape[1] != 8:
        raise FileError(path, f"has {rows.shape[1]} columns, expected {form}")
    try:
        check_motion(rows[:, 0], rows[:, [1, 2, 3, 7, 4, 5, 6]])
    except MotionError as error:
        raise FileError(path, error.problem, row=error.row) from error
    return {
        "kind": "poses",
        "n_frames": len(rows),
        "rate_hz": float(1 / np.median(np.diff(rows[:, 0]))),
        "duration_s": float(rows[-1, 0] - rows[0, 0]),
        "position_min_m": rows[:, 1:4].min(axis=0).tolist(),
        "position_max_m": rows[:, 1:4].max(axis=0).tolist(),
    }


def _text(header: str, rows: Array) -> bytes:
    lines = [f"# {header}", *(" ".join(repr(float(x)) for x in row) for row in rows)]
    return ("\n".join(lines) + "\n").encode()


def _read_joints(path: Path, t: Array, n_joints: int) -> Array:
    import numpy as np

    rows, lines = _read_rows(path, 1 + n_joints, "timestamp" + " angle" * n_joints)
    if len(rows) != len(t):
        raise FileError(path, f"has {len(rows)} rows, the poses beside it have {len(t)}")
    off = ~(np.abs(rows[:, 0] - t) <= _SAME_TIME)
    if off.any():
        row = int(np.argmax(off))
        raise FileError(path, f"time {rows[row, 0]:.9g} s, the pose has {t[row]:.9g} s", row=f"line {lines[row]}")
    bad = ~np.isfinite(rows).all(axis=1)
    if bad.any():
        raise FileError(path, "is not finite (NaN or infinity)", row=f"line {lines[int(np.argmax(bad))]}")
    return np.unwrap(rows[:, 1:], axis=0)


def _read_rows(path: Path, columns: int, form: str) -> tuple[Array, list[int]]:
    """Numbers of a text file (n, columns), and the line of each row, counted from 1."""
    import numpy as np

    try:
        if budget.regular_size(path) > _MAX_FILE:
            raise FileError(path, f"is larger than {_MAX_FILE >> 20} MiB, expected one toss as text")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise FileError(path, f"cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise FileError(path, f"is not text, expected rows of '{form}'") from error
    rows: list[list[float]] = []
    lines: list[int] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#", 1)[0].replace(",", " ").split()
        if not words:
            continue
        if len(words) != columns:
            raise FileError(path, f"{len(words)} columns, expected {columns}: '{form}'", row=f"line {number}")
        try:
            rows.append([float(word.replace("_", "?")) for word in words])
        except ValueError as error:
            raise FileError(path, f"{error}, expected numbers: '{form}'", row=f"line {number}") from error
        lines.append(number)
    if len(rows) < 2:
        raise FileError(path, f"has {len(rows)} rows of numbers, expected at least 2: '{form}'")
    return np.array(rows), lines


def _import(source: TumSource, model: ObjectModel) -> Imported:
    other = next(iter(sorted(Path(source.path).glob(f"*{_LINK}"))), None)
    if other is not None:
        raise FileError(other, "gives the poses of a second link, which object=unknown object.links=2 takes")
    return Imported(read_tum(source.path, n_joints=model.n_joints, limits=source.limits))


def _import_links(source: TumSource) -> tuple[Sequence[PoseTrack], ...]:
    return read_link_tum(source.path, limits=source.limits)


register_importer(
    TumSource,
    _import,
    recognizes=lambda path: holds(path, ".txt") and not holds(path, ".pt"),
    cut_at_rest=True,
    read_links=_import_links,
)
